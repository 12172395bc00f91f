import numpy as np
import pytest

from openclone.policy.command import KeyPoints
from openclone.policy.governor import Governor, GovernorConfig
from openclone.spatial import rotations

HEAD_AND_HANDS = np.array([[0.0, 0.0, 1.2], [0.3, 0.2, 0.9], [0.3, -0.2, 0.9]])
PERIOD = 0.01


def posed(place: tuple[float, float, float] = (0, 0, 0), yaw: float = 0.0) -> KeyPoints:
    """Head and hands moved and turned together about the head."""
    turn = np.tile(rotations.from_yaw(np.array(yaw)), (3, 1))
    head = HEAD_AND_HANDS[0]
    around = rotations.rotate(turn, HEAD_AND_HANDS - head)
    return KeyPoints(head + np.array(place) + around, turn)


def rigid(points: KeyPoints) -> None:
    """Hands where they belong, seen from the head."""
    back = np.tile(rotations.conjugate(points.quat[0]), (3, 1))
    seen = rotations.rotate(back, points.position - points.position[0])
    np.testing.assert_allclose(seen, HEAD_AND_HANDS - HEAD_AND_HANDS[0], atol=1e-9)


def test_a_slow_operator_is_left_alone():
    governor = Governor()
    for step in range(300):
        wanted = posed((0.25 * step * PERIOD, 0, 0.0), 0.3 * np.sin(step * PERIOD))
        got = governor.follow(wanted, PERIOD)
        np.testing.assert_allclose(got.position, wanted.position, atol=1e-12)
        np.testing.assert_allclose(got.quat, wanted.quat, atol=1e-12)


def test_a_leap_is_followed_at_the_robots_rates():
    config = GovernorConfig()
    governor = Governor(config)
    governor.follow(posed(), PERIOD)
    wanted, places, yaws = posed((3.0, -4.0, -0.5), 2.0), [], []
    for _ in range(200):
        got = governor.follow(wanted, PERIOD)
        rigid(got)
        places.append(got.position[0])
        yaws.append(float(rotations.yaw(got.quat[0])))
    steps = np.diff(np.array(places), axis=0) / PERIOD
    speed = np.linalg.norm(steps[:, :2], axis=1)
    assert speed.max() == pytest.approx(config.travel_speed)
    # Begins with what needs no run-up, then gains by the acceleration allowed.
    assert speed[0] == pytest.approx(0.3, abs=0.02)
    assert np.diff(speed).max() <= config.travel_acceleration * PERIOD + 1e-9
    np.testing.assert_allclose(steps[:, 1] / steps[:, 0], -4 / 3)
    np.testing.assert_allclose([place[2] for place in places], 1.2 - 0.5)
    turning = np.diff(yaws) / PERIOD
    np.testing.assert_allclose(turning, config.turn_speed)


def test_it_arrives_exactly_and_turns_the_short_way():
    governor = Governor()
    governor.follow(posed(yaw=3.0), PERIOD)
    wanted = posed((0.5, 0.5, 0.1), -3.0)
    first = governor.follow(wanted, PERIOD)
    assert abs(float(rotations.yaw(first.quat[0]))) > 3.0
    for _ in range(400):
        got = governor.follow(wanted, PERIOD)
    np.testing.assert_allclose(got.position, wanted.position, atol=1e-9)
    assert rotations.angle_between(got.quat, wanted.quat).max() < 1e-6


def test_after_a_reset_the_next_pose_counts():
    governor = Governor()
    governor.follow(posed(), PERIOD)
    governor.reset()
    wanted = posed((2.0, 0, 0), 1.0)
    got = governor.follow(wanted, PERIOD)
    np.testing.assert_array_equal(got.position, wanted.position)
