"""Finds the offset between the clocks of LiDAR and IMU.

Each scan tells how the sensor was turned at its middle: an error of the IMU's stamps
distorts its two halves in opposite ways. The gyroscope, integrated between the middles
of two scans, must say the same; and it does so for that shift of its stamps which
undoes the offset.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

import numpy as np
from numba import njit

from openclone.odometry.manifold import exp_rotation, log_rotation


@dataclass(frozen=True)
class ClockConfig:
    """When an offset is believed.

    Attributes:
        correct: whether to shift the IMU's stamps by the offset found.
        turns: rotations between scans, the newest, that are looked at.
        min_turns: of them that must be there.
        share: squared disagreement at the best offset over that without an offset,
            above which it is not believed.
        min_offset: seconds; smaller offsets are left alone.
        max_offset: seconds; greater ones are not looked for.
        step: seconds between the offsets tried.
    """

    correct: bool = True
    turns: int = 6
    min_turns: int = 2
    share: float = 0.7
    min_offset: float = 0.002
    max_offset: float = 0.1
    step: float = 0.004


@dataclass(frozen=True)
class LidarTurn:
    """How the sensor was turned at the middle of a scan, as LiDAR alone saw it.

    Attributes:
        stamp_ns: of the middle, the LiDAR's clock.
        rot: (3, 3), world from IMU.
    """

    stamp_ns: int
    rot: np.ndarray


@njit(cache=True, nogil=True)
def _turned(times: np.ndarray, turns: np.ndarray, at: float) -> np.ndarray:
    """Rotation ``(3, 3)`` at a time between the samples of ``turns (n, 3, 3)``."""
    k = min(max(int(np.searchsorted(times, at)) - 1, 0), len(times) - 2)
    share = (at - times[k]) / (times[k + 1] - times[k])
    step = log_rotation(np.ascontiguousarray(turns[k].T @ turns[k + 1]))
    return turns[k] @ exp_rotation(share * step)


@njit(cache=True, nogil=True)
def disagreement(
    times: np.ndarray,
    gyro: np.ndarray,
    middles: np.ndarray,
    seen: np.ndarray,
    offsets: np.ndarray,
) -> np.ndarray:
    """Sums of squared angles between LiDAR's and the IMU's turns, rad².

    Args:
        times: (n,), seconds, of the gyro's samples; they cover the middles shifted by
            any offset.
        gyro: (n, 3), rad/s, without bias.
        middles: (k,), seconds, of the scans.
        seen: (k, 3, 3), world from IMU at the middles, by LiDAR.
        offsets: (j,), seconds by which the IMU's stamps may be late.

    Returns:
        (j,), one sum for each offset.
    """
    turns = np.empty((len(times), 3, 3))
    turns[0] = np.eye(3)
    for i in range(len(times) - 1):
        rate = 0.5 * (gyro[i] + gyro[i + 1])
        turns[i + 1] = turns[i] @ exp_rotation(rate * (times[i + 1] - times[i]))
    out = np.zeros(len(offsets))
    for j in range(len(offsets)):
        before = _turned(times, turns, middles[0] + offsets[j])
        for i in range(1, len(middles)):
            now = _turned(times, turns, middles[i] + offsets[j])
            by_imu = np.ascontiguousarray(before.T @ now)
            by_lidar = np.ascontiguousarray(seen[i - 1].T @ seen[i])
            error = log_rotation(np.ascontiguousarray(by_imu.T @ by_lidar))
            out[j] += error @ error
            before = now
    return out


class ClockOffset:
    """Keeps LiDAR's newest rotations and compares them with the gyroscope."""

    def __init__(self, config: ClockConfig) -> None:
        """Start without evidence."""
        self._config = config
        self._turns: deque[LidarTurn] = deque(maxlen=config.turns + 1)
        count = round(config.max_offset / config.step)
        self._offsets = config.step * np.arange(-count, count + 1)

    def clear(self) -> None:
        """Forget the evidence."""
        self._turns.clear()

    def take(self, turn: LidarTurn) -> None:
        """Keep a newer rotation."""
        self._turns.append(turn)

    @property
    def begin_ns(self) -> int:
        """From when on `find` needs the gyroscope; there must be rotations."""
        return self._turns[0].stamp_ns - self._reach_ns

    @property
    def _reach_ns(self) -> int:
        return round((self._config.max_offset + 0.01) * 1e9)

    def find(
        self, begin_ns: int, times: np.ndarray, gyro: np.ndarray, newest_ns: int
    ) -> float:
        """Seconds by which the IMU's stamps are late, or 0 if nothing tells.

        Args:
            begin_ns: what ``times`` count from.
            times: (n,), seconds.
            gyro: (n, 3), rad/s, without bias.
            newest_ns: of the newest sample; offsets that need newer ones are left out.
        """
        config = self._config
        if len(self._turns) < config.min_turns + 1:
            return 0.0
        middles = np.array([turn.stamp_ns - begin_ns for turn in self._turns]) * 1e-9
        seen = np.array([turn.rot for turn in self._turns])
        ahead = (newest_ns - self._turns[-1].stamp_ns) * 1e-9
        offsets = self._offsets[self._offsets <= ahead]
        # The IMU's own stamp of a moment is the LiDAR's plus the lateness.
        costs = disagreement(times, gyro, middles, seen, offsets)
        best = int(np.argmin(costs))
        none = int(np.argmin(np.abs(offsets)))
        if costs[best] > config.share * costs[none]:
            return 0.0
        found = float(offsets[best])
        return found if abs(found) >= config.min_offset else 0.0
