from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from teleop_fakes import ARMS_DOWN, STANDING_HUMAN, constant_bundle

from openclone.odometry.ground_truth import GroundTruthOdometry
from openclone.policy.controller import StudentController
from openclone.robot import g1
from openclone.robot.kinematics import Kinematics
from openclone.robot.model import standing_qpos
from openclone.simulation.robot import RobotReading
from openclone.spatial import rotations
from openclone.spatial.clock import Clock, ManualClock
from openclone.teleop.loop import LoopConfig, LoopStats, TeleopLoop, merge_heading
from openclone.teleop.messages import LoopTick, OperatorFrame, Phase

MS = 1_000_000
KINEMATICS = Kinematics()


class FrozenRobot:
    """Stands whatever it is told; remembers what it was told."""

    def __init__(self, odometry: GroundTruthOdometry) -> None:
        self.odometry = odometry
        self.reading = RobotReading(
            g1.DEFAULT_POSE.copy(),
            np.zeros(29),
            np.zeros(29),
            np.array(rotations.IDENTITY),
            np.zeros(3),
        )
        self.written: list[np.ndarray | None] = []
        self.position = standing_qpos()[:3]
        self.odometry_works = True

    def read(self, now_ns: int) -> RobotReading:
        if self.odometry_works:
            quat = np.array(rotations.IDENTITY)
            self.odometry.observe(now_ns, self.position, quat, np.zeros(3))
        return self.reading

    def write(self, joint_targets: np.ndarray) -> None:
        self.written.append(joint_targets.copy())

    def damp(self) -> None:
        self.written.append(None)

    def truth(self) -> None:
        return None


class ScriptedOperator:
    """Walks ahead at 0.5 m/s; ``silent`` holds the spans without frames, seconds."""

    def __init__(self, silent: tuple[tuple[float, float], ...] = ()) -> None:
        self.silent = silent
        self.broken_from_s = np.inf

    def start(self, clock: Clock) -> None:
        self._start_ns = clock.now_ns()

    def stop(self) -> None: ...

    def latest(self, now_ns: int) -> OperatorFrame | None:
        t = (now_ns - self._start_ns) * 1e-9
        for first, last in self.silent:
            if first <= t < last:
                t = first
        stamp = round(t * 1e9)
        positions = STANDING_HUMAN + np.array([0.5 * t, 0, 0])
        if t >= self.broken_from_s:
            positions[1, 2] = np.nan
        receive = self._start_ns + stamp
        return OperatorFrame(stamp, receive, positions, ARMS_DOWN, np.ones(3, bool))

    def finished(self, now_ns: int) -> bool:
        return False


class Collector:
    def __init__(self) -> None:
        self.ticks: list[LoopTick] = []

    def put(self, value: LoopTick, /) -> None:
        self.ticks.append(value)


class Rig:
    """A loop with everything scripted."""

    def __init__(
        self,
        operator: ScriptedOperator | None = None,
        action: float = 0.0,
        clock: ManualClock | None = None,
        subscribers: tuple[Any, ...] = (),
    ) -> None:
        self.odometry = GroundTruthOdometry(None, np.random.default_rng(0))
        self.robot = FrozenRobot(self.odometry)
        self.collector = Collector()
        self.loop = TeleopLoop(
            operator or ScriptedOperator(),
            self.robot,
            self.odometry,
            StudentController(constant_bundle(action)),
            clock or ManualClock(12345),
            config=LoopConfig(),
            kinematics=KINEMATICS,
            subscribers=(*subscribers, self.collector),
        )

    def run(self, seconds: float) -> LoopStats:
        return self.loop.run(seconds)

    def phases(self) -> list[Phase]:
        return [tick.phase for tick in self.collector.ticks]


def test_start_ramp_and_active_follow_each_other_on_time() -> None:
    rig = Rig()
    stats = rig.run(1.5)
    phases = rig.phases()
    assert phases[:2] == [Phase.READY, Phase.RAMP]
    assert phases[50] is Phase.RAMP
    assert phases[51] is Phase.ACTIVE  # one second after the ramp began
    assert stats.ticks == 75
    assert stats.overruns == 0
    assert stats.last_phase == "ACTIVE"


def test_ticks_lie_exactly_20_ms_apart() -> None:
    rig = Rig()
    rig.run(0.5)
    stamps = np.array([tick.stamp_ns for tick in rig.collector.ticks])
    np.testing.assert_array_equal(np.diff(stamps), 20 * MS)


def test_the_ramp_begins_at_the_measured_points() -> None:
    rig = Rig()
    rig.run(1.5)
    first = rig.collector.ticks[1]
    assert first.command is not None
    np.testing.assert_allclose(
        first.command.target.position, first.measured.position, atol=1e-9
    )
    np.testing.assert_array_equal(first.command.velocity, 0.0)
    steps = [
        np.linalg.norm(b.command.target.position - a.command.target.position, axis=1)
        for a, b in zip(rig.collector.ticks[1:], rig.collector.ticks[2:], strict=False)
        if a.command and b.command
    ]
    assert np.max(steps) < 0.03  # nothing leaps: 1.5 m/s at most


def test_the_command_walks_ahead_with_the_operator() -> None:
    rig = Rig()
    rig.run(3.0)
    ticks = rig.collector.ticks
    a, b = ticks[100].command, ticks[140].command
    assert a is not None
    assert b is not None
    moved = b.target.position[0] - a.target.position[0]
    scale = 1.227675 / 1.6
    np.testing.assert_allclose(moved, [0.5 * 0.8 * scale, 0, 0], atol=0.005)
    np.testing.assert_allclose(b.velocity[0], [0.5 * scale, 0, 0], atol=0.01)


