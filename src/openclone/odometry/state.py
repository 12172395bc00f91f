"""The result of a scan."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from openclone.odometry import manifold as m
from openclone.odometry.estimator import Estimator
from openclone.odometry.health import LioHealth
from openclone.spatial import rotations
from openclone.spatial.poses import Pose


@dataclass(frozen=True)
class OdometryState:
    """The filter at the end of a scan; the world is Z up, yaw 0 at the start.

    Attributes:
        stamp_ns: moment the state is for.
        position: (3,), metres, world, of the IMU.
        quat: (4,), wxyz, world from IMU.
        velocity: (3,), m/s, world.
        gyro_bias: (3,), rad/s.
        accel_bias: (3,), m/s².
        gravity: (3,), m/s², world.
        imu_from_lidar: the extrinsic.
        covariance: (23, 23), error state in the order of `manifold`.
        health: whether to trust it.
    """

    stamp_ns: int
    position: np.ndarray
    quat: np.ndarray
    velocity: np.ndarray
    gyro_bias: np.ndarray
    accel_bias: np.ndarray
    gravity: np.ndarray
    imu_from_lidar: Pose
    covariance: np.ndarray
    health: LioHealth

    @classmethod
    def of(
        cls,
        estimator: Estimator | None,
        lidar: np.ndarray,
        stamp_ns: int,
        health: LioHealth,
    ) -> OdometryState:
        """The estimator's state; before it exists the origin, utterly uncertain.

        Args:
            estimator: None before the start.
            lidar: (12,), IMU from LiDAR, used before the start.
            stamp_ns: used before the start.
            health: the health at the newest scan.
        """
        if estimator is None:
            state = np.zeros(m.STATE_SIZE)
            state[m.ROT], state[m.ROT_LIDAR.start :] = np.eye(3).ravel(), lidar
            covariance = np.diag(np.full(m.ERROR_SIZE, np.inf))
        else:
            state, covariance = estimator.state.copy(), estimator.covariance.copy()
            stamp_ns = estimator.stamp_ns
        rot, rot_lidar = state[m.ROT].reshape(3, 3), state[m.ROT_LIDAR].reshape(3, 3)
        return cls(
            stamp_ns=stamp_ns,
            position=state[m.POS],
            quat=rotations.from_matrix(rot),
            velocity=state[m.VEL],
            gyro_bias=state[m.GYRO_BIAS],
            accel_bias=state[m.ACCEL_BIAS],
            gravity=state[m.GRAVITY],
            imu_from_lidar=Pose(state[m.POS_LIDAR], rotations.from_matrix(rot_lidar)),
            covariance=covariance,
            health=health,
        )
