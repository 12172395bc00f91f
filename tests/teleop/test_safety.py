from dataclasses import replace

import numpy as np
import pytest

from openclone.robot import g1
from openclone.spatial import rotations
from openclone.teleop.messages import Phase
from openclone.teleop.safety import (
    FAULTS,
    TRANSITIONS,
    SafetyConfig,
    SafetyInputs,
    SafetyMonitor,
    Trigger,
    guard_targets,
    tilt_deg,
)

MS = 1_000_000
FINE = SafetyInputs(
    now_ns=0,
    calibrated=True,
    operator_age_ns=5 * MS,
    odometry_tracking=True,
    odometry_age_ns=0,
    base_position=np.zeros(3),
    base_quat=np.array(rotations.IDENTITY),
)
TIPPED = rotations.from_axis_angle(np.array([0.0, 1.0, 0.0]), np.radians(80))


def monitor_in(phase: Phase) -> SafetyMonitor:
    """A monitor brought to ``phase`` by events alone; its clock stands at 2 s."""
    monitor = SafetyMonitor()
    if phase is Phase.IDLE:
        return monitor
    monitor.update(FINE)
    if phase is Phase.READY:
        return monitor
    monitor.request_start()
    monitor.update(FINE)
    if phase is Phase.RAMP:
        return monitor
    monitor.update(replace(FINE, now_ns=2000 * MS))
    if phase is Phase.HOLD:
        monitor.update(replace(FINE, now_ns=2000 * MS, operator_age_ns=300 * MS))
    if phase is Phase.DAMPING:
        monitor.request_stop()
        monitor.update(replace(FINE, now_ns=2000 * MS))
    assert monitor.phase is phase
    return monitor


def test_the_normal_course() -> None:
    monitor = SafetyMonitor()
    assert monitor.phase is Phase.IDLE
    assert monitor.update(replace(FINE, calibrated=False)) is Phase.IDLE
    assert monitor.update(FINE) is Phase.READY
    assert monitor.update(FINE) is Phase.READY  # waits for the start
    monitor.request_start()
    assert monitor.update(FINE) is Phase.RAMP
    assert monitor.blend(0) == 0.0
    assert monitor.update(replace(FINE, now_ns=500 * MS)) is Phase.RAMP
    assert monitor.blend(500 * MS) == pytest.approx(0.5)
    assert monitor.update(replace(FINE, now_ns=1000 * MS)) is Phase.ACTIVE
    assert monitor.trigger is Trigger.RAMP_DONE
    assert monitor.update(replace(FINE, now_ns=1020 * MS)) is Phase.ACTIVE
    assert monitor.trigger is None


@pytest.mark.parametrize("age", [None, 251 * MS])
def test_ready_falls_back_without_an_operator(age: int | None) -> None:
    monitor = monitor_in(Phase.READY)
    assert monitor.update(replace(FINE, operator_age_ns=age)) is Phase.IDLE


def test_idle_needs_operator_odometry_and_calibration() -> None:
    for change in (
        {"operator_age_ns": None},
        {"odometry_tracking": False},
        {"odometry_age_ns": 300 * MS},
        {"calibrated": False},
        {"finite": False},
    ):
        assert SafetyMonitor().update(replace(FINE, **change)) is Phase.IDLE


@pytest.mark.parametrize("phase", [Phase.RAMP, Phase.ACTIVE])
def test_a_lost_operator_pauses(phase: Phase) -> None:
    monitor = monitor_in(phase)
    lost = replace(FINE, now_ns=2000 * MS, operator_age_ns=251 * MS)
    assert monitor.update(lost) is Phase.HOLD


def test_between_80_and_250_ms_the_phase_stays_but_the_pose_is_held() -> None:
    monitor = monitor_in(Phase.ACTIVE)
    late = replace(FINE, now_ns=2000 * MS, operator_age_ns=200 * MS)
    assert monitor.update(late) is Phase.ACTIVE
    assert monitor.operator_stale(81 * MS)
    assert not monitor.operator_stale(80 * MS)


