"""rko_lio behind the interface of our own odometry, as a second opinion.

rko_lio (Malladi et al., 2025, MIT licence) runs in C++. It gives one pose per scan, and
on a walking robot these lag and sway by up to two degrees. For a control loop this
adapter therefore follows the IMU between and beyond them (`imu_follower`); without
that, the poses are rko_lio's own, continued at constant velocity.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np

from openclone.errors import InputError
from openclone.odometry.imu_follower import ImuFollower
from openclone.odometry.motion_model import ConstantVelocity
from openclone.odometry.protocol import OdometryHealth
from openclone.spatial import rotations

MID360_LIDAR_IN_IMU = (-0.011, -0.02329, 0.04412)
"""Metres: where the Mid-360's cloud frame is in its IMU's frame (Livox manual)."""


@dataclass(frozen=True)
class RkoLioConfig:
    """Settings of rko_lio; the defaults suit rooms, rko_lio's own suit streets.

    Attributes:
        lidar_in_imu: metres, origin of the LiDAR frame in the IMU frame; the axes of
            the two are parallel.
        voxel_size: metres, of its map.
        min_range: metres; nearer points are ignored.
        max_range: metres; farther points are ignored.
        max_correspondence_distance: metres; points farther apart are no pair.
        double_downsample: thin the scan twice before it is registered.
        max_expected_jerk: m/s³; how fast it lets the acceleration change.
        min_beta: least weight of gravity's direction; -1: without it.
        follow_imu: `RkoLio.pose_at` follows the IMU between and beyond the scans.
        threads: for its registration.
        stale_ns: without a registered scan for so long it is unhealthy.
    """

    lidar_in_imu: tuple[float, float, float] = MID360_LIDAR_IN_IMU
    voxel_size: float = 0.25
    min_range: float = 0.3
    max_range: float = 60.0
    max_correspondence_distance: float = 0.5
    double_downsample: bool = True
    max_expected_jerk: float = 3.0
    min_beta: float = 200.0
    follow_imu: bool = True
    threads: int = 1
    stale_ns: int = 300_000_000


@dataclass(frozen=True, eq=False)
class RkoLioState:
    """What one scan gave.

    Attributes:
        stamp_ns: of the scan's last point.
        position: (3,), metres, world (Z up, origin at the start), of the IMU.
        quat: (4,), wxyz, world from IMU.
        tracking: whether the scan was registered.
    """

    stamp_ns: int
    position: np.ndarray
    quat: np.ndarray
    tracking: bool


class RkoLio:
    """rko_lio as a `protocol.SensorOdometry`."""

    def __init__(self, config: RkoLioConfig | None = None) -> None:
        """Start at the origin.

        Raises:
            InputError: the package rko_lio is not installed.
        """
        try:
            from rko_lio.config import LIOConfig
            from rko_lio.lio import LIO
            from rko_lio.rko_lio_pybind import InputError as RkoInputError
            from rko_lio.rko_lio_pybind import RegistrationError
        except ImportError as error:
            raise InputError(
                f"rko_lio cannot be imported ({error})",
                remedy="`pip install rko_lio` or use --odometry lio",
            ) from error
        self._config = config or RkoLioConfig()
        self._refusals = (RkoInputError, RegistrationError, ValueError)
        self._lio = LIO(
            LIOConfig(
                voxel_size=self._config.voxel_size,
                min_range=self._config.min_range,
                max_range=self._config.max_range,
                max_correspondence_distance=self._config.max_correspondence_distance,
                double_downsample=self._config.double_downsample,
                max_expected_jerk=self._config.max_expected_jerk,
                min_beta=self._config.min_beta,
                max_num_threads=self._config.threads,
                # Without it the world is not level and the bias never estimated.
                initialization_phase=True,
            )
        )
        self._imu_from_lidar = np.eye(4)
        self._imu_from_lidar[:3, 3] = self._config.lidar_in_imu
        self._motion = ConstantVelocity(self._config.stale_ns)
        self._follower = ImuFollower() if self._config.follow_imu else None
        # rko_lio takes all readings since its last scan for those of the next one.
        self._waiting: deque[tuple[int, np.ndarray, np.ndarray]] = deque(maxlen=4096)
        self._imu_ns: int | None = None
        self._scan_ns: int | None = None
        self._registered = False
        self._initialized = False

    def add_imu(self, stamp_ns: int, gyro: np.ndarray, accel: np.ndarray) -> None:
        """One reading: (3,) rad/s and (3,) m/s², IMU frame.

        Raises:
            InputError: wrong shapes, NaN, g for m/s², or a stamp that does not rise.
        """
        gyro, accel = np.asarray(gyro, float), np.asarray(accel, float)
        values = np.concatenate((gyro.ravel(), accel.ravel()))
        if (
            gyro.shape != (3,)
            or accel.shape != (3,)
            or not bool(np.isfinite(values).all())
        ):
            raise InputError("an IMU reading needs 3 + 3 finite numbers")
        if self._imu_ns is not None and stamp_ns <= self._imu_ns:
            raise InputError(
                f"IMU stamp {stamp_ns} ns does not follow {self._imu_ns} ns"
            )
        if self._follower is not None:
            self._follower.add_imu(stamp_ns, gyro, accel)
        self._imu_ns = stamp_ns
        self._waiting.append((stamp_ns, gyro, accel))

    def add_scan(self, points: np.ndarray, stamps_ns: np.ndarray) -> RkoLioState:
        """Register one frame, (N, 3) metres, LiDAR frame, with (N,) stamps.

        Raises:
            InputError: wrong shapes, no points, or an older scan than the last one.
        """
        points, stamps_ns = np.asarray(points), np.asarray(stamps_ns)
        if points.ndim != 2 or points.shape[1] != 3 or not len(points):
            raise InputError(f"scan of shape {points.shape}, not (N, 3)")
        if stamps_ns.shape != (len(points),):
            raise InputError(f"{len(points)} points with {stamps_ns.shape} stamps")
        start_ns, end_ns = int(stamps_ns.min()), int(stamps_ns.max())
        if self._scan_ns is not None and end_ns <= self._scan_ns:
            raise InputError(f"scan stamp {end_ns} ns does not follow {self._scan_ns}")
        self._scan_ns = end_ns
        while self._waiting and self._waiting[0][0] <= end_ns:
            reading_ns, gyro, accel = self._waiting.popleft()
            self._lio.add_imu_measurement(accel, gyro, reading_ns)
        self._registered = self._register(points, stamps_ns, start_ns, end_ns)
        if self._registered and not self._initialized:
            # The first scan only starts its initialization: its pose is the identity.
            self._initialized, self._registered = True, False
        if self._registered:
            pose = self._lio.pose()
            quat = rotations.from_matrix(pose[:3, :3])
            self._motion.update(end_ns, pose[:3, 3], quat)
            if self._follower is not None:
                self._follower.correct(end_ns, pose[:3, 3], quat)
        position, quat = self._motion.pose_at(end_ns)
        return RkoLioState(end_ns, position, quat, self._registered)

    def pose_at(self, stamp_ns: int) -> tuple[np.ndarray, np.ndarray]:
        """Position (3,), metres, world, and wxyz (4,) of the IMU."""
        if self._follower is not None:
            return self._follower.pose_at(stamp_ns)
        return self._motion.pose_at(stamp_ns)

    def health(self, stamp_ns: int) -> OdometryHealth:
        """Tracking while scans are registered."""
        if self._motion.stamp_ns is None:
            return OdometryHealth(tracking=False, age_ns=0)
        age_ns = stamp_ns - self._motion.stamp_ns
        good = self._registered and age_ns <= self._config.stale_ns
        return OdometryHealth(tracking=good, age_ns=age_ns)

    def _register(
        self, points: np.ndarray, stamps_ns: np.ndarray, start_ns: int, end_ns: int
    ) -> bool:
        # It would take (0, 0, 0) for a wall at the sensor, and NaN for a crash.
        sizes = np.linalg.norm(points, axis=1)
        seen = np.isfinite(sizes) & (sizes >= self._config.min_range)
        if np.count_nonzero(seen) < 10:
            return False
        try:
            self._lio.register_scan(
                points[seen],
                stamps_ns[seen],
                self._imu_from_lidar,
                start_ns,
                end_ns,
            )
        except self._refusals:
            return False
        return bool(np.isfinite(self._lio.pose()).all())