def test_targets_are_the_default_pose_plus_the_scaled_action() -> None:
    rig = Rig(action=0.5)
    rig.run(0.2)
    expected = g1.DEFAULT_POSE + 0.5 * g1.ACTION_SCALE
    np.testing.assert_allclose(rig.robot.written[-1], expected, atol=1e-6)


def test_a_silent_operator_is_held_then_paused_then_taken_up_again() -> None:
    rig = Rig(ScriptedOperator(silent=((2.0, 2.6),)))
    stats = rig.run(4.0)
    ticks = rig.collector.ticks
    at = {round(tick.index * 0.02, 2): tick for tick in ticks}
    held = at[2.14]
    assert held.phase is Phase.ACTIVE
    assert held.command is not None
    np.testing.assert_array_equal(held.command.velocity, 0.0)
    paused = at[2.4]
    assert paused.phase is Phase.HOLD
    assert paused.command is not None
    np.testing.assert_allclose(
        paused.command.target.position, held.command.target.position
    )
    back = at[2.6]
    assert back.phase is Phase.ACTIVE
    assert back.trigger == "operator back"
    assert back.command is not None
    np.testing.assert_allclose(
        back.command.target.position, paused.command.target.position, atol=1e-9
    )
    assert stats.last_phase == "ACTIVE"


def test_a_nan_from_the_operator_damps() -> None:
    operator = ScriptedOperator()
    operator.broken_from_s = 1.5
    rig = Rig(operator)
    stats = rig.run(2.0)
    assert rig.phases()[75:] == [Phase.DAMPING] * 25
    assert stats.stop_reason == "a value is not finite"
    assert rig.robot.written[75:] == [None] * 25


def test_a_nan_action_never_reaches_the_robot() -> None:
    rig = Rig(action=float("nan"))
    stats = rig.run(0.5)
    assert stats.last_phase == "DAMPING"
    assert all(row is None or np.isfinite(row).all() for row in rig.robot.written)
    assert rig.robot.written[1] is None  # the very tick in which it appeared


def test_an_odometry_that_stops_or_jumps_damps() -> None:
    rig = Rig()
    rig.run(1.2)
    rig.robot.odometry_works = False
    stats = rig.run(1.5)  # 1.5 s counts all ticks of this loop
    assert stats.stop_reason == "odometry stale"
    rig = Rig()
    rig.run(1.2)
    rig.robot.position = np.add(rig.robot.position, [0.5, 0, 0])
    assert rig.run(1.3).stop_reason == "odometry jump"


def test_a_tipping_robot_damps() -> None:
    rig = Rig()
    rig.run(0.3)
    tipped = rotations.from_axis_angle(np.array([1.0, 0, 0]), np.radians(85))
    rig.robot.reading = replace(rig.robot.reading, base_quat=tipped)
    assert rig.run(0.4).stop_reason == "tilt limit"


def test_the_operators_stop_damps() -> None:
    rig = Rig()
    rig.run(0.3)
    rig.loop.monitor.request_stop()
    assert rig.run(0.4).stop_reason == "operator stop"


def test_absurd_actions_are_clamped_and_counted() -> None:
    rig = Rig(action=1000.0)
    stats = rig.run(0.2)
    assert stats.clamped == 29 * 9  # every joint in every tick after the first
    last = rig.robot.written[-1]
    assert last is not None
    assert (g1.KP * (last - g1.JOINT_UPPER) <= g1.MAX_TORQUE + 1e-9).all()


def test_a_failing_subscriber_is_dropped_and_the_robot_goes_on() -> None:
    class Broken:
        calls = 0

        def put(self, value: LoopTick, /) -> None:
            self.calls += 1
            raise RuntimeError("disk full")

    broken = Broken()
    rig = Rig(subscribers=(broken,))
    stats = rig.run(0.5)
    assert stats.ticks == len(rig.collector.ticks) == 25
    assert broken.calls == 1
    assert stats.subscriber_errors == ("Broken: disk full",)


def test_slow_ticks_count_as_overruns_and_keep_the_grid() -> None:
    clock = ManualClock()

    class Slow:
        def put(self, value: LoopTick, /) -> None:
            clock.advance(45 * MS if value.index == 10 else 1 * MS)

    rig = Rig(clock=clock, subscribers=(Slow(),))
    stats = rig.run(0.5)
    assert stats.overruns == 2
    stamps = np.array([tick.stamp_ns for tick in rig.collector.ticks])
    assert set(np.diff(stamps)) <= {20 * MS, 45 * MS, 15 * MS}
    assert stamps[12] == 13 * 20 * MS  # back on the grid


def test_heading_comes_from_odometry_and_tilt_from_the_imu() -> None:
    odometry = rotations.from_euler(np.array([0.8, 0.1, 0.0]), "ZYX")
    imu = rotations.from_euler(np.array([-2.0, 0.0, 0.2]), "ZYX")
    merged = merge_heading(odometry, imu)
    assert rotations.yaw(merged) == pytest.approx(0.8)
    expected = rotations.from_euler(np.array([0.8, 0.0, 0.2]), "ZYX")
    assert rotations.angle_between(merged, expected) < 1e-9
