"""Feed a recorded stream to an odometry and collect what it says."""

from __future__ import annotations

import time
from array import array
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np

from openclone.errors import InputError
from openclone.odometry.protocol import SensorOdometry
from openclone.odometry.samples import ImuSample, LidarScan, SensorSample
from openclone.odometry.trajectory import Trajectory

_MAX_REFUSED_SHARE = 0.5
_MIN_SAMPLES = 1_000


class PoseLog:
    """Poses in the order in which they came, 64 bytes each.

    As tuples of arrays they take six times as much, which shows after some minutes of
    an IMU's 200 poses per second.
    """

    def __init__(self) -> None:
        """Start empty."""
        self._stamps, self._values = array("q"), array("d")

    def append(self, stamp_ns: int, position: np.ndarray, quat: np.ndarray) -> None:
        """Add a pose: (3,) metres and (4,) wxyz."""
        self._stamps.append(stamp_ns)
        self._values.extend(position)
        self._values.extend(quat)

    def as_trajectory(self) -> Trajectory:
        """In rising order of their stamps; the first of equal stamps counts."""
        stamps, order = np.unique(np.array(self._stamps, np.int64), return_index=True)
        values = np.array(self._values).reshape(-1, 7)[order]
        return Trajectory(stamps, values[:, :3], values[:, 3:])


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

    scan_cpu_s: array[float] = field(default_factory=lambda: array("d"))
    imu_cpu_s: float = 0.0
    scans: int = 0
    tracked: int = 0
    samples: int = 0
    refused: int = 0
    first_refusal: str = ""
    _poses: PoseLog = field(default_factory=PoseLog)
    _reference: PoseLog = field(default_factory=PoseLog)

    @property
    def trajectory(self) -> Trajectory:
        """The healthy poses, one per scan, of the IMU."""
        return self._poses.as_trajectory()

    @property
    def reference(self) -> Trajectory:
        """Poses that came with the recording; empty without any."""
        return self._reference.as_trajectory()

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
            result._reference.append(sample.stamp_ns, sample.position, sample.quat)


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
        result._poses.append(end_ns, *odometry.pose_at(end_ns))
