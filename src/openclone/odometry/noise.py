"""The odometry error model of Eq. 2: what LiDAR odometry does to the head's position.

    dp̃ = ṗ dt + (|ṗ| / c_vel + c_min) dW

The error p̃ - p is thus a random walk whose rate grows with speed. As in section 3.3 it
is reset periodically and its size is bounded. Training and the stand-in odometry of
the simulated robot share this class.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class OdometryNoiseConfig:
    """Constants of Eq. 2; the paper does not print them.

    Attributes:
        c_vel: √s; at 1 m/s the error grows by 1/c_vel metres per √second.
        c_min: metres per √second, growth at rest.
        max_error: metres; the error is kept inside a ball of this radius.
        reset_period: seconds between resets to zero error, on average.
    """

    c_vel: float = 50.0
    c_min: float = 0.002
    max_error: float = 0.10
    reset_period: float = 10.0


class OdometryNoise:
    """Position errors of a batch of robots."""

    def __init__(
        self, count: int, config: OdometryNoiseConfig, rng: np.random.Generator
    ) -> None:
        """Start ``count`` robots without error."""
        self.config = config
        self.error = np.zeros((count, 3))
        self._rng = rng

    def reset(self, ids: np.ndarray) -> None:
        """Return the robots ``ids`` to zero error."""
        self.error[ids] = 0.0

    def step(self, velocity: np.ndarray, period: float) -> np.ndarray:
        """Advance the errors by one Euler-Maruyama step.

        Args:
            velocity: (count, 3), m/s, true head velocity.
            period: seconds.

        Returns:
            (count, 3), metres: the error to add to the true position.
        """
        config = self.config
        speed = np.linalg.norm(velocity, axis=1, keepdims=True)
        rate = speed / config.c_vel + config.c_min
        noise = self._rng.standard_normal(self.error.shape)
        self.error += rate * np.sqrt(period) * noise
        size = np.linalg.norm(self.error, axis=1, keepdims=True)
        self.error *= np.minimum(1.0, config.max_error / np.maximum(size, 1e-9))
        restart = self._rng.random(len(self.error)) < period / config.reset_period
        self.error[restart] = 0.0
        return self.error
