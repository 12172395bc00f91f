"""NEES: whether errors are as large as the covariance says, over seeded runs."""

from __future__ import annotations

from dataclasses import dataclass

import box_room
import numpy as np

from openclone.odometry import manifold as m
from openclone.odometry.estimator import EstimatorConfig
from openclone.odometry.fast_lio import FastLio, FastLioConfig
from openclone.odometry.filter import ImuNoise
from openclone.odometry.state import OdometryState
from openclone.spatial import rotations

BLOCKS = {
    "rotation": (0, 1, 2),
    "position": (3, 4, 5),
    "velocity": (6, 7, 8),
    "gyro bias": (9, 10, 11),
    "accel bias": (12, 13, 14),
    "gravity": (15, 16),
    "all": tuple(range(17)),
}


@dataclass(frozen=True)
class Run:
    """Errors ``(k, 17)`` and covariances ``(k, 17, 17)`` at some moments of a run."""

    errors: np.ndarray
    covariances: np.ndarray


def flat_truth(
    world: box_room.World, state: OdometryState, start_rot: np.ndarray
) -> np.ndarray:
    """The true flat state in the frame that the odometry's first pose defines."""
    times = np.array((0.0, state.stamp_ns * 1e-9))
    position, quat = world.pose(times)
    rot = rotations.to_matrix(quat)
    map_from_world = start_rot @ rot[0].T
    truth = np.zeros(m.STATE_SIZE)
    truth[m.ROT] = (map_from_world @ rot[1]).ravel()
    truth[m.POS] = map_from_world @ (position[1] - position[0])
    truth[m.VEL] = map_from_world @ world.motion.velocity(times)[1]
    truth[m.GYRO_BIAS] = world.sensors.gyro_bias
    truth[m.ACCEL_BIAS] = world.sensors.accel_bias
    truth[m.GRAVITY] = map_from_world @ box_room.GRAVITY
    truth[m.ROT_LIDAR] = np.eye(3).ravel()
    return truth


def flat_state(state: OdometryState) -> np.ndarray:
    flat = np.zeros(m.STATE_SIZE)
    flat[m.ROT] = rotations.to_matrix(state.quat).ravel()
    flat[m.POS], flat[m.VEL] = state.position, state.velocity
    flat[m.GYRO_BIAS], flat[m.ACCEL_BIAS] = state.gyro_bias, state.accel_bias
    flat[m.GRAVITY] = state.gravity
    flat[m.ROT_LIDAR] = np.eye(3).ravel()
    return flat


def run(
    seed: int,
    *,
    seconds: float = 4.0,
    points: int = 6000,
    moments: tuple[float, ...] = (2.5, 3.0, 3.5, 4.0),
    config: FastLioConfig | None = None,
) -> Run:
    """One run with biases, noise and path drawn from ``seed``."""
    rng = np.random.default_rng(seed)
    sensors = box_room.Sensors(
        points=points,
        gyro_bias=0.01 * rng.standard_normal(3),
        accel_bias=0.05 * rng.standard_normal(3),
    )
    motion = box_room.walking(rng.uniform(0.8, 1.6), rng.uniform(-0.8, 0.8))
    world = box_room.World(motion, box_room.furnished(), sensors, rng)
    lio, errors, covariances = FastLio(config), [], []
    due = list(moments)
    for event in box_room.stream(world, seconds):
        if event.points is None:
            lio.add_imu(round(event.time * 1e9), event.gyro, event.accel)
            continue
        state = lio.add_scan(event.points, event.stamps)
        if due and event.time > due[0] - 1e-6:
            due.pop(0)
            first = rotations.to_matrix(lio.pose_at(150_000_000)[1])
            truth = flat_truth(world, state, first)
            errors.append(m.minus(truth, flat_state(state))[:17])
            covariances.append(state.covariance[:17, :17])
    return Run(np.array(errors), np.array(covariances))


def told_noise() -> FastLioConfig:
    """The default, but told the simulated IMU's noise: white, on constant biases."""
    sensors = box_room.Sensors()
    root_hz = np.sqrt(sensors.imu_hz)
    noise = ImuNoise(
        gyro=sensors.gyro_sigma / root_hz,
        accel=sensors.accel_sigma / root_hz,
        gyro_walk=0.0,
        accel_walk=0.0,
        roughness=0.0,
    )
    return FastLioConfig(estimator=EstimatorConfig(imu=noise))


def nees(runs: list[Run]) -> dict[str, float]:
    """Normalized error squared per dimension, averaged; 1 is consistent."""
    out = {}
    for name, columns in BLOCKS.items():
        values = []
        for item in runs:
            for error, covariance in zip(item.errors, item.covariances, strict=True):
                e, c = error[list(columns)], covariance[np.ix_(columns, columns)]
                values.append(e @ np.linalg.solve(c, e) / len(columns))
        out[name] = float(np.mean(values))
    return out
