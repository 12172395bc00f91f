"""Safety as a state machine: what may interrupt the robot, and what happens then.

    IDLE -> READY -> RAMP -> ACTIVE <-> HOLD, and from anywhere -> DAMPING

DAMPING ends only with `SafetyMonitor.reset`, after a person has looked at the robot.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum

import numpy as np

from openclone.robot import g1
from openclone.teleop.messages import Phase


class Trigger(Enum):
    """What can change the phase; the value is the text that people read."""

    NOT_FINITE = "a value is not finite"
    OPERATOR_STOP = "operator stop"
    TILT = "tilt limit"
    ODOMETRY_STALE = "odometry stale"
    ODOMETRY_JUMP = "odometry jump"
    OPERATOR_LOST = "operator lost"
    CALIBRATED = "calibrated"
    START = "start"
    RAMP_DONE = "ramp done"
    OPERATOR_BACK = "operator back"


FAULTS = (
    Trigger.NOT_FINITE,
    Trigger.OPERATOR_STOP,
    Trigger.TILT,
    Trigger.ODOMETRY_STALE,
    Trigger.ODOMETRY_JUMP,
)
"""Lead to DAMPING from every phase in which the robot is driven; gravest first."""

TRANSITIONS: dict[tuple[Phase, Trigger], Phase] = {
    (Phase.IDLE, Trigger.CALIBRATED): Phase.READY,
    (Phase.READY, Trigger.OPERATOR_LOST): Phase.IDLE,
    (Phase.READY, Trigger.START): Phase.RAMP,
    (Phase.RAMP, Trigger.OPERATOR_LOST): Phase.HOLD,
    (Phase.RAMP, Trigger.RAMP_DONE): Phase.ACTIVE,
    (Phase.ACTIVE, Trigger.OPERATOR_LOST): Phase.HOLD,
    (Phase.HOLD, Trigger.OPERATOR_BACK): Phase.ACTIVE,
    **{
        (phase, fault): Phase.DAMPING
        for phase in (Phase.READY, Phase.RAMP, Phase.ACTIVE, Phase.HOLD)
        for fault in FAULTS
    },
}
"""Everything that can happen; a pair that is missing here changes nothing."""


@dataclass(frozen=True)
class SafetyConfig:
    """Limits of the monitor.

    Attributes:
        operator_hold_ms: an older operator frame holds its pose with zero velocity.
        operator_lost_ms: an older one pauses the operator (HOLD).
        odometry_stale_ms: an older pose stops the robot.
        odometry_jump: metres between two ticks; more stops the robot.
        tilt_limit_deg: of the pelvis against the vertical.
        ramp_seconds: blend from the measured to the commanded points.
    """

    operator_hold_ms: float = 80.0
    operator_lost_ms: float = 250.0
    odometry_stale_ms: float = 200.0
    odometry_jump: float = 0.3
    tilt_limit_deg: float = 75.0
    ramp_seconds: float = 1.0


@dataclass(frozen=True)
class SafetyInputs:
    """What the monitor looks at in one tick.

    Attributes:
        now_ns: the loop's clock.
        calibrated: whether a command can be computed.
        operator_age_ns: age of the newest operator frame; None before the first.
        odometry_tracking: as the odometry says.
        odometry_age_ns: age of the newest pose.
        base_position: (3,), metres, by odometry.
        base_quat: (4,), wxyz, world from pelvis.
        finite: False if any input or the last action held NaN or infinity.
    """

    now_ns: int
    calibrated: bool
    operator_age_ns: int | None
    odometry_tracking: bool
    odometry_age_ns: int
    base_position: np.ndarray
    base_quat: np.ndarray
    finite: bool = True


class SafetyMonitor:
    """Holds the phase and moves it along `TRANSITIONS`, one step per tick at most."""

    def __init__(self, config: SafetyConfig | None = None) -> None:
        """Start in IDLE."""
        self.config = config or SafetyConfig()
        self.reset()

    def reset(self) -> None:
        """Back to IDLE, also out of DAMPING."""
        self.phase = Phase.IDLE
        self.trigger: Trigger | None = None
        self._start_requested = False
        self._stop_requested = False
        self._blend_start_ns = 0
        self._last_position: np.ndarray | None = None

    def request_start(self) -> None:
        """The operator asks to begin; takes effect in READY."""
        self._start_requested = True

    def request_stop(self) -> None:
        """The operator's emergency stop."""
        self._stop_requested = True

    def update(self, inputs: SafetyInputs) -> Phase:
        """Look at one tick and return the phase that applies to it."""
        self.trigger = None
        for trigger in self._raised(inputs):
            following = TRANSITIONS.get((self.phase, trigger))
            if following is None:
                continue
            if following is Phase.RAMP or self.phase is Phase.HOLD:
                self._blend_start_ns = inputs.now_ns
            self.phase, self.trigger = following, trigger
            break
        self._last_position = inputs.base_position.copy()
        return self.phase

    def fault(self, trigger: Trigger) -> None:
        """Stop at once for something seen after `update`, such as a broken action."""
        following = TRANSITIONS.get((self.phase, trigger))
        if following is not None:
            self.phase, self.trigger = following, trigger

    def blend(self, now_ns: int) -> float:
        """Share of the operator's command, 0 to 1, in RAMP and after HOLD."""
        elapsed = (now_ns - self._blend_start_ns) * 1e-9
        return min(1.0, elapsed / max(self.config.ramp_seconds, 1e-9))

    def operator_stale(self, operator_age_ns: int) -> bool:
        """Whether the last pose should be held with zero velocity."""
        return operator_age_ns > self.config.operator_hold_ms * 1e6

    def _raised(self, inputs: SafetyInputs) -> list[Trigger]:
        """All triggers that apply, gravest first."""
        config = self.config
        fresh = (
            inputs.operator_age_ns is not None
            and inputs.operator_age_ns <= config.operator_lost_ms * 1e6
        )
        odometry_fresh = (
            inputs.odometry_tracking
            and inputs.odometry_age_ns <= config.odometry_stale_ms * 1e6
        )
        ready = fresh and odometry_fresh and inputs.calibrated
        conditions = {
            Trigger.NOT_FINITE: not inputs.finite,
            Trigger.OPERATOR_STOP: self._stop_requested,
            Trigger.TILT: tilt_deg(inputs.base_quat) > config.tilt_limit_deg,
            Trigger.ODOMETRY_STALE: not odometry_fresh,
            Trigger.ODOMETRY_JUMP: self._jumped(inputs.base_position),
            Trigger.OPERATOR_LOST: not fresh,
            Trigger.CALIBRATED: ready and inputs.finite,
            Trigger.START: self._start_requested,
            Trigger.RAMP_DONE: self.blend(inputs.now_ns) >= 1.0,
            Trigger.OPERATOR_BACK: fresh,
        }
        return [trigger for trigger in Trigger if conditions[trigger]]

    def _jumped(self, position: np.ndarray) -> bool:
        if self._last_position is None:
            return False
        distance = float(np.linalg.norm(position - self._last_position))
        return distance > self.config.odometry_jump


def tilt_deg(quat: np.ndarray) -> float:
    """Angle between the body's z axis and the vertical, degrees."""
    upright = 1.0 - 2.0 * float(quat[1] ** 2 + quat[2] ** 2)
    return math.degrees(math.acos(max(-1.0, min(1.0, upright))))


_OVERSHOOT = g1.MAX_TORQUE / g1.KP
_TARGET_LOWER = g1.JOINT_LOWER - _OVERSHOOT
_TARGET_UPPER = g1.JOINT_UPPER + _OVERSHOOT


def guard_targets(targets: np.ndarray) -> tuple[np.ndarray, int]:
    """Clamp joint targets ``(29,)``, radians; also returns how many were clamped.

    A target is the end of a spring: near a joint's end it must lie beyond the range to
    give full torque (an ankle could not hold the robot otherwise). What lies further
    out than that asks for more torque than the motor has.
    """
    clamped = np.clip(targets, _TARGET_LOWER, _TARGET_UPPER)
    return clamped, int((clamped != targets).sum())
