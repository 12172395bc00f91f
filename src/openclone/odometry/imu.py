"""The IMU's samples: what is refused, what is kept, and the samples of an interval."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from openclone.errors import InputError

STANDARD_GRAVITY = 9.80665
UNIT_SAMPLES = 10
"""Samples from which the unit of acceleration is judged."""
CLOCK_SAMPLES = 20
"""Refused samples in a row, in order among themselves, that mean a new clock."""
SHORTEST_PERIOD_NS = 1000


@dataclass(frozen=True)
class ImuConfig:
    """Limits of plausible samples.

    Attributes:
        max_rate: rad/s, greatest component.
        max_accel: m/s², greatest component.
        max_gap: seconds; a longer pause counts as a jump of the clock.
        capacity: samples kept.
    """

    max_rate: float = 70.0
    max_accel: float = 400.0
    max_gap: float = 2.0
    capacity: int = 8192


class ClockJump(Exception):
    """The IMU's stamps have moved for good: the odometry must start anew."""


def check_stamp(stamp_ns: Any, where: str) -> int:
    """A whole number of nanoseconds, or `InputError`."""
    if isinstance(stamp_ns, bool) or not isinstance(stamp_ns, (int, np.integer)):
        raise InputError(
            f"the stamp {stamp_ns!r} is no whole number",
            where=where,
            remedy="pass nanoseconds as an int",
        )
    return int(stamp_ns)


def check_vector(value: Any, limit: float, what: str, where: str) -> np.ndarray:
    """Three finite numbers within ``limit``, as float64, or `InputError`."""
    vector = np.asarray(value)
    if vector.shape != (3,) or vector.dtype.kind not in "fiu":
        raise InputError(
            f"{what} has shape {vector.shape} and type {vector.dtype}",
            where=where,
            remedy="pass three numbers",
        )
    vector = vector.astype(np.float64)
    if not np.isfinite(vector).all():
        raise InputError(f"{what} is {vector}", where=where, remedy="leave it out")
    if np.abs(vector).max() > limit:
        raise InputError(
            f"{what} is {vector}, beyond {limit:g}",
            where=where,
            remedy="rates are rad/s, accelerations m/s²",
        )
    return vector


