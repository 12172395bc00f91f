"""The newest poses at the rate of the IMU."""

from __future__ import annotations

import numpy as np

from openclone.odometry import manifold as m
from openclone.odometry.filter import coast
from openclone.odometry.imu import ImuBuffer
from openclone.odometry.manifold import exp_rotation, log_rotation

WIDTH = 18
"""Numbers of an entry: rotation 9, position 3, velocity 3, rate 3."""


class PoseHistory:
    """Poses in order of time, for interpolation.

    Args of the methods are stamps in nanoseconds.
    """

    def __init__(self, capacity: int, max_ahead: float) -> None:
        """Keep ``capacity`` poses; look at most ``max_ahead`` seconds ahead."""
        self._capacity, self._max_ahead = capacity, max_ahead
        self._stamps = np.zeros(2 * capacity, np.int64)
        self._entries = np.zeros((2 * capacity, WIDTH))
        self.clear()

    def clear(self) -> None:
        """Forget all poses."""
        self._first = self._end = 0

    def __len__(self) -> int:
        """Poses held."""
        return self._end - self._first

    @property
    def newest_ns(self) -> int:
        """Stamp of the newest pose; there must be one."""
        return int(self._stamps[self._end - 1])

    @property
    def oldest_ns(self) -> int:
        """Stamp of the oldest pose; there must be one."""
        return int(self._stamps[self._first])

    def append(self, stamp_ns: int, state: np.ndarray, rate: np.ndarray) -> None:
        """Add the pose of a flat ``state`` that turns at ``rate (3,)``, rad/s."""
        if self._end == len(self._stamps):
            keep = self._capacity
            self._stamps[:keep] = self._stamps[-keep:]
            self._entries[:keep] = self._entries[-keep:]
            self._end = keep
        self._stamps[self._end] = stamp_ns
        self._entries[self._end, :15] = state[:15]
        self._entries[self._end, 15:] = rate
        self._end += 1
        self._first = max(0, self._end - self._capacity)

    def cut(self, stamp_ns: int) -> None:
        """Drop the poses at and after a stamp."""
        stamps = self._stamps[self._first : self._end]
        self._end = self._first + int(np.searchsorted(stamps, stamp_ns, "left"))

    def at(self, stamp_ns: int) -> tuple[np.ndarray, np.ndarray]:
        """Rotation ``(3, 3)`` and position ``(3,)``, between the poses or ahead.

        Ahead of the newest pose its velocities go on, but not for longer than
        ``max_ahead``.
        """
        stamps = self._stamps[self._first : self._end]
        after = int(np.searchsorted(stamps, stamp_ns, "left"))
        entry = self._entries[self._first + max(after - 1, 0)]
        rot, position = entry[:9].reshape(3, 3), entry[9:12]
        if after == 0:
            return rot.copy(), position.copy()
        elapsed = (stamp_ns - int(stamps[after - 1])) * 1e-9
        if after == len(stamps):
            elapsed = min(elapsed, self._max_ahead)
            turn = exp_rotation(entry[15:18] * elapsed)
            return rot @ turn, position + entry[12:15] * elapsed
        following = self._entries[self._first + after]
        period = (int(stamps[after]) - int(stamps[after - 1])) * 1e-9
        share = elapsed / period
        turn = log_rotation(np.ascontiguousarray(rot.T @ following[:9].reshape(3, 3)))
        return (
            rot @ exp_rotation(turn * share),
            position + share * (following[9:12] - position),
        )


class LivePoses(PoseHistory):
    """Poses that the IMU carries on from the newest state of a slower odometry."""

    def __init__(self, imu: ImuBuffer, capacity: int, max_ahead: float) -> None:
        """Read from ``imu``, into which the owner puts the samples."""
        super().__init__(capacity, max_ahead)
        self._imu = imu
        self._state = np.zeros(m.STATE_SIZE)

    def restart(self, stamp_ns: int, state: np.ndarray) -> None:
        """Go on from a flat ``state``, through the samples that are already there."""
        self.cut(stamp_ns)
        self._state, rate = state, np.zeros(3)
        if len(self._imu):
            _, gyro, _ = self._imu.between(stamp_ns, stamp_ns)
            rate = gyro[0] - state[m.GYRO_BIAS]
        self.append(stamp_ns, state, rate)
        for stamp in self._imu.stamps_after(stamp_ns):
            self.follow(int(stamp))

    def follow(self, stamp_ns: int) -> None:
        """Integrate up to a sample."""
        since = self.newest_ns
        if stamp_ns <= since:
            return
        times, gyro, accel = self._imu.between(since, stamp_ns)
        self._state = coast(self._state, times, gyro, accel)
        rate = gyro[-1] - self._state[m.GYRO_BIAS]
        self.append(stamp_ns, self._state, rate)
