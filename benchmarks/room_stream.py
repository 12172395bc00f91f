"""A sensor walking through a furnished room, computed without a physics engine.

The room is a set of axis-aligned boxes, so that each ray's length has a closed form.
The path is an analytic function of time, so that the IMU's readings are its
derivatives. Each of the 20 000 rays of a frame leaves from where the sensor is at its
own time. The sensor is a Mid-360, upside down at head height as on the G1.

The benchmark of odometry and the tests of its files use this stream.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from openclone.odometry.samples import ImuSample, LidarScan, PoseSample, SensorSample
from openclone.spatial import rotations

ROOM = np.array([[-4.0, -3.0, 0.0], [4.0, 3.0, 2.8]])
"""Metres: the inside of the walls, floor and ceiling."""

FURNITURE = np.array(
    [
        [[-0.5, -0.4, 0.0], [0.5, 0.4, 0.75]],  # table in the middle
        [[-4.0, 1.0, 0.0], [-3.4, 2.6, 1.9]],  # shelf
        [[3.2, -2.6, 0.0], [4.0, -1.2, 1.1]],  # chest
        [[1.0, 2.4, 0.0], [2.6, 3.0, 2.1]],  # wardrobe
        [[-2.5, -3.0, 0.0], [-1.0, -2.3, 0.8]],  # desk
        [[3.6, 1.5, 0.0], [4.0, 2.1, 2.8]],  # pillar
        [[-0.9, -3.0, 1.2], [0.8, -2.8, 1.9]],  # cupboard on the wall
    ]
)

LIDAR_IN_IMU = np.array([-0.011, -0.02329, 0.04412])
"""Metres, IMU frame: the Mid-360's cloud frame; their axes are parallel."""

GRAVITY_W = np.array([0.0, 0.0, -9.81])
_STEP_S = 5e-4
_GOLDEN = 0.6180339887498949


@dataclass(frozen=True)
class RoomStreamConfig:
    """What is simulated.

    Attributes:
        seconds: length of the stream; the sensor stands still for the first two.
        points: rays per frame.
        scan_hz: frames per second.
        imu_hz: IMU readings per second.
        range_sigma: metres, noise of each range.
        no_return: share of rays that come back as (0, 0, 0).
        gyro_sigma: rad/s, white noise of each reading.
        accel_sigma: m/s², white noise of each reading.
        gyro_bias: rad/s, constant.
        accel_bias: m/s², constant.
        start_ns: stamp of the beginning.
        seed: of all noise.
    """

    seconds: float = 60.0
    points: int = 20_000
    scan_hz: float = 10.0
    imu_hz: float = 200.0
    range_sigma: float = 0.02
    no_return: float = 0.3
    gyro_sigma: float = 0.002
    accel_sigma: float = 0.02
    gyro_bias: tuple[float, float, float] = (0.004, -0.003, 0.005)
    accel_bias: tuple[float, float, float] = (0.05, -0.04, 0.03)
    start_ns: int = 1_700_000_000_000_000_000
    seed: int = 0


def imu_pose(time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where the IMU is: positions (N, 3), metres, world, and wxyz (N, 4).

    It starts to walk around the table after two to three seconds at rest, with the
    bobbing and swaying of steps at 1.8 Hz.
    """
    soft = 0.2
    walked = soft * np.logaddexp(0.0, (time_s - 3.5) / soft)
    moving = 1.0 / (1.0 + np.exp(-(time_s - 3.5) / soft))
    phase = 0.35 * walked
    beat = 2 * np.pi * 0.9 * time_s
    yaw = phase + np.pi / 2 + 0.25 * np.sin(3 * phase)
    sway = 0.03 * np.sin(beat) * moving
    x = 2.2 * np.cos(phase) + sway * np.cos(phase)
    y = 1.4 * np.sin(phase) + sway * np.sin(phase)
    z = 1.3 + 0.015 * np.sin(2 * beat) * moving
    roll = 0.04 * np.sin(beat + 0.5) * moving
    pitch = 0.05 + 0.03 * np.sin(2 * beat + 1.0) * moving
    turn = _about(np.array([0.0, 0.0, 1.0]), yaw)
    turn = rotations.multiply(turn, _about(np.array([0.0, 1.0, 0.0]), pitch))
    # The half turn about x is the inverted mount.
    turn = rotations.multiply(turn, _about(np.array([1.0, 0.0, 0.0]), roll + np.pi))
    return np.stack([x, y, z], axis=-1), np.asarray(turn)


def _about(axis: np.ndarray, angle: np.ndarray) -> np.ndarray:
    half = 0.5 * angle[..., None]
    return np.concatenate([np.cos(half), np.sin(half) * axis], axis=-1)


def imu_readings(time_s: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Perfect gyro (N, 3), rad/s, and accelerometer (N, 3), m/s², IMU frame.

    They are central differences of the path over half a millisecond, exact to 1e-6.
    """
    before, q_before = imu_pose(time_s - _STEP_S)
    now, q_now = imu_pose(time_s)
    after, q_after = imu_pose(time_s + _STEP_S)
    turn = rotations.multiply(rotations.conjugate(q_before), q_after)
    gyro = rotations.to_rotation_vector(turn) / (2 * _STEP_S)
    accel_w = (after - 2 * now + before) / _STEP_S**2 - GRAVITY_W
    return np.asarray(gyro), np.asarray(rotations.rotate_inverse(q_now, accel_w))


def ray_directions(first: int, count: int) -> np.ndarray:
    """Unit directions (count, 3), LiDAR frame, of the rays from number ``first`` on.

    Azimuth and elevation advance by incommensurable steps, so that no frame repeats
    another; the elevation covers the Mid-360's -7 to 52 degrees.
    """
    number = np.arange(first, first + count, dtype=np.float64)
    azimuth = 2 * np.pi * np.modf(number * 0.0137 * _GOLDEN)[0]
    share = np.abs(2 * np.modf(number * 0.00731)[0] - 1)
    elevation = np.radians(-7.0 + 59.0 * share)
    flat = np.cos(elevation)
    return np.stack(
        [flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)], axis=-1
    )


