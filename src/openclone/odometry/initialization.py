"""Static initialization: what one still second tells about the state."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from openclone.odometry import manifold as m
from openclone.odometry.imu import STANDARD_GRAVITY

SWAY_SHARE = 0.2
"""Error of a mean over the still period as a share of the standard deviation."""


@dataclass(frozen=True)
class StartConfig:
    """When the sensor is still, and what is known before the first sample.

    Attributes:
        seconds: length of the still period.
        max_gyro_mean: rad/s; a greater mean is a turn, not a bias.
        max_gyro_std: rad/s.
        max_accel_std: m/s².
        max_speed: m/s; if the scans of the still period show more, it was none.
        max_tilt: rad, by which the scans of the still period may turn the gravity that
            the IMU felt: a sensor that slows down by 0.17 m/s in one second feels a
            world that is tilted by one degree.
        accel_bias: m/s², standard deviation expected of the bias.
        gyro_bias: rad/s, standard deviation left after averaging.
        velocity: m/s, standard deviation.
        extrinsic_turn: rad, standard deviation, if the extrinsic is estimated.
        extrinsic_shift: metres, the same.
    """

    seconds: float = 1.0
    max_gyro_mean: float = 0.1
    max_gyro_std: float = 0.15
    max_accel_std: float = 1.5
    max_speed: float = 0.15
    max_tilt: float = 0.008
    accel_bias: float = 0.05
    gyro_bias: float = 1e-3
    velocity: float = 0.05
    extrinsic_turn: float = 0.01
    extrinsic_shift: float = 0.01


def unrest(gyro: np.ndarray, accel: np.ndarray, config: StartConfig) -> str:
    """Why samples ``(n, 3)`` are not those of a still sensor; empty if they are."""
    turning = float(np.linalg.norm(gyro.mean(axis=0)))
    if turning > config.max_gyro_mean:
        return f"it turns at {turning:.2f} rad/s"
    shaking = float(gyro.std(axis=0).max())
    if shaking > config.max_gyro_std:
        return f"its rate varies by {shaking:.2f} rad/s"
    pushed = float(accel.std(axis=0).max())
    if pushed > config.max_accel_std:
        return f"its acceleration varies by {pushed:.2f} m/s²"
    return ""


def level_rotation(up: np.ndarray) -> np.ndarray:
    """World from IMU ``(3, 3)``: ``up (3,)`` becomes Z, the IMU's x axis has yaw 0.

    Where the x axis is almost vertical, the y axis takes its place.
    """
    z = up / np.linalg.norm(up)
    ahead = np.array((1.0, 0.0, 0.0)) - z[0] * z
    if np.linalg.norm(ahead) > 0.1:
        x = ahead / np.linalg.norm(ahead)
    else:
        left = np.array((0.0, 1.0, 0.0)) - z[1] * z
        x = np.cross(left / np.linalg.norm(left), z)
    return np.stack((x, np.cross(z, x), z))


def start(
    gyro: np.ndarray,
    accel: np.ndarray,
    lidar: np.ndarray,
    config: StartConfig,
    *,
    up: np.ndarray | None = None,
    up_sigma: float = 0.0,
    estimate_extrinsic: bool = False,
) -> tuple[np.ndarray, np.ndarray]:
    """State and covariance at rest at the world's origin.

    The world is defined by the first pose, so rotation and position start without
    error. The mean acceleration is the sum of the accelerometer's bias and gravity;
    how much is which follows from what is known of both beforehand, and the two stay
    correlated.

    Args:
        gyro: (n, 3), rad/s, of the still period.
        accel: (n, 3), m/s².
        lidar: (12,), IMU from LiDAR: rotation matrix, translation.
        config: prior knowledge.
        up: (3,), the world's up in the IMU frame, if a second IMU tells.
        up_sigma: rad, standard deviation of ``up``.
        estimate_extrinsic: whether the extrinsic is uncertain.
    """
    state, covariance = np.zeros(m.STATE_SIZE), np.zeros((m.ERROR_SIZE, m.ERROR_SIZE))
    mean = accel.mean(axis=0)
    rot = level_rotation(mean if up is None else up)
    state[m.ROT] = rot.ravel()
    state[m.GYRO_BIAS] = gyro.mean(axis=0)
    state[m.GRAVITY] = (0.0, 0.0, -STANDARD_GRAVITY)
    state[m.ROT_LIDAR], state[m.POS_LIDAR] = lidar[:9], lidar[9:]
    deviations = np.zeros(m.ERROR_SIZE)
    deviations[m.E_ROT] = deviations[m.E_POS] = 1e-4
    deviations[m.E_VEL] = config.velocity
    # The mean rate of a swaying sensor is not only bias: sway is slow, so its mean
    # does not shrink with the number of samples.
    deviations[m.E_GYRO_BIAS] = config.gyro_bias + SWAY_SHARE * gyro.std(axis=0)
    deviations[m.E_ACCEL_BIAS] = config.accel_bias
    deviations[m.E_GRAVITY] = 0.2 if up is None else max(up_sigma, 1e-4)
    if estimate_extrinsic:
        deviations[m.E_ROT_LIDAR] = config.extrinsic_turn
        deviations[m.E_POS_LIDAR] = config.extrinsic_shift
    np.fill_diagonal(covariance, deviations**2)
    # mean = bias - R'g: a linear measurement of bias and gravity.
    jacobian = np.zeros((3, m.ERROR_SIZE))
    jacobian[:, m.E_ACCEL_BIAS] = np.eye(3)
    gravity = state[m.GRAVITY]
    jacobian[:, m.E_GRAVITY] = rot.T @ m.skew(gravity) @ m.sphere_basis(gravity)
    noise = (0.005 + SWAY_SHARE * accel.std(axis=0)) ** 2
    innovation = jacobian @ covariance @ jacobian.T + np.diag(noise)
    gain = covariance @ jacobian.T @ np.linalg.inv(innovation)
    state = m.plus(state, gain @ (mean + rot.T @ gravity))
    covariance = covariance - gain @ jacobian @ covariance
    return state, 0.5 * (covariance + covariance.T)
