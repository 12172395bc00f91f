"""Finds the offset between the clocks of LiDAR and IMU.

If the IMU's stamps are late by tau, the rotation integrated between two scans belongs
to an interval that lies tau earlier. It misses the true one by

    tau * (rate at the end - rate at the start)

so the offset is the slope of the rotation errors over the changes of rate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class ClockConfig:
    """When an offset is believed.

    Attributes:
        correct: whether to shift the IMU's stamps by the offset found.
        memory: weight of the past at each scan.
        min_excitement: rad/s, root of the summed squares of rate changes.
        min_correlation: of errors and changes, 1 is a perfect line.
        min_offset: seconds; smaller offsets are left alone.
        max_offset: seconds; greater ones are not believed.
    """

    correct: bool = True
    memory: float = 0.8
    min_excitement: float = 0.3
    min_correlation: float = 0.8
    min_offset: float = 0.008
    max_offset: float = 0.15


class ClockOffset:
    """A regression over the newest scans."""

    def __init__(self, config: ClockConfig) -> None:
        """Start without evidence."""
        self._config = config
        self.clear()

    def clear(self) -> None:
        """Forget the evidence."""
        self._changes2 = self._product = self._errors2 = 0.0

    def take(self, turn_error: np.ndarray, rate_change: np.ndarray) -> float:
        """Add a scan; the seconds by which the IMU's stamps are late, or 0.

        Args:
            turn_error: (3,), rad, rotation that LiDAR saw beyond the IMU's.
            rate_change: (3,), rad/s, rate at the end minus rate at the start.
        """
        config = self._config
        self._changes2 = config.memory * self._changes2 + rate_change @ rate_change
        self._product = config.memory * self._product + turn_error @ rate_change
        self._errors2 = config.memory * self._errors2 + turn_error @ turn_error
        if self._changes2 < config.min_excitement**2:
            return 0.0
        offset = float(self._product / self._changes2)
        size = np.sqrt(self._changes2 * self._errors2) + 1e-12
        sure = abs(self._product) > config.min_correlation * size
        if sure and config.min_offset < abs(offset) < config.max_offset:
            return offset
        return 0.0
