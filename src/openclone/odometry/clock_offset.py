"""Finds the offset between the clocks of LiDAR and IMU.

Each scan tells how the sensor was turned at its middle: an error of the IMU's stamps
distorts its two halves in opposite ways. The gyroscope, integrated over the last few
scans, must say the same up to one constant rotation; and it does so for that shift of
its stamps which undoes the offset. A clock may have jumped in between: then only the
scans from some first one on are shifted.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, replace

import numpy as np
from numba import njit

from openclone.odometry.manifold import exp_rotation, log_rotation


@dataclass(frozen=True)
class ClockConfig:
    """When an offset is believed.

    Attributes:
        correct: whether to shift the LiDAR's stamps by the offset found.
        turns: rotations, the newest, that are looked at.
        min_turns: of them that must be there.
        min_late: of them that a jump must explain.
        noise: rad, root mean square disagreement of LiDAR and gyroscope that needs no
            explanation. On the walking robot in a room it is 0.5 mrad.
        share: squared disagreement at the best offset over that without an offset,
            above which it is not believed.
        min_offset: seconds; smaller changes are left alone.
        harmless: seconds; smaller changes leave the state in trust.
        max_offset: seconds; greater ones are not looked for.
        step: seconds between the offsets tried.
        max_gap: seconds; with a longer pause of the IMU nothing can be said.
        max_age: seconds, of the rotations looked at.
    """

    correct: bool = True
    turns: int = 7
    min_turns: int = 3
    min_late: int = 2
    noise: float = 0.0015
    share: float = 0.25
    min_offset: float = 0.001
    harmless: float = 0.005
    max_offset: float = 0.2
    step: float = 0.004
    max_gap: float = 0.03
    max_age: float = 1.5


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
def _integrate(times: np.ndarray, gyro: np.ndarray) -> np.ndarray:
    """Rotations ``(n, 3, 3)`` since ``times[0]`` from rates ``(n, 3)``, rad/s."""
    turns = np.empty((len(times), 3, 3))
    turns[0] = np.eye(3)
    for i in range(len(times) - 1):
        rate = 0.5 * (gyro[i] + gyro[i + 1])
        turns[i + 1] = turns[i] @ exp_rotation(rate * (times[i + 1] - times[i]))
    return turns


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
    firsts: np.ndarray,
    offsets: np.ndarray,
) -> np.ndarray:
    """Mean squared angles between LiDAR's and the IMU's rotations, rad².

    Args:
        times: (n,), seconds, of the gyro's samples; they cover the middles shifted by
            any offset.
        gyro: (n, 3), rad/s, without bias.
        middles: (k,), seconds, of the scans.
        seen: (k, 3, 3), world from IMU at the middles, by LiDAR.
        firsts: (i,), the oldest scan that is late.
        offsets: (j,), seconds by which the IMU's stamps may be late.

    Returns:
        (i, j), after the best common rotation.
    """
    turns, count = _integrate(times, gyro), len(middles)
    out = np.zeros((len(firsts), len(offsets)))
    apart, still = np.zeros((count, 3)), np.empty((count, 3, 3))
    for k in range(count):
        still[k] = seen[k] @ _turned(times, turns, middles[k]).T
    shifted = np.empty((count, 3, 3))
    for j in range(len(offsets)):
        for k in range(count):
            shifted[k] = seen[k] @ _turned(times, turns, middles[k] + offsets[j]).T
        for i in range(len(firsts)):
            first = firsts[i]
            base = np.ascontiguousarray(still[0] if first > 0 else shifted[0])
            for k in range(count):
                frame = still[k] if k < first else shifted[k]
                apart[k] = log_rotation(np.ascontiguousarray(base.T @ frame))
            for axis in range(3):
                out[i, j] += apart[:, axis].var()
    return out


class ClockOffset:
    """Compares LiDAR's newest rotations with the gyroscope.

    The offset in force turns the LiDAR's stamps into the IMU's. While a jump lies
    within the rotations kept, each new one lets it be estimated again.
    """

    def __init__(self, config: ClockConfig) -> None:
        """Start with equal clocks and without evidence."""
        self._config = config
        # Stamps are those of the LiDAR, uncorrected.
        self._turns: deque[LidarTurn] = deque(maxlen=config.turns)
        count = round(config.max_offset / config.step)
        self._offsets = config.step * np.arange(-count, count + 1)
        self.offset_ns = 0
        self._before_ns = 0
        self._since_change = 0

    def __len__(self) -> int:
        """Rotations held."""
        return len(self._turns)

    def take(self, turn: LidarTurn) -> None:
        """Keep a newer rotation, its stamp corrected by the offset in force."""
        self._turns.append(replace(turn, stamp_ns=turn.stamp_ns - self.offset_ns))
        oldest_ns = self._turns[-1].stamp_ns - round(self._config.max_age * 1e9)
        while self._turns[0].stamp_ns < oldest_ns:
            self._turns.popleft()
        self._since_change += 1
        if self._since_change >= self._config.turns:
            self._before_ns = self.offset_ns

    @property
    def begin_ns(self) -> int:
        """From when on `update` needs the gyroscope; there must be rotations."""
        reach_ns = round((self._config.max_offset + 0.01) * 1e9)
        return self._turns[0].stamp_ns + self._before_ns - reach_ns

    def update(
        self, begin_ns: int, times: np.ndarray, gyro: np.ndarray, newest_ns: int
    ) -> int:
        """Correct the offset if the rotations tell; returns the change, nanoseconds.

        Args:
            begin_ns: what ``times`` count from.
            times: (n,), seconds.
            gyro: (n, 3), rad/s, without bias.
            newest_ns: of the newest sample; offsets that need newer ones are left out.
        """
        found = self._find(begin_ns, times, gyro, newest_ns)
        if found is None:
            return 0
        change_ns = self._before_ns + round(found * 1e9) - self.offset_ns
        if abs(change_ns) < self._config.min_offset * 1e9:
            return 0
        self.offset_ns += change_ns
        self._since_change = 0
        return change_ns

    def _find(
        self, begin_ns: int, times: np.ndarray, gyro: np.ndarray, newest_ns: int
    ) -> float | None:
        """Seconds by which the IMU is later than before, if the rotations tell."""
        config, count = self._config, len(self._turns)
        if count < config.min_turns or np.diff(times).max() > config.max_gap:
            return None
        start_ns = begin_ns - self._before_ns
        middles = np.array([turn.stamp_ns - start_ns for turn in self._turns]) * 1e-9
        seen = np.array([turn.rot for turn in self._turns])
        firsts = np.arange(count - config.min_late + 1)
        believed = np.array(((self.offset_ns - self._before_ns) * 1e-9,))
        now = float(disagreement(times, gyro, middles, seen, firsts, believed).min())
        if now < config.noise**2:
            return None
        ahead = (newest_ns - self._before_ns - self._turns[-1].stamp_ns) * 1e-9
        # The IMU's own stamp of a moment is the LiDAR's plus the lateness.
        offsets = self._offsets[self._offsets <= ahead]
        if len(offsets) == 0:
            return None
        costs = disagreement(times, gyro, middles, seen, firsts, offsets)
        first, best = np.unravel_index(int(np.argmin(costs)), costs.shape)
        seconds, cost = lowest(offsets, costs[first], int(best))
        return seconds if cost <= config.share * now else None


def lowest(at: np.ndarray, costs: np.ndarray, best: int) -> tuple[float, float]:
    """Minimum of the parabola through the lowest of ``costs`` and its neighbours."""
    if not 0 < best < len(costs) - 1:
        return float(at[best]), float(costs[best])
    before, here, after = costs[best - 1 : best + 2]
    bend = before - 2.0 * here + after
    if bend <= 0.0:
        return float(at[best]), float(here)
    share = 0.5 * (before - after) / bend
    return (
        float(at[best] + share * (at[best + 1] - at[best])),
        max(float(here - 0.25 * (before - after) * share), 0.0),
    )
