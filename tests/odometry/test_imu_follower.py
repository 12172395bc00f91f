"""Poses between the scans of a slower odometry, against an analytic walk."""

from __future__ import annotations

import numpy as np
import pytest

from openclone.errors import InputError
from openclone.odometry.imu_follower import FollowerConfig, ImuFollower
from openclone.odometry.motion_model import ConstantVelocity
from openclone.spatial import rotations
from room_stream import imu_pose, imu_readings

LATE_S = 0.04
"""Seconds from the end of a scan to its pose."""


def walk(seconds: float, position_sigma: float, turn_sigma: float) -> np.ndarray:
    """Errors (k, 4) of follower and constant velocity: m, rad, m, rad.

    The IMU is perfect but for a bias of the gyro; poses come ten times a second, late
    and noisy. Compared are 50 poses a second, each asked for when its time is now.
    """
    rng = np.random.default_rng(0)
    times = np.arange(1, round(seconds * 200)) / 200
    gyro, accel = imu_readings(times)
    positions, quats = imu_pose(times)
    follower, plain, errors = ImuFollower(), ConstantVelocity(300_000_000), []
    late, scan = round(LATE_S * 200), None
    for k, time_s in enumerate(times):
        stamp = round(time_s * 1e9)
        follower.add_imu(stamp, gyro[k] + np.array((0.01, -0.01, 0.01)), accel[k])
        if k % 20 == 0:
            turn = rotations.from_rotation_vector(turn_sigma * rng.standard_normal(3))
            noisy = positions[k] + position_sigma * rng.standard_normal(3)
            scan = (stamp, noisy, rotations.multiply(quats[k], turn))
        if k % 20 == late and scan is not None:
            follower.correct(*scan)
            plain.update(*scan)
        if k % 4 == 0 and k > late:
            row: list[float] = []
            for each in (follower, plain):
                position, quat = each.pose_at(stamp)
                row.append(float(np.linalg.norm(position - positions[k])))
                row.append(float(rotations.angle_between(quat, quats[k])))
            errors.append(row)
    return np.array(errors)


def test_it_is_better_than_constant_velocity_on_a_walk() -> None:
    errors = walk(12.0, 0.01, 0.02)[200:]
    follower_m, follower_rad, plain_m, plain_rad = errors.mean(axis=0)
    # One pose errs by 1.6 cm and 0.032 rad (three axes): following may not add to it.
    assert follower_m < 0.016
    assert follower_rad < 0.02
    assert follower_m < 0.5 * plain_m
    assert follower_rad < 0.5 * plain_rad


def test_a_jump_of_the_poses_is_taken() -> None:
    follower, up = ImuFollower(), np.array((0.0, 0.0, 9.80665))
    level = np.array(rotations.IDENTITY)
    for k in range(1, 60):
        follower.add_imu(k * 5_000_000, np.zeros(3), up)
    follower.correct(100_000_000, np.zeros(3), level)
    follower.correct(200_000_000, np.array((1.0, 0.0, 0.0)), level)
    np.testing.assert_allclose(follower.pose_at(290_000_000)[0], (1, 0, 0), atol=1e-6)


def test_before_the_first_pose_and_after_a_new_clock() -> None:
    follower, up = ImuFollower(FollowerConfig()), np.array((0.0, 0.0, 9.80665))
    np.testing.assert_array_equal(follower.pose_at(0)[0], np.zeros(3))
    for k in range(1, 30):
        follower.add_imu(k * 5_000_000, np.zeros(3), up)
    with pytest.raises(InputError, match="stamp"):
        follower.add_imu(5_000_000, np.zeros(3), up)
    follower.correct(100_000_000, np.ones(3), np.array(rotations.IDENTITY))
    refused = 0
    for k in range(40):
        try:
            follower.add_imu(10**12 + k * 5_000_000, np.zeros(3), up)
        except InputError:
            refused += 1
    assert refused == 19
    np.testing.assert_array_equal(follower.pose_at(10**12)[0], np.zeros(3))
