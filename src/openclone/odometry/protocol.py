"""What teleoperation needs from any odometry."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np


@dataclass(frozen=True)
class OdometryHealth:
    """Whether poses may be trusted now.

    Attributes:
        tracking: False while it starts up or after it lost its way.
        age_ns: age of the newest pose.
    """

    tracking: bool
    age_ns: int


class Odometry(Protocol):
    """Tells where the robot's base is in a world of its own, Z up."""

    def pose_at(self, stamp_ns: int) -> tuple[np.ndarray, np.ndarray]:
        """Position ``(3,)``, metres, and wxyz ``(4,)``, as known at ``stamp_ns``."""
        ...

    def health(self, stamp_ns: int) -> OdometryHealth:
        """The state of the odometry at ``stamp_ns``."""
        ...


class SensorOdometry(Odometry, Protocol):
    """Odometry that estimates the pose itself, from an IMU and a LiDAR.

    Its poses are those of the IMU. FAST-LIO2 and the adapter of rko_lio are such; a
    replayed recording and the simulated sensors feed them in the same way.
    """

    def add_imu(self, stamp_ns: int, gyro: np.ndarray, accel: np.ndarray) -> None:
        """One reading: (3,) rad/s and (3,) m/s², IMU frame."""
        ...

    def add_scan(self, points: np.ndarray, stamps_ns: np.ndarray) -> object:
        """One frame: (N, 3) metres, LiDAR frame, and the (N,) stamps of its points."""
        ...


class PoseOdometry(Odometry, Protocol):
    """Odometry that another program computes and this one only receives.

    A ``nav_msgs/Odometry`` subscriber calls ``add_pose`` for each message.
    """

    def add_pose(
        self, stamp_ns: int, position: np.ndarray, quat: np.ndarray, received_ns: int
    ) -> bool:
        """One pose: (3,) metres and (4,) wxyz; False if it was refused."""
        ...
