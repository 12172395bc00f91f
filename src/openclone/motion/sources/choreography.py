"""Writing a motion down: stand, step, crouch, jump and gesture on one time line.

A `Choreography` holds the tracks of one clip. Each method appends a phrase at the
current time and moves the time on; gestures are laid over phrases. `plan` samples the
tracks. The zero-moment point always goes where the weight has to be: onto the standing
foot before the other one lifts, and between the feet at rest.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from openclone.motion.sources.track import Track
from openclone.motion.sources.whole_body import GRAVITY, Plan
from openclone.robot import g1

FPS = 50.0
LEFT, RIGHT = 0, 1
_OUTWARD = (1.0, -1.0)
_SOLE_CENTRE_X = 0.03
"""Metres ahead of the ankle where the weight rests when standing."""
_QUIET = 0.09
"""Share of the swing, at both ends, in which the foot only rises or only sinks."""


@dataclass(frozen=True)
class Gait:
    """How a walk is walked.

    Attributes:
        forward: metres per step.
        sideways: metres per pair of steps, positive to the left.
        turn: radians per pair of steps, positive to the left.
        step_s: seconds per step.
        shift_s: seconds of each step with both feet down.
        clearance: metres between the swinging sole and the ground.
        heel: radians that the heel rises above the toes early in the swing.
        bob: metres that the pelvis rises in mid-step.
    """

    forward: float = 0.0
    sideways: float = 0.0
    turn: float = 0.0
    step_s: float = 0.55
    shift_s: float = 0.14
    clearance: float = 0.05
    heel: float = 0.0
    bob: float = 0.006


def _rotated(offset: tuple[float, float], yaw: float) -> np.ndarray:
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
        self.zmp = Track(self._between())
        self.height = Track([height])
        self.trunk = Track([0.0, 0.0, 0.0])
        self.waist = Track([0.0, 0.0, 0.0])
        self.arms = Track(arms)
        self.arm_swing = rng.uniform(0.3, 0.9)
        self._stagger = stagger

    def _footprint(self, body: np.ndarray, side: int) -> np.ndarray:
        """Ankle x, y and yaw of one foot when the body stands at ``body (3,)``."""
        sign = _OUTWARD[side]
        xy = body[:2] + _rotated((0.0, 0.5 * sign * self.width), body[2])
        return np.array([*xy, body[2] + sign * self.toe_out])

    def _pressure(self, side: int, along: float) -> np.ndarray:
        """A point of the sole, ``along`` metres ahead of the ankle, slightly inward."""
        x, y, yaw = self.feet[side].end
        inward = -0.012 * _OUTWARD[side]
        return np.array([x, y]) + _rotated((along, inward), yaw)

    def _between(self) -> np.ndarray:
        left = self._pressure(LEFT, _SOLE_CENTRE_X)
        return 0.5 * (left + self._pressure(RIGHT, _SOLE_CENTRE_X))

    def hold(self, seconds: float) -> None:
        """Let time pass."""
        self.time_s += seconds

    def settle(self, seconds: float = 0.6) -> None:
        """Bring the weight between the feet."""
        self.zmp.move(self.time_s, self.time_s + seconds, self._between())
        self.time_s += seconds

    def shift_weight(self, side: int, share: float, seconds: float) -> None:
        """Lean onto one foot: ``share`` 0 is the middle, 1 that foot alone."""
        target = self._between()
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
        roll = min(0.3 * abs(gait.forward), 0.035) * np.sign(gait.forward)
        self.zmp.move(start, up, self._pressure(stance, _SOLE_CENTRE_X - roll))
        self.zmp.move(up, down, self._pressure(stance, _SOLE_CENTRE_X + roll))
        fly_s, land_s = up + _QUIET * swing_s, down - _QUIET * swing_s
        self.feet[side].move(fly_s, land_s, self._footprint(body, side))
        one_foot = np.eye(2)[side]
        self.lift.bump(up, down, gait.clearance * one_foot)
        heel_down_s = up + 0.75 * swing_s
        self.pitch.bump(fly_s, heel_down_s, gait.heel * one_foot)
        turn = 0.5 * (self.feet[LEFT].end[2] + self.feet[RIGHT].end[2])
        trunk = self.trunk.end.copy()
        trunk[0] = turn
        self.trunk.move(start, down, trunk)
        self.trunk.bump(up, down, [0.0, 0.0, -0.02 * _OUTWARD[side]])
        self.height.bump(up - 0.5 * shift_s, down, gait.bob)
        self.time_s = down

    def walk(self, gait: Gait, steps: int, first: int | None = None) -> None:
        """Start, walk ``steps`` steps and close the feet; at rest before and after.

        Args:
            gait: the walk.
            steps: number of steps before the closing one.
            first: the foot that starts; by default the one on the inside.
        """
        drift = gait.sideways if gait.sideways else gait.turn
        if first is None:
            first = int(self.rng.integers(2)) if drift == 0 else int(drift < 0)
        body = self.body.copy()
        for index in range(steps + 1):
            side = first if index % 2 == 0 else 1 - first
            ramp = 0.6 if index == 0 or index == steps - 1 else 1.0
            leads = float(index % 2 == 0 and index < steps)
            forward = ramp * gait.forward if index < steps else 0.0
            body[2] += 0.5 * leads * gait.turn
            body[:2] += _rotated((forward, leads * gait.sideways), body[2])
            body[2] += 0.5 * leads * gait.turn
            shift_s = 0.5 if index == 0 else gait.shift_s
            self.step(side, body, gait, shift_s)
        self.body = body
        self.settle()

    def lean(self, pitch: float, start_s: float, end_s: float) -> None:
        """Bend the trunk forward by ``pitch`` in all, at the hip and at the waist."""
        trunk = self.trunk.end.copy()
        trunk[1] = 0.6 * pitch
        self.trunk.move(start_s, end_s, trunk)
        waist = self.waist.end.copy()
        waist[2] = 0.4 * pitch
        self.waist.move(start_s, end_s, waist)

    def jump(
        self, rise: float, crouch: float, forward: float, tuck: float, lean: float
    ) -> None:
        """Crouch, push off with both feet, fly, land and stand up.

        Args:
            rise: metres that the centre of mass flies up.
            crouch: metres that it sinks before.
            forward: metres between take-off and landing.
            tuck: metres that the feet rise.
            lean: radians that the trunk leans forward when crouching.
        """
        top = float(self.height.end[0])
        speed = math.sqrt(2.0 * GRAVITY * rise)
        flight_s = round(2.0 * speed / GRAVITY * FPS) / FPS
        speed = 0.5 * GRAVITY * flight_s
        push = crouch - 0.02
        push_s = round(2.2 * push / speed * FPS) / FPS
        sink_s, rest_s = 0.6, 0.9
        self.height.move(self.time_s, self.time_s + sink_s, top - crouch)
        self.lean(lean, self.time_s, self.time_s + sink_s)
        self.time_s += sink_s
        off = self.time_s + push_s
        land = off + flight_s
        leave = _push_off(push, speed, push_s)
        self.height.add(
            self.time_s, land + push_s, 1.0,
            lambda phase: _jump_height(
                phase * (2 * push_s + flight_s), leave, push_s, flight_s
            ),
        )  # fmt: skip
        self.lift.bump(off, land, tuck)
        self.lean(0.3 * lean, self.time_s, off)
        self.lean(lean, land, land + push_s)
        self.body[0] += forward
        for side in (LEFT, RIGHT):
            target = self.feet[side].end + np.array([forward, 0.0, 0.0])
            swing = 0.12 * flight_s
            self.feet[side].move(off + swing, land - swing, target)
        self.zmp.move(off, land, self._between())
        self.time_s = land + push_s
        self.height.move(self.time_s, self.time_s + rest_s, top)
        self.lean(0.0, self.time_s, self.time_s + rest_s)
        self.time_s += rest_s

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


def _push_off(distance: float, speed: float, seconds: float) -> np.ndarray:
    """Quintic coefficients (6,), highest power first, of the push-off.

    From rest without acceleration to ``speed`` at ``distance``, where the ground's
    force has gone to zero (acceleration -g).
    """
    powers = np.arange(6)
    end = seconds**powers
    speed_row = np.concatenate(([0.0], powers[1:] * seconds ** (powers[1:] - 1)))
    accel_row = np.concatenate(
        ([0.0, 0.0], powers[2:] * (powers[2:] - 1) * seconds ** (powers[2:] - 2))
    )
    rows = [np.eye(6)[0], np.eye(6)[1], np.eye(6)[2], end, speed_row, accel_row]
    ends = np.array([0, 0, 0, distance, speed, -GRAVITY])
    return np.linalg.solve(np.array(rows), ends)[::-1]


def _jump_height(
    time_s: np.ndarray, leave: np.ndarray, push_s: float, flight_s: float
) -> np.ndarray:
    """Height above the crouch: push-off, parabola, and the push-off backwards."""
    total = 2.0 * push_s + flight_s
    mirrored = np.minimum(time_s, total - time_s)
    push = np.polyval(leave, np.clip(mirrored, 0.0, push_s))
    airborne = np.clip(mirrored - push_s, 0.0, None)
    return push + 0.5 * GRAVITY * airborne * (flight_s - airborne)