class ImuBuffer:
    """The newest samples in order of time.

    A sample that does not advance the clock is refused with an error and leaves no
    trace. If refused samples keep coming and are in order among themselves, the
    sensor's clock was set: then `ClockJump` is raised once.
    """

    def __init__(self, config: ImuConfig) -> None:
        """Start empty."""
        self._config = config
        self._stamps = np.zeros(2 * config.capacity, np.int64)
        self._samples = np.zeros((2 * config.capacity, 6))
        self.clear()

    def clear(self) -> None:
        """Forget all samples."""
        self._first = self._end = 0
        self._unit_norms: list[float] = []
        self._strange_ns: int | None = None
        self._strange_count = 0
        self.gaps = 0

    def __len__(self) -> int:
        """Samples held."""
        return self._end - self._first

    @property
    def newest_ns(self) -> int:
        """Stamp of the newest sample; there must be one."""
        return int(self._stamps[self._end - 1])

    @property
    def oldest_ns(self) -> int:
        """Stamp of the oldest sample held; there must be one."""
        return int(self._stamps[self._first])

    def append(self, stamp_ns: Any, gyro: Any, accel: Any) -> int:
        """Check and keep a sample; see `FastLio.add_imu`; returns its stamp."""
        where = "add_imu"
        stamp = check_stamp(stamp_ns, where)
        rate = check_vector(gyro, self._config.max_rate, "the gyro sample", where)
        felt = check_vector(
            accel, self._config.max_accel, "the acceleration sample", where
        )
        self._check_unit(felt)
        self._check_order(stamp)
        if self._end == len(self._stamps):
            keep = self._config.capacity
            self._stamps[:keep] = self._stamps[-keep:]
            self._samples[:keep] = self._samples[-keep:]
            self._end = keep
        self._stamps[self._end] = stamp
        self._samples[self._end, :3] = rate
        self._samples[self._end, 3:] = felt
        self._end += 1
        self._first = max(0, self._end - self._config.capacity)
        return stamp

    def _check_unit(self, accel: np.ndarray) -> None:
        """Gravity must show in the first samples: 9.8, not 1."""
        if len(self._unit_norms) >= UNIT_SAMPLES:
            return
        self._unit_norms.append(float(np.linalg.norm(accel)))
        if len(self._unit_norms) < UNIT_SAMPLES:
            return
        size = float(np.median(self._unit_norms))
        if 3.0 < size < 30.0:
            return
        self.clear()
        unit = "g" if 0.3 < size < 3.0 else "no m/s² with gravity in it"
        raise InputError(
            f"accelerations of size {size:.3g} are {unit}",
            where="add_imu",
            remedy=f"pass m/s² (1 g = {STANDARD_GRAVITY} m/s²), gravity included",
        )

    def _check_order(self, stamp: int) -> None:
        if len(self) == 0:
            return
        step = stamp - self.newest_ns
        if SHORTEST_PERIOD_NS <= step <= self._config.max_gap * 1e9:
            self._strange_ns, self._strange_count = None, 0
            self.gaps += int(step > 0.05 * 1e9)
            return
        last, self._strange_ns = self._strange_ns, stamp
        ordered = last is not None and 0 < stamp - last < 0.1 * 1e9
        self._strange_count = self._strange_count + 1 if ordered else 1
        if self._strange_count >= CLOCK_SAMPLES:
            raise ClockJump
        raise InputError(
            f"stamp {stamp} ns comes {step} ns after the sample before it",
            where="add_imu",
            remedy="stamps are nanoseconds and must increase; the sample was left out",
        )

    def stamps_after(self, start_ns: int) -> np.ndarray:
        """Stamps ``(n,)`` of the samples after ``start_ns``."""
        stamps = self._stamps[self._first : self._end]
        return stamps[int(np.searchsorted(stamps, start_ns, "right")) :]

    def longest_pause(self, start_ns: int) -> int:
        """Longest time without a sample since ``start_ns``, nanoseconds."""
        stamps = self.stamps_after(start_ns)
        if len(stamps) == 0:
            return 0
        first = int(stamps[0]) - start_ns
        return max(first, int(np.diff(stamps).max(initial=0)))

    def between(
        self, start_ns: int, end_ns: int
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Samples of an interval, with interpolated ones at both of its ends.

        Before the oldest and after the newest sample the nearest one is held.

        Returns:
            Seconds after ``start_ns`` ``(n,)``, gyro ``(n, 3)``, accel ``(n, 3)``.
        """
        stamps = self._stamps[self._first : self._end]
        samples = self._samples[self._first : self._end]
        low = int(np.searchsorted(stamps, start_ns, "right"))
        high = int(np.searchsorted(stamps, end_ns, "left"))
        times = (stamps[low:high] - start_ns) * 1e-9
        ends = (self._at(stamps, samples, start_ns), self._at(stamps, samples, end_ns))
        times = np.concatenate(((0.0,), times, ((end_ns - start_ns) * 1e-9,)))
        inner = np.concatenate((ends[0][None], samples[low:high], ends[1][None]))
        return (
            times,
            np.ascontiguousarray(inner[:, :3]),
            np.ascontiguousarray(inner[:, 3:]),
        )

    @staticmethod
    def _at(stamps: np.ndarray, samples: np.ndarray, stamp_ns: int) -> np.ndarray:
        after = int(np.searchsorted(stamps, stamp_ns, "left"))
        if after == 0:
            return samples[0]
        if after == len(stamps):
            return samples[-1]
        before = int(stamps[after - 1])
        share = (stamp_ns - before) / (int(stamps[after]) - before)
        return samples[after - 1] + share * (samples[after] - samples[after - 1])
