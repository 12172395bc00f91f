import numpy as np
import pytest
from teleop_fakes import ARMS_DOWN, STANDING_HUMAN

from openclone.policy.command import Command, KeyPoints
from openclone.robot.kinematics import Kinematics
from openclone.robot.model import standing_qpos
from openclone.spatial import rotations
from openclone.teleop.calibration import (
    Calibration,
    CalibrationConfig,
    RobotBody,
    calibrate,
)
from openclone.teleop.messages import OperatorFrame
from openclone.teleop.tracker import OperatorTracker, TrackerConfig, blend_commands

PERIOD_NS = 11_111_111
ALL = np.ones(3, dtype=bool)


@pytest.fixture(scope="module")
def calibration() -> Calibration:
    kinematics = Kinematics()
    standing = KeyPoints(*kinematics.key_points(standing_qpos()))
    return calibrate(
        STANDING_HUMAN,
        ARMS_DOWN,
        standing,
        np.array(rotations.IDENTITY),
        RobotBody.of(kinematics),
        CalibrationConfig(),
    )


def frame(
    index: int, positions: np.ndarray, tracked: np.ndarray = ALL
) -> OperatorFrame:
    stamp = index * PERIOD_NS
    return OperatorFrame(stamp, stamp + 10**12, positions, ARMS_DOWN, tracked)


def walk(tracker: OperatorTracker, count: int, speed: float) -> OperatorFrame:
    for index in range(count):
        ahead = np.array([speed * index * PERIOD_NS * 1e-9, 0, 0])
        last = frame(index, STANDING_HUMAN + ahead)
        tracker.update(last)
    return last


def test_a_steady_walk_is_followed_without_lag_at_the_next_step(
    calibration: Calibration,
) -> None:
    tracker = OperatorTracker(calibration)
    last = walk(tracker, 300, 0.7)
    command = tracker.command(last.receive_stamp_ns, stale=False)
    scale = calibration.travel_scale
    speed = 0.7 * scale
    np.testing.assert_allclose(command.velocity[0], [speed, 0, 0], atol=1e-3)
    ideal = calibration.apply(last.positions, last.quats).position[0, 0] + 0.02 * speed
    assert abs(command.target.position[0, 0] - ideal) < 0.02


def test_a_stale_operator_is_held_with_zero_velocity(calibration: Calibration) -> None:
    tracker = OperatorTracker(calibration)
    last = walk(tracker, 100, 1.0)
    late = last.receive_stamp_ns + 100_000_000
    held = tracker.command(late, stale=True)
    np.testing.assert_array_equal(held.velocity, 0.0)
    fresh = tracker.command(last.receive_stamp_ns, stale=False)
    assert held.target.position[0, 0] < fresh.target.position[0, 0]


def test_extrapolation_is_bounded(calibration: Calibration) -> None:
    tracker = OperatorTracker(calibration)
    last = walk(tracker, 100, 1.0)
    now = tracker.command(last.receive_stamp_ns, stale=False)
    much_later = tracker.command(last.receive_stamp_ns + 10**9, stale=False)
    step = much_later.target.position[0, 0] - now.target.position[0, 0]
    assert 0 < step <= 0.04 * now.velocity[0, 0] + 1e-9


def test_the_same_frame_twice_changes_nothing(calibration: Calibration) -> None:
    tracker = OperatorTracker(calibration)
    last = walk(tracker, 50, 1.0)
    before = tracker.command(last.receive_stamp_ns, stale=False)
    tracker.update(last)
    after = tracker.command(last.receive_stamp_ns, stale=False)
    np.testing.assert_array_equal(before.target.position, after.target.position)


def test_a_lost_hand_goes_with_the_head(calibration: Calibration) -> None:
    tracker = OperatorTracker(calibration)
    for index in range(200):
        ahead = np.array([0.5 * index * PERIOD_NS * 1e-9, 0, 0])
        positions = STANDING_HUMAN + ahead
        tracked = ALL
        if index >= 100:  # the left hand's pose freezes in the room
            positions[1] = STANDING_HUMAN[1] + 0.5 * 100 * PERIOD_NS * 1e-9
            tracked = np.array([True, False, True])
        last = frame(index, positions, tracked)
        tracker.update(last)
    target = tracker.command(last.receive_stamp_ns, stale=False).target.position
    # Both hands hang beside the head as in the beginning.
    np.testing.assert_allclose(
        target[1] - target[0], (target[2] - target[0]) * [1, -1, 1], atol=0.01
    )


def test_a_jump_of_a_wrist_is_rejected(calibration: Calibration) -> None:
    tracker = OperatorTracker(calibration)
    walk(tracker, 50, 0.0)
    thrown = STANDING_HUMAN.copy()
    thrown[1] += [1.5, 0, 0]
    tracker.update(frame(50, thrown))
    command = tracker.command(50 * PERIOD_NS + 10**12, stale=False)
    expected = calibration.apply(STANDING_HUMAN, ARMS_DOWN).position
    np.testing.assert_allclose(command.target.position, expected, atol=1e-3)


