"""What a LiDAR and its IMU deliver, in the order in which it arrives."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from openclone.errors import InputError

GRAVITY = 9.80665
"""m/s² in one g, by definition."""

AccelUnit = Literal["auto", "g", "m/s2"]

_UNIT_SAMPLES = 100
_PENDING_LIMIT = 400
_MAX_SCAN_NS = 2_000_000_000
_MAX_RANGE_M = 10_000.0
_MAX_VALUE = 1e7
"""Beyond anything measured in rad/s, m/s² or metres; damaged files hold 1e200."""


@dataclass(frozen=True, eq=False)
class ImuSample:
    """One reading of the IMU.

    Attributes:
        stamp_ns: when it was measured, in the sensors' clock.
        gyro: (3,), rad/s, IMU frame.
        accel: (3,), m/s², IMU frame; at rest it points up with 9.81 m/s².
    """

    stamp_ns: int
    gyro: np.ndarray
    accel: np.ndarray


@dataclass(frozen=True, eq=False)
class LidarScan:
    """One frame of the LiDAR; the sensor moves while it is taken.

    Attributes:
        points: (N, 3) float32, metres, LiDAR frame at each point's own time; (0, 0, 0)
            where nothing came back.
        stamps_ns: (N,) int64, when each point was measured, same clock as the IMU.
    """

    points: np.ndarray
    stamps_ns: np.ndarray


@dataclass(frozen=True, eq=False)
class PoseSample:
    """A pose that came with the recording: ground truth or another odometry.

    Attributes:
        stamp_ns: when it held, same clock as the sensors.
        position: (3,), metres, in a world of its own.
        quat: (4,), wxyz, world from body.
    """

    stamp_ns: int
    position: np.ndarray
    quat: np.ndarray


SensorSample: TypeAlias = ImuSample | LidarScan | PoseSample


def stamp_of(sample: SensorSample) -> int:
    """When ``sample`` was complete, ns: for a scan the time of its last point."""
    if isinstance(sample, LidarScan):
        return int(sample.stamps_ns.max()) if len(sample.stamps_ns) else 0
    return sample.stamp_ns


def check_sample(sample: SensorSample, where: str) -> None:
    """Refuse values that no sensor can have measured.

    Raises:
        InputError: a wrong shape, NaN or infinity, an empty or endless scan, a
            quaternion without direction.
    """
    if isinstance(sample, LidarScan):
        _check_scan(sample, where)
        return
    parts = (
        {"angular velocity": (sample.gyro, 3), "acceleration": (sample.accel, 3)}
        if isinstance(sample, ImuSample)
        else {"position": (sample.position, 3), "orientation": (sample.quat, 4)}
    )
    for name, (value, size) in parts.items():
        # The comparison is False for NaN as well.
        if value.shape != (size,) or not (np.abs(value) <= _MAX_VALUE).all():
            raise InputError(
                f"{name} is {value.tolist()}",
                where=where,
                remedy=f"{size} finite numbers of a possible size are needed",
            )
    if isinstance(sample, PoseSample) and not (
        0.9 < float(np.linalg.norm(sample.quat)) < 1.1
    ):
        raise InputError(
            f"orientation {sample.quat.tolist()} is no unit quaternion", where=where
        )


def _check_scan(scan: LidarScan, where: str) -> None:
    points, stamps = scan.points, scan.stamps_ns
    if points.ndim != 2 or points.shape[1] != 3 or stamps.shape != points.shape[:1]:
        raise InputError(
            f"scan of shape {points.shape} with stamps {stamps.shape}",
            where=where,
            remedy="(N, 3) points and (N,) stamps are needed",
        )
    if not len(points):
        raise InputError("scan without points", where=where)
    # The comparison is False for NaN, so this one test covers all three faults.
    good = np.abs(points) <= _MAX_RANGE_M
    if not good.all():
        row = int(np.argmin(good.all(axis=1)))
        raise InputError(
            f"point {row} of the scan is {points[row].tolist()} m",
            where=where,
            remedy="the file is damaged, or the cloud wrongly says is_dense",
        )
    span_ns = int(stamps.max()) - int(stamps.min())
    if span_ns > _MAX_SCAN_NS:
        raise InputError(
            f"one scan lasts {span_ns / 1e9:.1f} s",
            where=where,
            remedy="the unit or the base of its point stamps is wrong",
        )


def scans_after_imu(samples: Iterable[SensorSample]) -> Iterator[SensorSample]:
    """Hold each scan back until the IMU has covered it.

    Drivers publish a scan with its last point, often before the IMU readings of the
    same moment. A scan passes anyway when ten newer ones wait behind it, so a dead IMU
    cannot stop the stream.
    """
    waiting: deque[LidarScan] = deque()
    imu_ns: int | None = None
    for sample in samples:
        if isinstance(sample, LidarScan):
            waiting.append(sample)
        else:
            yield sample
            if isinstance(sample, ImuSample):
                imu_ns = sample.stamp_ns
        while waiting and (
            len(waiting) > 10 or (imu_ns is not None and stamp_of(waiting[0]) <= imu_ns)
        ):
            yield waiting.popleft()
    yield from waiting


def _unit_of(norms: list[float], where: str) -> str:
    """The unit of accelerations whose median size is that of gravity."""
    size = float(np.median(norms))
    if 0.5 < size < 2.0:
        return "g"
    if 5.0 < size < 20.0:
        return "m/s2"
    raise InputError(
        f"the accelerometer's first {len(norms)} readings have a median of {size:.3g}",
        where=where,
        remedy="about 1 (g) or 9.81 (m/s²) is expected; "
        "give the unit with --imu-unit if the recording starts in free motion",
    )


def in_si_units(
    samples: Iterable[SensorSample],
    unit: AccelUnit,
    where: str,
    say: Callable[[str], None],
) -> Iterator[SensorSample]:
    """Convert accelerations to m/s²; Livox drivers publish them in g.

    With ``auto`` the first hundred readings decide: their median size is 1 in one unit
    and 9.81 in the other, in any attitude and for any walking motion.

    Raises:
        InputError: neither unit fits, or a long recording without any IMU reading.
    """
    source = iter(samples)
    pending: list[SensorSample] = []
    if unit == "auto":
        norms: list[float] = []
        for sample in source:
            pending.append(sample)
            if isinstance(sample, ImuSample):
                norms.append(float(np.linalg.norm(sample.accel)))
                if len(norms) == _UNIT_SAMPLES:
                    break
            elif len(pending) > _PENDING_LIMIT and not norms:
                raise InputError(
                    f"no IMU reading among the first {_PENDING_LIMIT} messages",
                    where=where,
                    remedy="name the IMU's topic with --imu-topic",
                )
        unit = "g" if norms and _unit_of(norms, where) == "g" else "m/s2"
        if unit == "g":
            say(f"{where}: acceleration is in g, converted to m/s²")
    scale = GRAVITY if unit == "g" else 1.0
    for sample in pending:
        yield _scaled(sample, scale)
    for sample in source:
        yield _scaled(sample, scale)


def _scaled(sample: SensorSample, scale: float) -> SensorSample:
    if scale == 1.0 or not isinstance(sample, ImuSample):
        return sample
    return ImuSample(sample.stamp_ns, sample.gyro, sample.accel * scale)
