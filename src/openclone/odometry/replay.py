"""Feed a recorded stream to an odometry and collect what it says."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np

from openclone.errors import InputError
from openclone.odometry.protocol import SensorOdometry
from openclone.odometry.samples import ImuSample, LidarScan, SensorSample
from openclone.odometry.trajectory import Trajectory

_MAX_REFUSED_SHARE = 0.5
_MIN_SAMPLES = 1_000


@dataclass
class Replay:
    """What came out of a recording, growing while it is read.

    Attributes:
        scan_cpu_s: processor time of each scan, without the IMU readings before it.
        imu_cpu_s: processor time of all IMU readings.
        scans: frames read.
        tracked: frames after which the odometry called itself healthy.
        refused: samples that the odometry refused.
        first_refusal: why, of the first one.
    """

    scan_cpu_s: list[float] = field(default_factory=list)
    imu_cpu_s: float = 0.0
    scans: int = 0
    tracked: int = 0
    samples: int = 0
    refused: int = 0
    first_refusal: str = ""
    _poses: list[tuple[int, np.ndarray, np.ndarray]] = field(default_factory=list)
    _reference: list[tuple[int, np.ndarray, np.ndarray]] = field(default_factory=list)

    @property
    def trajectory(self) -> Trajectory:
        """The healthy poses, one per scan, of the IMU."""
        return _as_trajectory(self._poses)

    @property
    def reference(self) -> Trajectory:
        """Poses that came with the recording; empty without any."""
        return _as_trajectory(self._reference)

    def refuse(self, error: InputError) -> None:
        """Count a refused sample; a stream that is mostly refused is an error.

        Raises:
            InputError: more than half of a long stream was refused.
        """
        self.refused += 1
        self.first_refusal = self.first_refusal or str(error)
        if self.samples > _MIN_SAMPLES and (
            self.refused > _MAX_REFUSED_SHARE * self.samples
        ):
            raise InputError(
                f"{self.refused} of {self.samples} samples were refused, "
                f"the first because: {self.first_refusal}"
            ) from error


def replay(
    samples: Iterable[SensorSample],
    odometry: SensorOdometry,
    result: Replay,
    progress: Callable[[Replay, int], None] | None = None,
) -> None:
    """Run ``odometry`` over ``samples`` and add what it says to ``result``.

    The caller owns ``result``, so what came before a damaged place is not lost.

    Args:
        samples: scans behind the IMU readings that cover them.
        odometry: fresh.
        result: filled here.
        progress: told after each scan, with the stamp of its end in ns.

    Raises:
        InputError: from the stream, or if most samples were refused.
    """
    for sample in samples:
        result.samples += 1
        if isinstance(sample, LidarScan):
            _feed_scan(sample, odometry, result)
            if progress is not None:
                progress(result, int(sample.stamps_ns.max()))
        elif isinstance(sample, ImuSample):
            begin = time.process_time()
            try:
                odometry.add_imu(sample.stamp_ns, sample.gyro, sample.accel)
            except InputError as error:
                result.refuse(error)
            result.imu_cpu_s += time.process_time() - begin
        else:
            result._reference.append((sample.stamp_ns, sample.position, sample.quat))


def _feed_scan(scan: LidarScan, odometry: SensorOdometry, result: Replay) -> None:
    end_ns = int(scan.stamps_ns.max())
    begin = time.process_time()
    try:
        odometry.add_scan(scan.points, scan.stamps_ns)
    except InputError as error:
        result.refuse(error)
        return
    result.scan_cpu_s.append(time.process_time() - begin)
    result.scans += 1
    if odometry.health(end_ns).tracking:
        result.tracked += 1
        result._poses.append((end_ns, *odometry.pose_at(end_ns)))


def _as_trajectory(poses: list[tuple[int, np.ndarray, np.ndarray]]) -> Trajectory:
    """Poses in rising order of their stamps; the first of equal stamps counts."""
    if not poses:
        return Trajectory(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 4)))
    stamps = np.array([pose[0] for pose in poses], np.int64)
    stamps, order = np.unique(stamps, return_index=True)
    return Trajectory(
        stamps,
        np.array([poses[i][1] for i in order]),
        np.array([poses[i][2] for i in order]),
    )
