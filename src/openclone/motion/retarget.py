"""From a recorded human to the G1: inverse kinematics of the scaled targets."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mink
import numpy as np

from openclone.errors import InputError
from openclone.motion.clip import Clip, ClipInfo, clip_from_qpos
from openclone.motion.ik_limits import Apart, FrameLimit, arm_pairs, leg_pairs
from openclone.motion.proportions import FPS, RetargetConfig
from openclone.motion.quality import ClipQuality, Gate, QualityMeter, faults
from openclone.motion.skeleton import SIDES, HumanMotion
from openclone.motion.skeleton import start_at_origin as motion_at_origin
from openclone.motion.targets import Targets, make_targets
from openclone.robot import g1
from openclone.robot.model import SOLE_CORNERS, build_model
from openclone.spatial import rotations

VERSION = 19
"""Raise when the output changes: cached clips of older versions are made again."""

_ARM_JOINTS = slice(15, g1.NUM_JOINTS)
_ARM_DOFS = slice(6 + _ARM_JOINTS.start, 6 + _ARM_JOINTS.stop)
_DAMPING, _HELD_DAMPING = 0.05, 10.0
_BODY = ("pelvis", "torso_link")
_TWISTED = ("pitch", "roll")
_CAUGHT_M = 0.1
"""Metres from its target beyond which a hand at the end of its range is caught."""
_FREEING_FRAMES = 15
_FEET = tuple(f"{side}_ankle_roll_link" for side in SIDES)


class CannotFollowError(InputError):
    """A sound recording of a motion that the robot cannot make."""


_Weight = float | tuple[float, float, float]
_COSTS: dict[str, tuple[_Weight, _Weight]] = {
    "pelvis": (40.0, 6.0),
    "torso_link": (0.0, 5.0),
    # The ankles roll by 15 degrees at most: a straddling leg tilts its foot instead of
    # leaving its place. Where a hip cannot turn far enough, the foot turns on the spot
    # rather than throw the pelvis aside.
    **{f"{side}_ankle_roll_link": (200.0, (4.0, 20.0, 4.0)) for side in SIDES},
    **{f"{side}_elbow_link": (4.0, 0.0) for side in SIDES},
    **{f"{side}_wrist_yaw_link": (8.0, 0.6) for side in SIDES},
}
"""Link -> weights of its position (1/m) and orientation (1/rad), the latter perhaps
about the link's own x, y and z."""


@dataclass(frozen=True)
class _Stage:
    """One of the two stages in which a frame is solved."""

    tasks: Sequence[mink.Task | mink.DampingTask]
    limits: Sequence[mink.Limit]
    frozen: Sequence[mink.Task] | None = None


