"""Smoothing of tracked poses: One-Euro filters and filtered differentiation.

The One-Euro filter (Casiez, Roussel, Vogel, CHI 2012) is a low-pass filter whose
cut-off rises with speed: still points do not tremble, fast ones do not lag.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from openclone.spatial import rotations


@dataclass(frozen=True)
class OneEuroConfig:
    """Constants of the filter.

    Attributes:
        min_cutoff_hz: cut-off at rest; lower is calmer.
        beta: Hz of cut-off per unit of speed (m/s or rad/s); higher lags less.
        speed_cutoff_hz: cut-off of the speed estimate.
    """

    min_cutoff_hz: float = 1.5
    beta: float = 0.5
    speed_cutoff_hz: float = 1.0


def smoothing_factor(cutoff_hz: np.ndarray | float, period: float) -> np.ndarray:
    """Weight of the newest sample in a first-order low-pass filter, in (0, 1]."""
    turns = 2.0 * math.pi * np.asarray(cutoff_hz) * period
    return turns / (turns + 1.0)


class OneEuroFilter:
    """Filters points ``(..., n)``; each point has its own speed and cut-off.

    The cut-off follows the length of the velocity, so the result does not depend on
    the axes of the frame.
    """

    def __init__(self, config: OneEuroConfig) -> None:
        """Start empty; the first sample passes unchanged."""
        self._config = config
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._value: np.ndarray | None = None
        self._raw = self._velocity = np.zeros(0)

    def update(self, value: np.ndarray, period: float) -> np.ndarray:
        """Filter ``value`` measured ``period`` seconds after the one before it."""
        if self._value is None:
            self._value, self._velocity = value.copy(), np.zeros_like(value)
            self._raw = value.copy()
            return value.copy()
        if period <= 0.0:
            return self._value.copy()
        config = self._config
        weight = smoothing_factor(config.speed_cutoff_hz, period)
        velocity = (value - self._raw) / period
        self._raw = value.copy()
        self._velocity = self._velocity + weight * (velocity - self._velocity)
        speed = np.sqrt((self._velocity**2).sum(-1, keepdims=True))
        cutoff = config.min_cutoff_hz + config.beta * speed
        step = smoothing_factor(cutoff, period) * (value - self._value)
        self._value = self._value + step
        return self._value.copy()


class OneEuroRotationFilter:
    """Filters unit quaternions ``(..., 4)`` along the great circle."""

    def __init__(self, config: OneEuroConfig) -> None:
        """Start empty; the first sample passes unchanged."""
        self._config = config
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._quat: np.ndarray | None = None
        self._raw = self._speed = np.zeros(0)

    def update(self, quat: np.ndarray, period: float) -> np.ndarray:
        """Filter ``quat`` measured ``period`` seconds after the one before it."""
        if self._quat is None:
            self._quat = self._raw = quat
            self._speed = np.zeros(quat.shape[:-1])
            return quat
        if period <= 0.0:
            return self._quat
        config = self._config
        weight = smoothing_factor(config.speed_cutoff_hz, period)
        speed = rotations.angle_between(self._raw, quat) / period
        self._raw = quat
        self._speed = self._speed + weight * (speed - self._speed)
        cutoff = config.min_cutoff_hz + config.beta * self._speed
        fraction = smoothing_factor(cutoff, period)
        smoothed = rotations.slerp(self._quat, quat, fraction)
        self._quat = smoothed
        return smoothed


class Differentiator:
    """Velocity of points by low-pass filtered differences."""

    def __init__(self, cutoff_hz: float) -> None:
        """Start at rest."""
        self._cutoff_hz = cutoff_hz
        self.reset()

    def reset(self) -> None:
        """Forget the past."""
        self._previous: np.ndarray | None = None
        self.velocity = np.zeros(0)

    def update(self, value: np.ndarray, period: float) -> np.ndarray:
        """Velocity ``(..., n)`` per second, after ``value`` came ``period`` later."""
        if self._previous is None:
            self._previous, self.velocity = value.copy(), np.zeros_like(value)
        elif period > 0.0:
            raw = (value - self._previous) / period
            weight = smoothing_factor(self._cutoff_hz, period)
            self.velocity = self.velocity + weight * (raw - self.velocity)
            self._previous = value.copy()
        return self.velocity.copy()