def ray_lengths(origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Metres (N,) to the first surface, for origins and directions (N, 3), world."""
    # One row per axis: NumPy is four times faster over long rows than short ones.
    start, way = np.ascontiguousarray(origins.T), np.ascontiguousarray(directions.T)
    inverse = 1.0 / np.where(np.abs(way) < 1e-12, 1e-12, way)
    corners = ROOM[:, :, None]
    walls = np.maximum((corners[0] - start) * inverse, (corners[1] - start) * inverse)
    lengths = walls.min(axis=0)
    for low, high in FURNITURE[..., None]:
        first, second = (low - start) * inverse, (high - start) * inverse
        enter = np.minimum(first, second).max(axis=0)
        leave = np.maximum(first, second).min(axis=0)
        hit = (enter <= leave) & (enter > 0) & (enter < lengths)
        lengths = np.where(hit, enter, lengths)
    return lengths


def room_stream(config: RoomStreamConfig) -> Iterator[SensorSample]:
    """IMU readings, true poses and frames, each frame behind its last IMU reading."""
    rng = np.random.default_rng(config.seed)
    frames = int(config.seconds * config.scan_hz)
    period_s = 1.0 / config.scan_hz
    per_frame = round(config.imu_hz * period_s)
    for frame in range(frames):
        begin_s = frame * period_s
        times = begin_s + np.arange(1, per_frame + 1) / config.imu_hz
        yield from _imu_samples(times, config, rng)
        yield _scan(begin_s, frame * config.points, config, rng)


def _imu_samples(
    times: np.ndarray, config: RoomStreamConfig, rng: np.random.Generator
) -> Iterator[SensorSample]:
    gyro, accel = imu_readings(times)
    noise = rng.standard_normal((2, len(times), 3))
    gyro = gyro + np.array(config.gyro_bias) + config.gyro_sigma * noise[0]
    accel = accel + np.array(config.accel_bias) + config.accel_sigma * noise[1]
    positions, quats = imu_pose(times)
    for row, time_s in enumerate(times):
        stamp_ns = config.start_ns + round(time_s * 1e9)
        yield ImuSample(stamp_ns, gyro[row], accel[row])
        yield PoseSample(stamp_ns, positions[row], quats[row])


def _scan(
    begin_s: float, first: int, config: RoomStreamConfig, rng: np.random.Generator
) -> LidarScan:
    offsets = np.arange(config.points) / (config.points * config.scan_hz)
    # Between knots 0.5 ms apart straight lines are off by some micrometres.
    knots = np.arange(0.0, 1.0 / config.scan_hz + _STEP_S, _STEP_S)
    at_knots = np.concatenate(imu_pose(begin_s + knots), axis=1)
    values = [np.interp(offsets, knots, column) for column in at_knots.T]
    positions = np.stack(values[:3], axis=1)
    quats = rotations.normalize(np.stack(values[3:], axis=1))
    origins = positions + rotations.rotate(quats, LIDAR_IN_IMU)
    rays = ray_directions(first, config.points)
    lengths = ray_lengths(origins, np.asarray(rotations.rotate(quats, rays)))
    lengths = lengths + config.range_sigma * rng.standard_normal(config.points)
    points = rays * lengths[:, None]
    points[rng.random(config.points) < config.no_return] = 0.0
    stamps_ns = config.start_ns + round(begin_s * 1e9) + (offsets * 1e9).astype(int)
    return LidarScan(points.astype(np.float32), stamps_ns)