class Solver:
    """The inverse kinematics of one robot; build once, use for many clips.

    Each frame is solved in two stages: first pelvis, legs and waist, whom the arms
    must not pull from their places, then the arms.
    """

    def __init__(self, config: RetargetConfig | None = None) -> None:
        self.config = config or RetargetConfig()
        self.model = build_model(floor=True, self_collision=True)
        self.meter = QualityMeter(self.model)
        self._configuration = mink.Configuration(self.model)
        self._tasks = {
            link: mink.FrameTask(link, "body", *costs, lm_damping=0.01)
            for link, costs in _COSTS.items()
        }
        lower, upper = _joint_ranges(self.config)
        self._limit = FrameLimit(lower, upper, self.config.max_joint_speed / FPS)
        self._body_posture = mink.PostureTask(self.model, cost=_body_cost())
        self._posture = mink.PostureTask(self.model, cost=_posture_cost(()))
        self._caught = np.zeros(2, dtype=int)
        self._stages = self._body_stage(), self._arm_stage()
        self.unsolved = 0

    def _body_stage(self) -> _Stage:
        """Feet, pelvis and torso; the arms only keep out of the way."""
        damping = np.full(self.model.nv, _DAMPING)
        damping[_ARM_DOFS] = _HELD_DAMPING
        tasks = [self._tasks[link] for link in (*_FEET, *_BODY)]
        pairs = arm_pairs() + leg_pairs()
        return _Stage(
            [*tasks, self._body_posture, mink.DampingTask(self.model, cost=damping)],
            [self._limit, Apart(self.model, pairs, self.config.clearance)],
        )

    def _arm_stage(self) -> _Stage:
        """Elbows and hands, while the rest of the body stays as it is."""
        damping = np.full(self.model.nv, _DAMPING)
        # The hanging, stretched arm is singular: nothing holds its turn about itself.
        damping[_ARM_DOFS] = 1.0
        body = (*_FEET, *_BODY)
        tasks = [task for link, task in self._tasks.items() if link not in body]
        return _Stage(
            [*tasks, self._posture, mink.DampingTask(self.model, cost=damping)],
            [self._limit, Apart(self.model, arm_pairs(), self.config.clearance)],
            [mink.DofFreezingTask(self.model, list(range(_ARM_DOFS.start)))],
        )

    def _step(self, stage: _Stage) -> float:
        """One solver step; returns the largest joint move, radians."""
        for limits in (stage.limits, [self._limit]):
            try:
                step = mink.solve_ik(
                    self._configuration,
                    stage.tasks,
                    1.0,
                    "daqp",
                    limits=limits,
                    constraints=stage.frozen,
                )
            except mink.NoSolutionFound:
                self.unsolved += 1
                continue
            self._configuration.integrate_inplace(step, 1.0)
            return float(np.abs(step[6:]).max())
        return 0.0

    def _solve(self, stage: _Stage, targets: Targets, frame: int) -> None:
        """Step until the pose changes no more, or the steps are used up."""
        for _ in range(self.config.solves if frame else self.config.first_solves):
            if stage.frozen is None:
                self._aim_feet(targets, frame)
            if self._step(stage) < self.config.converged:
                break

    def _aim(self, targets: Targets, frame: int) -> None:
        """Set the targets of everything but the feet."""
        for link, task in self._tasks.items():
            if link in _FEET:
                continue
            turn = targets.quat.get(link)
            place = targets.position.get(link)
            place = np.zeros(3) if place is None else place[frame]
            quat = rotations.IDENTITY if turn is None else turn[frame]
            task.set_target(mink.SE3(np.concatenate((quat, place))))

    def _aim_feet(self, targets: Targets, frame: int) -> None:
        """As a foot is tilted now, its lowest corner must clear the ground."""
        for link in _FEET:
            place = targets.position[link][frame].copy()
            rotation = self._configuration.data.body(link).xmat.reshape(3, 3)
            place[2] = max(place[2], -(SOLE_CORNERS @ rotation[2]).min())
            pose = np.concatenate((targets.quat[link][frame], place))
            self._tasks[link].set_target(mink.SE3(pose))

    def _free_arms(self, targets: Targets, frame: int) -> None:
        """Draw an arm to the front that is caught at the end of its shoulder's range.

        The same posture of the upper arm has two sets of shoulder angles. Past the
        overhead pose an arm may go on in the wrong one, whose range ends soon.
        """
        joints = self._configuration.q[7:]
        before = self._caught > 0
        for index, side in enumerate(SIDES):
            link = f"{side}_wrist_yaw_link"
            place = self._configuration.data.body(link).xpos
            off = np.linalg.norm(place - targets.position[link][frame])
            shoulder = [g1.joint_index(f"{side}_shoulder_{k}_joint") for k in _TWISTED]
            at_end = (joints[shoulder] < g1.JOINT_LOWER[shoulder] + 0.02) | (
                joints[shoulder] > g1.JOINT_UPPER[shoulder] - 0.02
            )
            if off > _CAUGHT_M and at_end.any():
                self._caught[index] = _FREEING_FRAMES
            else:
                self._caught[index] = max(self._caught[index] - 1, 0)
        caught = self._caught > 0
        if (caught != before).any():
            sides = tuple(
                side for side, is_so in zip(SIDES, caught, strict=True) if is_so
            )
            self._posture.set_cost(_posture_cost(sides))

    def track(self, targets: Targets) -> np.ndarray:
        """Joint and root positions ``(T, 36)`` that follow ``targets``."""
        pelvis = targets.position["pelvis"][0], targets.quat["pelvis"][0]
        start = np.concatenate((*pelvis, g1.DEFAULT_POSE))
        self._configuration.update(start)
        for posture in (self._body_posture, self._posture):
            posture.set_target(start)
        self._posture.set_cost(_posture_cost(()))
        self._caught[:] = 0
        qpos = np.empty((len(targets.contact), self.model.nq))
        for frame in range(len(qpos)):
            self._limit.start(qpos[frame - 1, 7:] if frame else None)
            self._aim(targets, frame)
            for stage in self._stages:
                self._solve(stage, targets, frame)
            qpos[frame] = self._configuration.q
            self._free_arms(targets, frame)
        return qpos


