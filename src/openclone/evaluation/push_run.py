"""Runs in which the robot is pushed again and again."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from openclone.evaluation.episode import Episode, Reference, has_fallen
from openclone.odometry.noise import OdometryNoiseConfig
from openclone.policy.bundle import Bundle
from openclone.policy.command import Command, KeyPoints
from openclone.robot import g1
from openclone.robot.model import CONTROL_PERIOD, build_model
from openclone.robot.state import RobotState, key_point_poses
from openclone.simulation.robot import SimulatedRobot
from openclone.spatial import rotations

WINDOW_S = 3.0
"""A fall this soon after a push is the push's."""
_WARM_UP_S = 2.0


@dataclass(frozen=True)
class PushConfig:
    """Size and frequency of the pushes.

    Attributes:
        speed: m/s, largest change of velocity along each horizontal axis (Table A2).
        shortest_s, longest_s: seconds between pushes; their mean is Table A2's 5 s.
        walking_speed: m/s; a walking operator is pushed while faster than this.
    """

    speed: float = 1.5
    shortest_s: float = 4.0
    longest_s: float = 6.0
    walking_speed: float = 0.25


@dataclass(frozen=True)
class Push:
    """One push and what came of it.

    Attributes:
        kick_h: (2,), m/s, change of velocity ahead and to the left of the robot.
        fell: whether the robot fell within `WINDOW_S`.
        distance_m: metres, of the head from its target at the end of the window,
            horizontally; NaN after a fall.
    """

    kick_h: tuple[float, float]
    fell: bool
    distance_m: float

    @property
    def speed(self) -> float:
        """m/s."""
        return math.hypot(*self.kick_h)


@dataclass(frozen=True)
class PushRun:
    """Pushes until there are enough.

    Attributes:
        pushes: in their order.
        other_falls: falls outside the windows after pushes.
        seconds: simulated.
    """

    pushes: tuple[Push, ...]
    other_falls: int
    seconds: float

    @property
    def falls(self) -> int:
        """All falls, whatever their reason."""
        return self.other_falls + sum(push.fell for push in self.pushes)


def push_run(
    bundle: Bundle,
    reference: Reference,
    count: int,
    config: PushConfig,
    moving: float,
    noise: OdometryNoiseConfig | None,
    rng: np.random.Generator,
) -> PushRun:
    """Push the robot ``count`` times while it follows ``reference``.

    After a fall, and at the end of the reference, it begins anew. A robot that falls
    without pushes as often as it should be pushed is given up.

    Args:
        bundle: the student.
        reference: what it is commanded; longer than `WINDOW_S`.
        count: pushes.
        config: size and frequency.
        moving: m/s; pushes wait until the commanded head is faster. 0: never.
        noise: Eq. 2's constants, or None for perfect odometry.
        rng: draws times and directions.
    """
    robot = SimulatedRobot(build_model())
    pushes: list[Push] = []
    other_falls, steps = 0, 0
    while len(pushes) < count and other_falls < count:
        robot.reset(reference.qpos[0], reference.start_velocity)
        episode = Episode(robot, bundle, noise, rng.spawn(1)[0])
        hand = _PushingHand(robot, reference, config, moving, rng)
        for t in range(1, len(reference.qpos)):
            steps += 1
            hand.before(t, episode.state)
            target = KeyPoints(reference.points[t], reference.point_quats[t])
            state = episode.step(Command(target, reference.point_velocities[t]))
            fell = has_fallen(state.body_position, state.body_quat, reference.quat[t])
            result = hand.after(t, state, fell)
            if result is not None:
                pushes.append(result)
            other_falls += fell and result is None
            if fell or (len(pushes) >= count and not hand.busy):
                break
    return PushRun(tuple(pushes[:count]), other_falls, steps * CONTROL_PERIOD)


class _PushingHand:
    """Pushes one robot now and then, and watches what comes of it."""

    def __init__(
        self,
        robot: SimulatedRobot,
        reference: Reference,
        config: PushConfig,
        moving: float,
        rng: np.random.Generator,
    ) -> None:
        self._robot, self._reference, self._config = robot, reference, config
        self._moving, self._rng = moving, rng
        self._next_s = _WARM_UP_S + rng.uniform(0.0, config.longest_s)
        self._pushed_s = 0.0
        self._kick_h: tuple[float, float] | None = None

    @property
    def busy(self) -> bool:
        """Whether the outcome of a push is still open."""
        return self._kick_h is not None

    def before(self, t: int, state: RobotState) -> None:
        """Push before step ``t``, if it is time."""
        now, reference = t * CONTROL_PERIOD, self._reference
        last = (len(reference.qpos) - 1) * CONTROL_PERIOD - WINDOW_S
        speed = float(np.linalg.norm(reference.point_velocities[t, 0, :2]))
        if self.busy or now < self._next_s or now > last or speed < self._moving:
            return
        kick = self._config.speed * self._rng.uniform(-1.0, 1.0, 2)
        self._robot.data.qvel[:2] += kick
        heading = rotations.heading(state.body_quat[g1.ROOT])
        kick_h = rotations.rotate_inverse(heading, np.append(kick, 0.0))
        self._kick_h = float(kick_h[0]), float(kick_h[1])
        self._pushed_s = now
        gap = self._rng.uniform(self._config.shortest_s, self._config.longest_s)
        self._next_s = now + gap

    def after(self, t: int, state: RobotState, fell: bool) -> Push | None:
        """The outcome of the last push, once it is known."""
        if self._kick_h is None:
            return None
        if not fell and (t + 1) * CONTROL_PERIOD < self._pushed_s + WINDOW_S:
            return None
        kick_h, self._kick_h = self._kick_h, None
        points, _ = key_point_poses(state.body_position, state.body_quat)
        away = (points[0] - self._reference.points[t, 0])[:2]
        distance = float("nan") if fell else float(np.linalg.norm(away))
        return Push(kick_h, fell, distance)
