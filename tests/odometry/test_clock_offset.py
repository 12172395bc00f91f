"""The offset of two clocks from rotations of an analytic walk."""

from __future__ import annotations

import numpy as np
import pytest

from openclone.odometry.clock_offset import ClockConfig, ClockOffset, LidarTurn
from openclone.spatial import rotations
from room_stream import imu_pose, imu_readings

BEGIN_S = 8.0


def find(late_s: float, scans: int = 5, turn_sigma: float = 0.0) -> float:
    """What is found when the IMU stamps its samples ``late_s`` too late."""
    rng = np.random.default_rng(0)
    clock = ClockOffset(ClockConfig())
    middles = BEGIN_S + 0.1 * np.arange(scans)
    noise = rotations.from_rotation_vector(turn_sigma * rng.standard_normal((scans, 3)))
    seen = rotations.to_matrix(rotations.multiply(imu_pose(middles)[1], noise))
    for middle, rot in zip(middles, seen, strict=True):
        clock.take(LidarTurn(round(middle * 1e9), rot))
    stamps = np.arange(round(200 * (BEGIN_S - 0.2)), round(200 * (BEGIN_S + 0.7))) / 200
    gyro, _ = imu_readings(stamps - late_s)
    times = stamps - clock.begin_ns * 1e-9
    return clock.find(clock.begin_ns, times, gyro, round(stamps[-1] * 1e9))


@pytest.mark.parametrize("late_s", [-0.08, -0.05, -0.012, 0.02, 0.05, 0.08])
def test_an_offset_is_found_with_its_sign(late_s: float) -> None:
    assert find(late_s) == pytest.approx(late_s, abs=0.003)
    assert find(late_s, turn_sigma=5e-4) == pytest.approx(late_s, abs=0.006)


def test_equal_clocks_and_too_little_evidence_give_nothing() -> None:
    assert find(0.0) == 0.0
    assert find(0.05, scans=2) == 0.0


def test_an_offset_that_would_need_future_samples_is_not_looked_for() -> None:
    """The IMU is 40 ms ahead of the middle of the newest scan: 50 ms cannot show."""
    clock = ClockOffset(ClockConfig())
    middles = BEGIN_S + 0.1 * np.arange(5)
    for middle, quat in zip(middles, imu_pose(middles)[1], strict=True):
        clock.take(LidarTurn(round(middle * 1e9), rotations.to_matrix(quat)))
    stamps = (
        np.arange(round(200 * (BEGIN_S - 0.2)), round(200 * (BEGIN_S + 0.44))) / 200
    )
    gyro, _ = imu_readings(stamps - 0.05)
    times = stamps - clock.begin_ns * 1e-9
    found = clock.find(clock.begin_ns, times, gyro, round(stamps[-1] * 1e9))
    assert found <= 0.04