def test_the_returning_operator_is_blended_in() -> None:
    monitor = monitor_in(Phase.HOLD)
    assert monitor.update(replace(FINE, now_ns=3000 * MS)) is Phase.ACTIVE
    assert monitor.trigger is Trigger.OPERATOR_BACK
    assert monitor.blend(3000 * MS) == 0.0
    assert monitor.blend(3250 * MS) == pytest.approx(0.25)
    assert monitor.blend(4000 * MS) == 1.0


BREAK = {
    Trigger.NOT_FINITE: {"finite": False},
    Trigger.TILT: {"base_quat": TIPPED},
    Trigger.ODOMETRY_STALE: {"odometry_age_ns": 201 * MS},
    Trigger.ODOMETRY_JUMP: {"base_position": np.array([0.31, 0.0, 0.0])},
    Trigger.OPERATOR_STOP: {},
}


@pytest.mark.parametrize("phase", [Phase.READY, Phase.RAMP, Phase.ACTIVE, Phase.HOLD])
@pytest.mark.parametrize("fault", FAULTS)
def test_every_fault_stops_from_every_driven_phase(
    phase: Phase, fault: Trigger
) -> None:
    monitor = monitor_in(phase)
    if fault is Trigger.OPERATOR_STOP:
        monitor.request_stop()
    broken = replace(FINE, now_ns=2000 * MS, **BREAK[fault])
    assert monitor.update(broken) is Phase.DAMPING
    assert monitor.trigger is fault


def test_a_lost_track_is_a_stale_odometry() -> None:
    monitor = monitor_in(Phase.ACTIVE)
    lost = replace(FINE, now_ns=2000 * MS, odometry_tracking=False)
    assert monitor.update(lost) is Phase.DAMPING


def test_a_broken_action_stops_within_the_tick() -> None:
    monitor = monitor_in(Phase.ACTIVE)
    monitor.fault(Trigger.NOT_FINITE)
    assert monitor.phase is Phase.DAMPING


def test_damping_lasts_until_the_reset() -> None:
    monitor = monitor_in(Phase.DAMPING)
    monitor.request_start()
    for tick in range(5):
        assert monitor.update(replace(FINE, now_ns=tick * MS)) is Phase.DAMPING
    monitor.reset()
    assert monitor.update(FINE) is Phase.READY


def test_the_gravest_trigger_wins() -> None:
    monitor = monitor_in(Phase.ACTIVE)
    both = replace(FINE, now_ns=2000 * MS, operator_age_ns=None, finite=False)
    assert monitor.update(both) is Phase.DAMPING


def test_a_wandering_odometry_is_no_jump() -> None:
    monitor = monitor_in(Phase.ACTIVE)
    for step in range(20):
        moved = replace(
            FINE, now_ns=2000 * MS, base_position=np.array([0.2 * step, 0, 0])
        )
        assert monitor.update(moved) is Phase.ACTIVE


def test_every_transition_stands_in_the_table_only_once_and_damping_is_final() -> None:
    assert not any(phase is Phase.DAMPING for phase, _ in TRANSITIONS)
    reachable = {Phase.IDLE, *TRANSITIONS.values()}
    assert reachable == set(Phase)


def test_tilt_of_known_rotations() -> None:
    assert tilt_deg(np.array(rotations.IDENTITY)) == pytest.approx(0.0)
    assert tilt_deg(rotations.from_yaw(np.array(2.0))) == pytest.approx(0.0, abs=1e-6)
    assert tilt_deg(TIPPED) == pytest.approx(80.0)
    assert SafetyConfig().tilt_limit_deg < 80.0


def test_guard_lets_the_standing_pose_pass_and_clamps_the_absurd() -> None:
    same, clamped = guard_targets(g1.DEFAULT_POSE)
    np.testing.assert_array_equal(same, g1.DEFAULT_POSE)
    assert clamped == 0
    absurd = g1.DEFAULT_POSE.copy()
    absurd[[3, 20]] = [50.0, -50.0]
    safe, clamped = guard_targets(absurd)
    assert clamped == 2
    # At its end stop the joint gets full torque, and no more.
    knee = g1.JOINTS[3]
    torque = knee.motor.kp * (safe[3] - knee.upper)
    assert torque == pytest.approx(knee.motor.max_torque)
