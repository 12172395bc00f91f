"""Stand-in odometry: the true pose plus the error of Eq. 2."""

from __future__ import annotations

import numpy as np

from openclone.odometry.noise import OdometryNoise, OdometryNoiseConfig
from openclone.odometry.protocol import OdometryHealth
from openclone.spatial import rotations


class GroundTruthOdometry:
    """Serves the pose it was last told, displaced by a wandering error.

    Between its own ticks at ``rate_hz`` it repeats the last pose, as an odometry
    without IMU propagation would.
    """

    def __init__(
        self,
        noise: OdometryNoiseConfig | None,
        rng: np.random.Generator,
        *,
        rate_hz: float = 50.0,
    ) -> None:
        """Without ``noise`` the pose is exact."""
        self._noise = OdometryNoise(1, noise, rng) if noise else None
        self._period_ns = round(1e9 / rate_hz)
        self.reset()

    def reset(self) -> None:
        """Forget all poses and return to zero error."""
        self._measured_ns: int | None = None
        self._published_ns: int | None = None
        self._position = np.zeros(3)
        self._quat = np.array(rotations.IDENTITY)
        if self._noise:
            self._noise.reset(np.array([0]))

    def observe(
        self,
        stamp_ns: int,
        position: np.ndarray,
        quat: np.ndarray,
        head_velocity: np.ndarray,
    ) -> None:
        """Take the truth at ``stamp_ns``; call once per control step.

        Args:
            stamp_ns: in the loop's clock.
            position: (3,), metres, world, of the base.
            quat: (4,), wxyz, world from base.
            head_velocity: (3,), m/s, world; its size drives the error.
        """
        error = np.zeros(3)
        if self._noise:
            elapsed_ns = stamp_ns - (self._measured_ns or stamp_ns)
            if elapsed_ns > 0:
                self._noise.step(head_velocity[None], elapsed_ns * 1e-9)
            error = self._noise.error[0]
        self._measured_ns = stamp_ns
        # Half a nanosecond of rounding must not cost a whole period.
        due = self._published_ns is None or (
            stamp_ns - self._published_ns >= self._period_ns - 1_000
        )
        if due:
            self._published_ns = stamp_ns
            self._position, self._quat = position + error, quat.copy()

    def pose_at(self, stamp_ns: int) -> tuple[np.ndarray, np.ndarray]:
        """The newest pose: position ``(3,)``, metres, and wxyz ``(4,)``, world."""
        return self._position.copy(), self._quat.copy()

    def health(self, stamp_ns: int) -> OdometryHealth:
        """Tracking since the first pose."""
        if self._published_ns is None:
            return OdometryHealth(tracking=False, age_ns=0)
        return OdometryHealth(tracking=True, age_ns=stamp_ns - self._published_ns)