def _body_cost() -> np.ndarray:
    """(35,) pull of each joint but the arms' to the standing posture."""
    cost = np.full(6 + g1.NUM_JOINTS, 0.02)
    cost[_ARM_DOFS] = 0.0
    return cost


def _posture_cost(caught: tuple[str, ...]) -> np.ndarray:
    """(35,) pull of each joint to the standing posture; strong for caught arms."""
    cost = np.full(6 + g1.NUM_JOINTS, 0.02)
    cost[_ARM_DOFS] = 0.2
    for side in caught:
        for name in g1.JOINT_NAMES[_ARM_JOINTS]:
            if name.startswith(side):
                cost[6 + g1.joint_index(name)] = 2.0
    return cost


def _joint_ranges(config: RetargetConfig) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper joint limits (29,) that the retargeting keeps, radians."""
    lower, upper = g1.JOINT_LOWER.copy(), g1.JOINT_UPPER.copy()
    for side in SIDES:
        # A straight knee is singular: its speed explodes at the stretched leg.
        lower[g1.joint_index(f"{side}_knee_joint")] = config.min_knee
        # No human turns the legs out as far as the G1 can.
        for name, most in (("hip_roll", 1.3), ("hip_yaw", 1.4)):
            index = g1.joint_index(f"{side}_{name}_joint")
            lower[index] = max(lower[index], -most)
            upper[index] = min(upper[index], most)
    return lower, upper


def start_at_origin(qpos: np.ndarray) -> np.ndarray:
    """Move the first frame's pelvis to xy = (0, 0) and turn its heading to +X."""
    turn = rotations.conjugate(rotations.heading(qpos[0, 3:7]))
    out = qpos.copy()
    out[:, :3] = rotations.rotate(turn, qpos[:, :3] - np.append(qpos[0, :2], 0.0))
    out[:, 3:7] = rotations.multiply(np.tile(turn, (len(qpos), 1)), qpos[:, 3:7])
    return out


def follow(
    motion: HumanMotion, info: ClipInfo, solver: Solver | None = None
) -> tuple[Clip, ClipQuality]:
    """Make a G1 clip at 50 frames per second of a recording, however bad it gets.

    The clip starts above the origin, heading along +X.
    """
    solver = solver or Solver()
    targets = make_targets(motion_at_origin(motion.resampled(FPS)), solver.config)
    qpos = solver.track(targets)
    quality = solver.meter.measure(qpos, FPS, targets)
    clip = clip_from_qpos(replace(info, fps=FPS), start_at_origin(qpos))
    return clip, quality


def retarget(
    motion: HumanMotion, info: ClipInfo, solver: Solver | None = None
) -> tuple[Clip, ClipQuality]:
    """As `follow`, but refuse what does not pass the gate.

    Raises:
        CannotFollowError: the robot cannot make this motion; the message says why.
    """
    clip, quality = follow(motion, info, solver)
    # A short recording may still be asked for by name.
    reasons = faults(quality, Gate(min_seconds=0.0))
    if reasons:
        raise CannotFollowError(
            f"the robot cannot follow it: {'; '.join(reasons)}",
            where=motion.name,
            remedy="leave this recording out",
        )
    return clip, quality
