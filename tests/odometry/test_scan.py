"""Undistortion and thinning against exact geometry, and what is refused."""

import box_room
import numpy as np
import pytest

from openclone.errors import InputError
from openclone.odometry import filter as f
from openclone.odometry import manifold as m
from openclone.odometry.scan import ScanConfig, check_scan, prepare, thin, undistort
from openclone.spatial import rotations

STAMPS = np.arange(4, dtype=np.int64)


def test_a_distorted_scan_is_straightened() -> None:
    """A fast-moving sensor in a cube: all points must lie on the cube again."""
    sensors = box_room.Sensors(
        range_sigma=0.0,
        no_return=0.0,
        gyro_sigma=0.0,
        accel_sigma=0.0,
        gyro_bias=np.zeros(3),
        accel_bias=np.zeros(3),
        points=5000,
        imu_hz=400,
    )
    world = box_room.World(
        box_room.spinning(3.0),
        box_room.empty_room(2.5),
        sensors,
        np.random.default_rng(0),
    )
    begin, end = 4.0, 4.1
    points, stamps = world.scan(begin)
    position, quat = world.pose(np.array((begin, end)))
    state = np.zeros(m.STATE_SIZE)
    state[m.ROT] = rotations.to_matrix(quat[0]).ravel()
    state[m.POS] = position[0]
    state[m.VEL] = world.motion.velocity(np.array(begin))
    state[m.GRAVITY] = box_room.GRAVITY
    state[m.ROT_LIDAR] = np.eye(3).ravel()
    state[m.POS_LIDAR] = box_room.IMU_FROM_LIDAR
    times = np.arange(41) / 400.0
    gyro, accel = world.imu(begin + times)
    _, _, path = f.propagate(
        state, np.eye(23), times, gyro, accel, f.ImuNoise().as_array()
    )
    seconds = stamps * 1e-9 - begin
    limits = np.array((0.1, 50.0, -1.0))
    straight, rejected = undistort(points, seconds, path, state[24:], limits)
    in_world = position[1] + rotations.rotate(
        quat[1], straight + box_room.IMU_FROM_LIDAR
    )
    depth = np.abs(np.abs(in_world).max(axis=1) - 2.5)
    assert rejected == 0
    assert len(straight) == 5000
    assert depth.max() < 2e-3
    raw = position[1] + rotations.rotate(quat[1], points + box_room.IMU_FROM_LIDAR)
    assert np.abs(np.abs(raw).max(axis=1) - 2.5).max() > 0.2


def test_thinning_gives_mean_and_scatter_of_each_voxel() -> None:
    rng = np.random.default_rng(1)
    points = rng.uniform(-1.0, 1.0, (5000, 3)) + 20.0
    means, scatters, counts = thin(points, 0.5)
    keys = np.floor(points / 0.5).astype(int)
    assert counts.sum() == len(points)
    assert len(counts) == len(np.unique(keys, axis=0))
    for mean, scatter, count in zip(means, scatters, counts, strict=True):
        inside = points[(keys == np.floor(mean / 0.5).astype(int)).all(1)]
        assert len(inside) == count
        np.testing.assert_allclose(mean, inside.mean(0), atol=1e-9)
        expected = np.cov(inside.T, bias=True)[np.triu_indices(3)]
        np.testing.assert_allclose(scatter, expected, atol=1e-9)


def test_zeros_nan_and_far_points_are_left_out() -> None:
    path = np.zeros((2, f.KNOT_SIZE))
    path[:, 1:10] = np.eye(3).ravel()
    path[1, 0] = 0.1
    points = np.array(
        [[0, 0, 0], [np.nan, 1, 1], [1, 1, np.inf], [200, 0, 0], [2, 0, 0], [0.1, 0, 0]]
    )
    stamps = np.full(6, 50_000_000, np.int64)
    scan = check_scan(points, stamps, ScanConfig())
    lidar = np.concatenate((np.eye(3).ravel(), np.zeros(3)))
    thinned = prepare(scan, 0, path, lidar, ScanConfig())
    assert thinned.rejected == 2
    assert thinned.returns == 1
    np.testing.assert_allclose(thinned.means, [[2.0, 0.0, 0.0]])


@pytest.mark.parametrize(
    ("points", "stamps", "text"),
    [
        (np.zeros((4, 2)), STAMPS, "shape"),
        (np.zeros(4), STAMPS, "shape"),
        (np.array([["a"] * 3] * 4), STAMPS, "type"),
        (np.zeros((4, 3)), STAMPS[:3], "stamps_ns"),
        (np.zeros((4, 3)), STAMPS * 1.0, "nanoseconds"),
        (np.zeros((0, 3)), STAMPS[:0], "empty"),
        (np.zeros((4, 3)), STAMPS * 10**9, "spans"),
        (np.full((4, 3), 2500.0), STAMPS, "millimetres"),
    ],
)
def test_what_is_no_scan_is_refused(points, stamps, text: str) -> None:
    with pytest.raises(InputError, match=text):
        check_scan(points, stamps, ScanConfig())
