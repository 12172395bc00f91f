"""Rigid transforms: a position and a unit quaternion."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from openclone.spatial import rotations


@dataclass(frozen=True)
class Pose:
    """The transform ``a_from_b``: frame b's origin and orientation seen from frame a.

    Any leading batch shape works: ``world_from_head @ head_from_point`` cancels the
    names in the middle.

    Attributes:
        position: (..., 3), metres.
        quat: (..., 4), wxyz, unit.
    """

    position: np.ndarray
    quat: np.ndarray

    @staticmethod
    def identity() -> Pose:
        """The transform that changes nothing."""
        return Pose(np.zeros(3), np.array(rotations.IDENTITY))

    def __matmul__(self, other: Pose) -> Pose:
        """Compose: ``a_from_c = a_from_b @ b_from_c``."""
        return Pose(
            self.position + rotations.rotate(self.quat, other.position),
            rotations.multiply(self.quat, other.quat),
        )

    def inverse(self) -> Pose:
        """``b_from_a``."""
        back = rotations.conjugate(self.quat)
        return Pose(-rotations.rotate(back, self.position), back)

    def apply(self, points: np.ndarray) -> np.ndarray:
        """Coordinates in frame a of points ``(..., 3)`` given in frame b."""
        return self.position + rotations.rotate(self.quat, points)

    def heading(self) -> Pose:
        """The same origin turned by yaw alone, so that its z axis points up."""
        return Pose(self.position, rotations.heading(self.quat))

    def matrix(self) -> np.ndarray:
        """Homogeneous matrix, ``(..., 4, 4)``."""
        out = np.zeros((*self.position.shape[:-1], 4, 4))
        out[..., :3, :3] = rotations.to_matrix(self.quat)
        out[..., :3, 3] = self.position
        out[..., 3, 3] = 1.0
        return out
