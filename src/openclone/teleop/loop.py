"""The 50 Hz loop: operator, robot and odometry in, joint targets out.

It is synchronous: inputs are read as they are at the beginning of the tick, and nothing
in it waits for anything but the next deadline.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from contextlib import nullcontext
from dataclasses import dataclass, field, replace

import numpy as np

from openclone.odometry.protocol import Odometry, OdometryHealth
from openclone.policy.command import Command, KeyPoints
from openclone.policy.controller import StudentController
from openclone.policy.observation import Proprioception
from openclone.robot.kinematics import Kinematics
from openclone.robot.model import CONTROL_PERIOD
from openclone.simulation.robot import RobotReading
from openclone.spatial import rotations
from openclone.spatial.clock import Clock, MonotonicClock, Ticker, Wake
from openclone.teleop.calibration import CalibrationConfig, RobotBody, calibrate
from openclone.teleop.messages import (
    LoopTick,
    OperatorFrame,
    Phase,
    Subscriber,
    TickDurations,
)
from openclone.teleop.operators.protocol import Operator
from openclone.teleop.realtime import (
    collect_garbage,
    interpreter_for_control,
    realtime_priority,
)
from openclone.teleop.robots.protocol import RobotLink
from openclone.teleop.safety import (
    SafetyConfig,
    SafetyInputs,
    SafetyMonitor,
    Trigger,
    guard_targets,
)
from openclone.teleop.tracker import OperatorTracker, TrackerConfig, blend_commands

PERIOD_NS = round(CONTROL_PERIOD * 1e9)


@dataclass(frozen=True)
class LoopConfig:
    """Settings of the loop.

    Attributes:
        calibration, tracker, safety: of those parts.
        auto_start: begin as soon as the operator is calibrated.
        stop_on_fall: end the run when a simulated robot falls.
    """

    calibration: CalibrationConfig = field(default_factory=CalibrationConfig)
    tracker: TrackerConfig = field(default_factory=TrackerConfig)
    safety: SafetyConfig = field(default_factory=SafetyConfig)
    auto_start: bool = True
    stop_on_fall: bool = True


@dataclass(frozen=True)
class LoopStats:
    """How a run went.

    Attributes:
        ticks: control steps.
        overruns: deadlines missed.
        p50_ms, p99_ms, max_ms: duration of a tick, from wake-up to targets out.
        falls: of a simulated robot.
        clamped: joint targets that the guard clamped.
        last_phase: phase at the end.
        stop_reason: what led to DAMPING, or "".
        subscriber_errors: one line per subscriber that failed and was dropped.
    """

    ticks: int
    overruns: int
    p50_ms: float
    p99_ms: float
    max_ms: float
    falls: int
    clamped: int
    last_phase: str
    stop_reason: str
    subscriber_errors: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Inputs:
    """What one tick reads."""

    now_ns: int
    frame: OperatorFrame | None
    reading: RobotReading
    position: np.ndarray
    quat: np.ndarray
    health: OdometryHealth
    measured: KeyPoints

    @property
    def operator_age_ns(self) -> int | None:
        if self.frame is None:
            return None
        return self.now_ns - self.frame.receive_stamp_ns

    def finite(self) -> bool:
        reading = self.reading
        parts = [
            reading.joint_angles,
            reading.joint_velocities,
            reading.angular_velocity_b,
            self.position,
            self.quat,
        ]
        if self.frame is not None:
            parts += [self.frame.positions.ravel(), self.frame.quats.ravel()]
        return bool(np.isfinite(np.concatenate(parts)).all())


class TeleopLoop:
    """One operator drives one robot."""

    def __init__(
        self,
        operator: Operator,
        robot: RobotLink,
        odometry: Odometry,
        controller: StudentController,
        clock: Clock,
        *,
        config: LoopConfig | None = None,
        kinematics: Kinematics | None = None,
        subscribers: Sequence[Subscriber] = (),
    ) -> None:
        """Connect the parts; `run` starts them."""
        self.config = config or LoopConfig()
        self.monitor = SafetyMonitor(self.config.safety)
        self._operator = operator
        self._robot = robot
        self._odometry = odometry
        self._controller = controller
        self._clock = clock
        self._subscribers = list(subscribers)
        self._subscriber_errors: list[str] = []
        self._kinematics = kinematics or Kinematics()
        self._body = RobotBody.of(self._kinematics)
        self._tracker: OperatorTracker | None = None
        self._blend_from: KeyPoints | None = None
        self._command: Command | None = None
        self._rest: np.ndarray | None = None
        self._durations_ns: list[int] = []
        self._clamped = 0
        self._falls = 0
        self._stop_reason = ""

    def run(self, seconds: float | None = None) -> LoopStats:
        """Run for ``seconds``, or until the operator is finished or the robot falls."""
        limit = None if seconds is None else round(seconds / CONTROL_PERIOD)
        ticker = Ticker(self._clock, PERIOD_NS)
        if self.config.auto_start:
            self.monitor.request_start()
        # Only a loop that waits may go before everything else.
        live = isinstance(self._clock, MonotonicClock)
        priority = realtime_priority() if live else nullcontext()
        with interpreter_for_control(), priority:
            self._operator.start(self._clock)
            try:
                while limit is None or len(self._durations_ns) < limit:
                    wake = ticker.wait()
                    tick = self.tick(wake, ticker.overruns)
                    if tick.fallen and self.config.stop_on_fall:
                        break
                    if self._operator.finished(wake.now_ns):
                        break
                    collect_garbage(wake.index)
            finally:
                self._operator.stop()
        return self._stats(ticker.overruns)

    def tick(self, wake: Wake, overruns: int) -> LoopTick:
        """One control step."""
        began = time.perf_counter_ns()
        now = self._read(wake.now_ns)
        truth = self._robot.truth()
        self._follow_operator(now)
        phase = self._supervise(now)
        command = self._choose_command(now, phase)
        read = time.perf_counter_ns()
        targets = self._decide(now, phase, command)
        decided = time.perf_counter_ns()
        phase = self.monitor.phase  # a broken action may have changed it
        if phase is Phase.DAMPING:
            self._robot.damp()
        else:
            self._robot.write(targets)
        ended = time.perf_counter_ns()
        durations = TickDurations(
            read - began, decided - read, ended - decided, ended - began
        )
        self._durations_ns.append(durations.total_ns)
        fallen = truth is not None and truth.fallen
        self._falls += fallen and self._falls == 0
        trigger = self.monitor.trigger
        tick = LoopTick(
            index=wake.index,
            stamp_ns=wake.now_ns,
            phase=phase,
            trigger=trigger.value if trigger else "",
            operator=now.frame,
            command=command,
            measured=now.measured,
            reading=now.reading,
            base_position=now.position,
            base_quat=now.quat,
            action=self._controller.action.copy(),
            targets=targets,
            qpos=truth.qpos if truth else None,
            qvel=truth.qvel if truth else None,
            fallen=fallen,
            durations=durations,
            overruns=overruns,
        )
        self._publish(tick)
        return tick

    def _read(self, now_ns: int) -> _Inputs:
        frame = self._operator.latest(now_ns)
        reading = self._robot.read(now_ns)
        position, odometry_quat = self._odometry.pose_at(now_ns)
        quat = merge_heading(odometry_quat, reading.base_quat)
        qpos = np.concatenate((position, quat, reading.joint_angles))
        points, quats = self._kinematics.key_points(qpos)
        health = self._odometry.health(now_ns)
        return _Inputs(
            now_ns, frame, reading, position, quat, health, KeyPoints(points, quats)
        )

    def _follow_operator(self, now: _Inputs) -> None:
        """Calibrate with the first frame and keep the tracker fed."""
        if now.frame is None or not now.finite():
            return
        if self._tracker is None:
            if not (now.health.tracking and now.frame.tracked.all()):
                return
            calibration = calibrate(
                now.frame.positions,
                now.frame.quats,
                now.measured,
                rotations.heading(now.quat),
                self._body,
                self.config.calibration,
            )
            self._tracker = OperatorTracker(calibration, self.config.tracker)
        self._tracker.update(now.frame)

    def _supervise(self, now: _Inputs) -> Phase:
        before = self.monitor.phase
        phase = self.monitor.update(
            SafetyInputs(
                now_ns=now.now_ns,
                calibrated=self._tracker is not None,
                operator_age_ns=now.operator_age_ns,
                odometry_tracking=now.health.tracking,
                odometry_age_ns=now.health.age_ns,
                base_position=now.position,
                base_quat=now.quat,
                finite=now.finite(),
            )
        )
        if phase is not before:
            if phase is Phase.RAMP:
                self._blend_from = now.measured
            elif before is Phase.HOLD and phase is Phase.ACTIVE:
                assert self._command is not None
                self._blend_from = self._command.target
                if self._tracker is not None and now.frame is not None:
                    self._tracker.resume(now.frame)
        return phase

    def _choose_command(self, now: _Inputs, phase: Phase) -> Command | None:
        """The targets for the next step, or None where the robot is not driven."""
        if phase in (Phase.IDLE, Phase.READY, Phase.DAMPING):
            return None
        if phase is Phase.HOLD and self._command is not None:
            held = replace(self._command, velocity=np.zeros((3, 3)))
            self._command = held
            return held
        assert self._tracker is not None
        assert self._blend_from is not None
        stale = self.monitor.operator_stale(now.operator_age_ns or 0)
        command = self._tracker.command(now.now_ns, stale)
        weight = self.monitor.blend(now.now_ns)
        self._command = blend_commands(self._blend_from, command, weight)
        return self._command

    def _decide(
        self, now: _Inputs, phase: Phase, command: Command | None
    ) -> np.ndarray:
        """Joint targets ``(29,)``, radians, guarded."""
        if self._rest is None:
            self._rest = now.reading.joint_angles.copy()
        if command is None:
            return self._rest
        reading = now.reading
        sensed = Proprioception(
            joint_angles=reading.joint_angles,
            joint_velocities=reading.joint_velocities,
            angular_velocity_b=reading.angular_velocity_b,
            base_quat=now.quat,
        )
        targets = self._controller.step(command, sensed, now.measured)
        if not np.isfinite(targets).all():
            self.monitor.fault(Trigger.NOT_FINITE)
            return self._rest
        targets, clamped = guard_targets(targets)
        self._clamped += clamped
        return targets

    def _publish(self, tick: LoopTick) -> None:
        """Hand the tick out; a subscriber that fails is dropped, the loop goes on."""
        if self.monitor.trigger and tick.phase is Phase.DAMPING:
            self._stop_reason = self.monitor.trigger.value
        for subscriber in tuple(self._subscribers):
            try:
                subscriber.put(tick)
            except Exception as error:  # whatever it is, the robot must not stop for it
                self._subscribers.remove(subscriber)
                self._subscriber_errors.append(f"{type(subscriber).__name__}: {error}")

    def _stats(self, overruns: int) -> LoopStats:
        milliseconds = np.array(self._durations_ns or [0]) * 1e-6
        return LoopStats(
            ticks=len(self._durations_ns),
            overruns=overruns,
            p50_ms=float(np.percentile(milliseconds, 50)),
            p99_ms=float(np.percentile(milliseconds, 99)),
            max_ms=float(milliseconds.max()),
            falls=self._falls,
            clamped=self._clamped,
            last_phase=self.monitor.phase.name,
            stop_reason=self._stop_reason,
            subscriber_errors=tuple(self._subscriber_errors),
        )


def merge_heading(odometry_quat: np.ndarray, imu_quat: np.ndarray) -> np.ndarray:
    """Odometry's heading with the IMU's roll and pitch, wxyz.

    The IMU knows which way is down better than any odometry, but its heading drifts.
    """
    turn = rotations.yaw(odometry_quat) - rotations.yaw(imu_quat)
    return rotations.multiply(rotations.from_yaw(turn), imu_quat)
