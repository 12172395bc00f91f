"""Writing a motion down: stand, step, crouch and gesture on one time line.

A `Choreography` holds the tracks of one clip. Each method appends a phrase at the
current time and moves the time on; gestures are laid over phrases. `plan` samples the
tracks. The zero-moment point always goes where the weight has to be: onto the standing
foot before the other one lifts, and between the feet at rest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from openclone.motion.sources.track import Track, minimum_jerk, raised
from openclone.motion.sources.whole_body import Plan
from openclone.robot import g1

FPS = 50.0
LEFT, RIGHT = 0, 1
_OUTWARD = (1.0, -1.0)
_SOLE_CENTRE_X = 0.03
"""Metres ahead of the ankle where the weight rests when standing."""
_QUIET = 0.08
"""Share of the swing, at both ends, in which the foot only rises or only sinks."""
_MAX_ROLL = 0.045
"""Metres that the weight travels along the sole, each way from its centre."""
_TURN_OVERLAP = 0.4
"""Share of a step by which the pelvis begins to turn early and ends late."""


@dataclass(frozen=True)
class Gait:
    """How one step is taken.

    Attributes:
        forward: metres per step, negative backward.
        sideways: metres per pair of steps, positive to the left.
        turn: radians per pair of steps, positive to the left.
        lead: share of ``sideways`` and ``turn`` that the inner foot's step takes;
            1 opens the stance and closes it again, 0.5 shares the way equally.
        step_s: seconds per step.
        shift_s: seconds of each step with both feet down.
        clearance: metres between the swinging sole and the ground.
        heel: radians that the heel rises above the toes early in the swing.
        toe_off: radians that the foot has rolled onto its toes when it leaves.
        strike: radians that the toes are up when the foot comes down on its heel;
            negative: the heel is up, it comes down on its toes.
        bob: metres that the pelvis rises in mid-step.
    """

    forward: float = 0.0
    sideways: float = 0.0
    turn: float = 0.0
    lead: float = 1.0
    step_s: float = 0.55
    shift_s: float = 0.14
    clearance: float = 0.055
    heel: float = 0.0
    toe_off: float = 0.0
    strike: float = 0.0
    bob: float = 0.006


def rotated(offset: tuple[float, float], yaw: float) -> np.ndarray:
    """``offset`` (2,) turned to the left by ``yaw`` radians."""
    cosine, sine = math.cos(yaw), math.sin(yaw)
    x, y = offset
    return np.array([cosine * x - sine * y, sine * x + cosine * y])


class Choreography:
    """The tracks of one clip; positions in metres, angles in radians, world frame."""

    def __init__(
        self,
        rng: np.random.Generator,
        *,
        width: float,
        height: float,
        arms: np.ndarray,
        toe_out: float,
        stagger: float = 0.0,
        ballistic: bool = False,
    ) -> None:
        """Stand at the origin, facing x.

        Args:
            rng: source of all chance.
            width: metres between the ankles.
            height: metres of the pelvis (``ballistic``: of the centre of mass).
            arms: (14,) arm joint angles.
            toe_out: radians that each foot points outwards.
            stagger: metres that the left foot stands ahead of the right one.
            ballistic: see `Plan`.
        """
        self.rng = rng
        self.pace = 1.0
        """Scale of the speeds that are drawn."""
        self.time_s = 0.0
        self.width, self.toe_out = width, toe_out
        self.body = np.zeros(3)
        self.ballistic = ballistic
        ahead = np.array([0.5 * stagger, 0.0, 0.0])
        self.feet = [
            Track(self._footprint(self.body, side) + sign * ahead)
            for side, sign in ((LEFT, 1.0), (RIGHT, -1.0))
        ]
        self.lift, self.pitch = Track([0.0, 0.0]), Track([0.0, 0.0])
        self.zmp = Track(self.between())
        self.height = Track([height])
        self.trunk = Track([0.0, 0.0, 0.0])
        self.waist = Track([0.0, 0.0, 0.0])
        self.arms = Track(arms)
        self.arm_swing = rng.uniform(0.3, 0.9)
        self._stagger = stagger

    def _footprint(self, body: np.ndarray, side: int) -> np.ndarray:
        """Ankle x, y and yaw of one foot when the body stands at ``body (3,)``."""
        sign = _OUTWARD[side]
        xy = body[:2] + rotated((0.0, 0.5 * sign * self.width), body[2])
        return np.array([*xy, body[2] + sign * self.toe_out])

    def _pressure(self, side: int, along: float) -> np.ndarray:
        """A point of the sole, ``along`` metres ahead of the ankle, slightly inward."""
        x, y, yaw = self.feet[side].end
        inward = -0.012 * _OUTWARD[side]
        return np.array([x, y]) + rotated((along, inward), yaw)

    def between(self) -> np.ndarray:
        """(2,) the point between the soles' centres."""
        left = self._pressure(LEFT, _SOLE_CENTRE_X)
        return 0.5 * (left + self._pressure(RIGHT, _SOLE_CENTRE_X))

    def hold(self, seconds: float) -> None:
        """Let time pass."""
        self.time_s += seconds

    def settle(self, seconds: float = 0.6) -> None:
        """Bring the weight between the feet."""
        self.zmp.move(self.time_s, self.time_s + seconds, self.between())
        self.time_s += seconds

    def shift_weight(self, side: int, share: float, seconds: float) -> None:
        """Lean onto one foot: ``share`` 0 is the middle, 1 that foot alone."""
        target = self.between()
        target = target + share * (self._pressure(side, _SOLE_CENTRE_X) - target)
        self.zmp.move(self.time_s, self.time_s + seconds, target)
        self.time_s += seconds

    def change_height(self, height: float, seconds: float) -> None:
        """Raise or lower the pelvis, from now on, without moving the time on."""
        self.height.move(self.time_s, self.time_s + seconds, height)

    def step(self, side: int, body: np.ndarray, gait: Gait, shift_s: float) -> None:
        """Shift the weight to the other foot, then put ``side`` below ``body``.

        Args:
            side: the swinging foot.
            body: (3,) x, y, yaw of the body that the foot belongs to.
            gait: how the foot moves.
            shift_s: seconds of the weight shift.
        """
        stance = 1 - side
        start = self.time_s
        swing_s = gait.step_s - gait.shift_s
        up, down = start + shift_s, start + shift_s + swing_s
        roll = float(np.clip(0.35 * gait.forward, -_MAX_ROLL, _MAX_ROLL))
        self.zmp.move(start, up, self._pressure(stance, _SOLE_CENTRE_X - roll))
        self.zmp.move(up, down, self._pressure(stance, _SOLE_CENTRE_X + roll))
        fly_s, land_s = up + _QUIET * swing_s, down - _QUIET * swing_s
        self.feet[side].move(fly_s, land_s, self._footprint(body, side))
        one_foot = np.eye(2)[side]
        self.lift.add(up, down, gait.clearance * one_foot, raised)
        self._roll_foot(side, gait, up, down)
        early = _TURN_OVERLAP * gait.step_s
        trunk = self.trunk.end.copy()
        trunk[0] = 0.5 * (self.feet[LEFT].end[2] + self.feet[RIGHT].end[2])
        self.trunk.move(start - early, down + early, trunk)
        self.trunk.bump(up, down, [0.0, 0.0, -0.02 * _OUTWARD[side]])
        self.height.bump(up - 0.5 * shift_s, down, gait.bob)
        self.time_s = down

    def _roll_foot(self, side: int, gait: Gait, up: float, down: float) -> None:
        """Pitch of the swinging foot: off the toes, through the air, onto the heel."""
        swing_s, one_foot = down - up, np.eye(2)[side]
        self.pitch.bump(
            up + _QUIET * swing_s, up + 0.75 * swing_s, gait.heel * one_foot
        )
        if gait.toe_off == 0.0 and gait.strike == 0.0:
            return
        leave = 0.5 * gait.shift_s
        self.pitch.add(
            up - leave, up + 0.3 * swing_s, gait.toe_off * one_foot, minimum_jerk
        )
        change = -(gait.toe_off + gait.strike)
        self.pitch.add(up + 0.1 * swing_s, down, change * one_foot, minimum_jerk)
        self.pitch.add(
            down, down + 0.6 * gait.shift_s, gait.strike * one_foot, minimum_jerk
        )

    def lean(self, pitch: float, start_s: float, end_s: float) -> None:
        """Bend the trunk forward by ``pitch`` in all, at the hip and at the waist."""
        trunk = self.trunk.end.copy()
        trunk[1] = 0.6 * pitch
        self.trunk.move(start_s, end_s, trunk)
        waist = self.waist.end.copy()
        waist[2] = 0.4 * pitch
        self.waist.move(start_s, end_s, waist)

    def plan(self) -> Plan:
        """Sample all tracks at 50 frames per second."""
        time_s = np.arange(round(self.time_s * FPS) + 1) / FPS
        feet = np.stack([track.at(time_s) for track in self.feet], axis=1)
        trunk, waist = self.trunk.at(time_s), self.waist.at(time_s)
        arms = self.arms.at(time_s)
        cosine, sine = np.cos(trunk[:, 0]), np.sin(trunk[:, 0])
        apart = feet[:, LEFT] - feet[:, RIGHT]
        ahead = cosine * apart[:, 0] + sine * apart[:, 1] - self._stagger
        # The arm swings against the leg of its side, the shoulders against the hips.
        arms[:, 0] += self.arm_swing * ahead
        arms[:, 7] -= self.arm_swing * ahead
        trunk[:, 0] -= 0.12 * ahead
        waist[:, 0] += 0.3 * ahead
        upper = np.column_stack((waist, arms))
        lower, upper_limit = g1.JOINT_LOWER[12:] + 0.05, g1.JOINT_UPPER[12:] - 0.05
        return Plan(
            fps=FPS,
            foot_xy=feet[..., :2],
            foot_yaw=feet[..., 2],
            foot_pitch=self.pitch.at(time_s),
            foot_lift=self.lift.at(time_s),
            zmp=self.zmp.at(time_s),
            height=self.height.at(time_s)[:, 0],
            ballistic=self.ballistic,
            trunk=trunk,
            upper_joints=np.clip(upper, lower, upper_limit),
        )
