"""Where episodes begin: on the reference, away from it, or standing still."""

from __future__ import annotations

import numpy as np

from openclone.robot.model import standing_qpos
from openclone.spatial import rotations


def to_standing(qpos: np.ndarray, qvel: np.ndarray, chosen: np.ndarray) -> None:
    """Replace the ``chosen`` states by the standing pose at the same place.

    Args:
        qpos: (k, 36), changed.
        qvel: (k, 35), changed.
        chosen: (k,) bool.
    """
    heading = rotations.heading(qpos[chosen, 3:7])
    qpos[chosen, 2:] = standing_qpos()[2:]
    qpos[chosen, 3:7] = heading
    qvel[chosen] = 0.0


def displace(
    qpos: np.ndarray,
    qvel: np.ndarray,
    chosen: np.ndarray,
    rng: np.random.Generator,
    *,
    distance: float,
    heading: float,
    by_area: bool,
) -> None:
    """Move and turn the ``chosen`` states away from the reference (Table A2).

    Args:
        qpos: (k, 36), changed.
        qvel: (k, 35), changed.
        chosen: (k,) bool.
        rng: source of the draws.
        distance: metres, largest displacement.
        heading: radians, largest turn.
        by_area: spread evenly over the disc instead of evenly in distance.
    """
    count = int(chosen.sum())
    angle = rng.uniform(-np.pi, np.pi, count)
    share = rng.random(count)
    reach = distance * (np.sqrt(share) if by_area else share)
    direction = np.stack((np.cos(angle), np.sin(angle)), -1)
    qpos[chosen, :2] += reach[:, None] * direction
    turn = rotations.from_yaw(rng.uniform(-heading, heading, count))
    qpos[chosen, 3:7] = rotations.multiply(turn, qpos[chosen, 3:7])
    qvel[chosen, :3] = rotations.rotate(turn, qvel[chosen, :3])
