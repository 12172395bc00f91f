"""The offset of two clocks from rotations of an analytic walk and of an even turn."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from openclone.odometry.clock_offset import ClockConfig, ClockOffset, LidarTurn
from openclone.spatial import rotations
from room_stream import imu_pose, imu_readings

BEGIN_S, SCAN_S = 8.0, 0.1


def walk_pose(times: np.ndarray) -> np.ndarray:
    """Quaternions ``(n, 4)`` of the walk."""
    return imu_pose(times)[1]


def walk_rate(times: np.ndarray) -> np.ndarray:
    """Rates ``(n, 3)``, rad/s, of the walk."""
    return imu_readings(times)[0]


def turn_pose(times: np.ndarray) -> np.ndarray:
    """Quaternions of a turn at 2 rad/s about the vertical axis."""
    return rotations.from_yaw(2.0 * times)


def turn_rate(times: np.ndarray) -> np.ndarray:
    """Rates of that turn."""
    return np.tile((0.0, 0.0, 2.0), (len(times), 1))


def find(
    late_s: float,
    *,
    scans: int = 6,
    jump: int = 0,
    turn_sigma: float = 0.0,
    ahead_s: float = 0.2,
    pose: Callable[[np.ndarray], np.ndarray] = walk_pose,
    rate: Callable[[np.ndarray], np.ndarray] = walk_rate,
) -> float:
    """What is found when the LiDAR stamps scans too early, from scan ``jump`` on.

    The gyroscope is known until ``ahead_s`` after the stamp of the newest scan.
    """
    rng = np.random.default_rng(0)
    clock = ClockOffset(ClockConfig())
    middles = BEGIN_S + SCAN_S * np.arange(scans)
    noise = rotations.from_rotation_vector(turn_sigma * rng.standard_normal((scans, 3)))
    seen = rotations.to_matrix(rotations.multiply(pose(middles), noise))
    stamps = middles - late_s * (np.arange(scans) >= jump)
    for stamp, rot in zip(stamps, seen, strict=True):
        clock.take(LidarTurn(round(stamp * 1e9), rot))
    last = round(200 * (stamps[-1] + ahead_s))
    readings = np.arange(round(200 * (BEGIN_S - 0.4)), last) / 200
    change_ns = clock.update(
        clock.begin_ns,
        readings - clock.begin_ns * 1e-9,
        rate(readings),
        round(readings[-1] * 1e9),
    )
    assert change_ns == clock.offset_ns
    return change_ns * 1e-9


@pytest.mark.parametrize("late_s", [-0.08, -0.05, -0.012, 0.02, 0.05, 0.08])
def test_an_offset_is_found_with_its_sign(late_s: float) -> None:
    assert find(late_s) == pytest.approx(late_s, abs=0.002)
    assert find(late_s, turn_sigma=5e-4) == pytest.approx(late_s, abs=0.004)


@pytest.mark.parametrize("late_s", [-0.05, 0.02, 0.05])
@pytest.mark.parametrize("jump", [2, 4])
def test_a_jump_in_between_is_found(late_s: float, jump: int) -> None:
    assert find(late_s, jump=jump) == pytest.approx(late_s, abs=0.002)
    assert find(late_s, jump=jump, turn_sigma=5e-4) == pytest.approx(late_s, abs=0.004)


@pytest.mark.parametrize("late_s", [-0.05, 0.05])
def test_in_an_even_turn_only_a_jump_shows(late_s: float) -> None:
    """At a constant rate a constant offset is a constant rotation: nobody can tell."""
    even = find(late_s, pose=turn_pose, rate=turn_rate, turn_sigma=3e-4)
    assert even == 0.0
    found = find(late_s, jump=3, pose=turn_pose, rate=turn_rate, turn_sigma=3e-4)
    assert found == pytest.approx(late_s, abs=0.002)


def test_equal_clocks_and_too_little_evidence_give_nothing() -> None:
    assert find(0.0, turn_sigma=5e-4) == 0.0
    assert find(0.05, scans=2) == 0.0


def test_an_offset_that_would_need_future_samples_is_not_looked_for() -> None:
    """The gyroscope ends 30 ms after the newest scan's stamp: 50 ms cannot show."""
    assert find(0.05, ahead_s=0.03) <= 0.03
    assert find(0.05, ahead_s=0.08) == pytest.approx(0.05, abs=0.002)
    assert find(0.05, ahead_s=-0.3) == 0.0
