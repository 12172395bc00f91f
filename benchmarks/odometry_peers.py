"""The systems that `odometry.py` compares, each with the settings that are tried.

A peer runs with its authors' settings, which suit streets, and with settings for rooms
and for a walking robot; what each option does is said in the peer's own documentation.
All are behind one interface, and all poses are those of the IMU.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from openclone.odometry.protocol import OdometryHealth, SensorOdometry
from openclone.odometry.rko import RkoLio, RkoLioConfig
from openclone.spatial import rotations
from room_stream import LIDAR_IN_IMU


@dataclass(frozen=True)
class KissSettings:
    """Of kiss-icp; the defaults are its authors'.

    Attributes:
        voxel_size: metres, of its map.
        max_range, min_range: metres; points outside are left out.
        deskew: undo the motion within a frame, from the stamps of its points and the
            motion between the two frames before it.
        initial_threshold: metres, first distance within which points correspond.
    """

    voxel_size: float = 1.0
    max_range: float = 100.0
    min_range: float = 0.0
    deskew: bool = True
    initial_threshold: float = 2.0


class KissIcp:
    """kiss-icp behind the same interface: LiDAR only, its pose moved to the IMU."""

    def __init__(self, settings: KissSettings) -> None:
        """Start at the origin."""
        from kiss_icp.config import KISSConfig
        from kiss_icp.kiss_icp import KissICP

        config = KISSConfig()
        config.mapping.voxel_size = settings.voxel_size
        config.data.max_range = settings.max_range
        config.data.min_range = settings.min_range
        config.data.deskew = settings.deskew
        config.adaptive_threshold.initial_threshold = settings.initial_threshold
        config.registration.max_num_threads = 1
        self._icp = KissICP(config)
        self._position, self._quat = np.zeros(3), np.array(rotations.IDENTITY)
        self._min_range = settings.min_range

    def add_imu(self, stamp_ns: int, gyro: np.ndarray, accel: np.ndarray) -> None:
        """It has no use for the IMU."""

    def add_scan(self, points: np.ndarray, stamps_ns: np.ndarray) -> None:
        """Register one frame; its pose is that at the end of the frame."""
        sizes = np.linalg.norm(points, axis=1)
        # No returns are (0, 0, 0): it would take them for a wall at the sensor.
        seen = np.isfinite(sizes) & (sizes > max(self._min_range, 0.05))
        start_ns, end_ns = stamps_ns.min(), stamps_ns.max()
        shares = (stamps_ns[seen] - start_ns) / max(end_ns - start_ns, 1)
        self._icp.register_frame(points[seen].astype(np.float64), shares)
        turn = self._icp.last_pose[:3, :3]
        self._position = self._icp.last_pose[:3, 3] - turn @ LIDAR_IN_IMU
        self._quat = rotations.from_matrix(turn)

    def pose_at(self, stamp_ns: int) -> tuple[np.ndarray, np.ndarray]:
        """The newest pose."""
        return self._position, self._quat

    def health(self, stamp_ns: int) -> OdometryHealth:
        """It has no notion of it."""
        return OdometryHealth(tracking=True, age_ns=0)


def _fast_lio() -> SensorOdometry:
    from openclone.odometry.fast_lio import FastLio
    from openclone.odometry.warmup import warm_up

    warm_up()
    return FastLio()


_OWN = RkoLioConfig(follow_imu=False)
"""Its own poses, at 0.25 m; what we add between scans is left out."""

_RKO = {
    "street": replace(_OWN, voxel_size=1.0, min_range=1.0, max_range=100.0),
    "0.5 m": replace(_OWN, voxel_size=0.5),
    "0.25 m": _OWN,
    "0.15 m": replace(_OWN, voxel_size=0.15),
    "0.25 m, dense": replace(_OWN, double_downsample=False),
    "0.25 m, jerk 30": replace(_OWN, max_expected_jerk=30.0),
    "0.25 m, no level": replace(_OWN, min_beta=-1.0),
    "0.25 m, our IMU": replace(_OWN, follow_imu=True),
}

_KISS = {
    "street": KissSettings(),
    "0.5 m": KissSettings(0.5, 30.0, 0.3),
    "0.25 m": KissSettings(0.25, 30.0, 0.3),
    "0.5 m, as is": KissSettings(0.5, 30.0, 0.3, deskew=False),
    "0.5 m, 0.5 m pairs": KissSettings(0.5, 30.0, 0.3, initial_threshold=0.5),
}


def _rko(config: RkoLioConfig) -> Callable[[], SensorOdometry]:
    return lambda: RkoLio(config)


def _kiss(settings: KissSettings) -> Callable[[], SensorOdometry]:
    return lambda: KissIcp(settings)


PEERS = ("rko_lio", "kiss-icp")
SYSTEMS: dict[str, Callable[[], SensorOdometry]] = {"openclone": _fast_lio}
SYSTEMS |= {f"rko_lio ({name})": _rko(config) for name, config in _RKO.items()}
SYSTEMS |= {f"kiss-icp ({name})": _kiss(settings) for name, settings in _KISS.items()}
"""Name and settings, and how to make it; ``street`` is what the authors ship."""
