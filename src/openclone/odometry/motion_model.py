"""Poses between and shortly after measured ones, by constant velocity."""

from __future__ import annotations

import numpy as np

from openclone.spatial import rotations


class ConstantVelocity:
    """Keeps the two newest poses and continues their motion for a short time."""

    def __init__(self, horizon_ns: int) -> None:
        """Beyond ``horizon_ns`` after the newest pose the motion is held."""
        self._horizon_ns = horizon_ns
        self.reset()

    def reset(self) -> None:
        """Forget all poses."""
        self.stamp_ns: int | None = None
        self._position = np.zeros(3)
        self._quat = np.array(rotations.IDENTITY)
        self._velocity = np.zeros(3)
        self._spin = np.zeros(3)

    def update(self, stamp_ns: int, position: np.ndarray, quat: np.ndarray) -> None:
        """Take a newer pose: (3,) metres, and (4,) wxyz."""
        self._velocity, self._spin = np.zeros(3), np.zeros(3)
        if self.stamp_ns is not None:
            period = (stamp_ns - self.stamp_ns) * 1e-9
            # Over a long gap the mean velocity says nothing about the present one.
            if 0 < period < 0.5:
                turn = rotations.multiply(rotations.conjugate(self._quat), quat)
                self._velocity = (position - self._position) / period
                self._spin = rotations.to_rotation_vector(turn) / period
        self.stamp_ns = stamp_ns
        self._position, self._quat = position.copy(), quat.copy()

    def pose_at(self, stamp_ns: int) -> tuple[np.ndarray, np.ndarray]:
        """Position (3,) and wxyz (4,) at ``stamp_ns``; at rest at the origin at first.

        Before the newest pose the motion is followed back, as far as forwards.
        """
        if self.stamp_ns is None:
            return self._position.copy(), self._quat.copy()
        limit = self._horizon_ns
        ahead = float(np.clip(stamp_ns - self.stamp_ns, -limit, limit)) * 1e-9
        turn = rotations.from_rotation_vector(self._spin * ahead)
        quat = rotations.normalize(rotations.multiply(self._quat, turn))
        return self._position + self._velocity * ahead, quat