def test_a_lasting_jump_of_a_wrist_is_believed_in_the_end(
    calibration: Calibration,
) -> None:
    tracker = OperatorTracker(calibration)
    walk(tracker, 50, 0.0)
    moved = STANDING_HUMAN.copy()
    moved[1] += [0.4, 0, 0.3]
    for index in range(50, 150):
        tracker.update(frame(index, moved))
        velocity = tracker.command(0, stale=False).velocity
        assert np.linalg.norm(velocity, axis=1).max() <= 4.0 + 1e-9
    command = tracker.command(149 * PERIOD_NS + 10**12, stale=False)
    expected = calibration.apply(moved, ARMS_DOWN).position
    np.testing.assert_allclose(command.target.position, expected, atol=1e-3)


def test_when_the_whole_operator_jumps_the_robot_stays(
    calibration: Calibration,
) -> None:
    tracker = OperatorTracker(calibration)
    walk(tracker, 50, 0.0)
    quarter = rotations.from_yaw(np.full(3, np.pi / 2))
    elsewhere = np.add(rotations.rotate(quarter, STANDING_HUMAN), [2.0, -1.0, 0.0])
    turned = rotations.multiply(quarter, ARMS_DOWN)
    expected = calibration.apply(STANDING_HUMAN, ARMS_DOWN).position
    for index in range(50, 150):
        stamp = index * PERIOD_NS
        tracker.update(OperatorFrame(stamp, stamp, elsewhere, turned, ALL))
        command = tracker.command(stamp, stale=False)
        assert np.linalg.norm(command.velocity, axis=1).max() < 0.1
    np.testing.assert_allclose(command.target.position, expected, atol=1e-3)


def test_a_short_gap_keeps_the_map_and_a_long_way_moves_it(
    calibration: Calibration,
) -> None:
    for way, moves in ((0.3, False), (1.5, True)):
        tracker = OperatorTracker(calibration)
        walk(tracker, 50, 0.0)
        there = STANDING_HUMAN + np.array([way, 0, 0])
        tracker.resume(frame(100, there))
        target = tracker.command(100 * PERIOD_NS + 10**12, stale=False).target
        honest = calibration.apply(there, ARMS_DOWN).position
        before = calibration.apply(STANDING_HUMAN, ARMS_DOWN).position
        expected = before if moves else honest
        np.testing.assert_allclose(target.position, expected, atol=1e-6)


@pytest.mark.parametrize("look", [True, False])
def test_who_looks_around_freely_says_so(calibration: Calibration, look: bool) -> None:
    tracker = OperatorTracker(calibration, TrackerConfig(look=look))
    last = walk(tracker, 20, 0.5)
    for stale in (True, False):
        command = tracker.command(last.receive_stamp_ns, stale)
        assert command.look == float(look)
        blended = blend_commands(command.target, command, 0.5)
        assert blended.look == float(look)


def test_blend_begins_and_ends_exactly_and_rises_smoothly() -> None:
    rng = np.random.default_rng(0)
    quats = rotations.normalize(rng.standard_normal((2, 3, 4)))
    start = KeyPoints(rng.standard_normal((3, 3)), quats[0])
    end = KeyPoints(rng.standard_normal((3, 3)), quats[1])
    command = Command(end, np.ones((3, 3)))
    first, last = (
        blend_commands(start, command, 0.0),
        blend_commands(start, command, 1.0),
    )
    np.testing.assert_allclose(first.target.position, start.position)
    np.testing.assert_array_equal(first.velocity, 0.0)
    np.testing.assert_array_equal(last.target.position, end.position)
    half = blend_commands(start, command, 0.5)
    middle = 0.5 * (start.position + end.position)
    np.testing.assert_allclose(half.target.position, middle)
    to_start = rotations.angle_between(half.target.quat, start.quat)
    np.testing.assert_allclose(
        to_start, rotations.angle_between(half.target.quat, end.quat), atol=1e-9
    )


def test_a_runner_is_followed_at_the_robots_speed_and_caught_up_with(
    calibration: Calibration,
) -> None:
    tracker = OperatorTracker(calibration)
    last = walk(tracker, 180, 3.0)
    wanted = calibration.apply(last.positions, last.quats).position
    held = tracker.command(last.receive_stamp_ns, stale=True).target.position
    seconds = 179 * PERIOD_NS * 1e-9
    # From 0.3 m/s at 1.5 m/s² to 0.9 m/s.
    rising = (0.9 - 0.3) / 1.5
    way = 0.5 * (0.3 + 0.9) * rising + 0.9 * (seconds - rising)
    assert held[0, 0] == pytest.approx(way, abs=0.1)
    # Hands stay where they are relative to the head.
    np.testing.assert_allclose(held - held[0], wanted - wanted[0], atol=0.02)
    for index in range(180, 1200):
        tracker.update(frame(index, last.positions))
    caught = tracker.command(10**12 + 1200 * PERIOD_NS, stale=True).target.position
    np.testing.assert_allclose(caught, wanted, atol=0.01)
