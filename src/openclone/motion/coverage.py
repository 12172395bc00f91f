"""How much of what the G1's wrists can do a set of motions shows."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from openclone.motion.clip import Clip
from openclone.robot import g1
from openclone.robot.kinematics import Kinematics
from openclone.spatial import rotations

WRIST_JOINTS = tuple(name for name in g1.JOINT_NAMES if "wrist" in name)
_COLUMNS = [g1.JOINT_NAMES.index(name) for name in WRIST_JOINTS]
_CELLS = 6
"""Cells per axis of the grid over wrist roll, pitch and yaw."""
_DIRECTIONS = 64
"""Directions on the sphere that count as different (about 26 degrees apart)."""


@dataclass(frozen=True)
class HandCoverage:
    """Shares between 0 and 1 of what the hands could do.

    Attributes:
        joint_range: per wrist joint, the span from the 1st to the 99th percentile of
            its angles over its range.
        cells: visited share of a 6 x 6 x 6 grid over wrist roll, pitch and yaw; the
            right hand counts as mirrored left.
        fingers, palms: visited share of 64 directions in the heading frame, into
            which the fingers point and the palms face.
    """

    joint_range: dict[str, float]
    cells: float
    fingers: float
    palms: float

    def figures(self) -> dict[str, float]:
        """Flat, for a table or a JSON file."""
        ranges = {f"range {name}": value for name, value in self.joint_range.items()}
        return {
            "wrist cells": self.cells,
            "finger directions": self.fingers,
            "palm directions": self.palms,
            **ranges,
        }


def _sphere(count: int) -> np.ndarray:
    """(count, 3) unit vectors spread evenly (Fibonacci's spiral)."""
    index = np.arange(count) + 0.5
    z = 1.0 - 2.0 * index / count
    angle = np.pi * (1.0 + 5.0**0.5) * index
    radius = np.sqrt(1.0 - z * z)
    return np.stack((radius * np.cos(angle), radius * np.sin(angle), z), 1)


def _cell_numbers(angles: np.ndarray) -> np.ndarray:
    """Grid cells of wrist angles ``(T, 6)``, left and mirrored right together."""
    lower, upper = g1.JOINT_LOWER[_COLUMNS[:3]], g1.JOINT_UPPER[_COLUMNS[:3]]
    mirrored = angles[:, 3:] * np.array([-1.0, 1.0, -1.0])
    both = np.concatenate((angles[:, :3], mirrored))
    cell = np.clip((both - lower) / (upper - lower) * _CELLS, 0, _CELLS - 1e-9)
    cell = cell.astype(int)
    return (cell[:, 0] * _CELLS + cell[:, 1]) * _CELLS + cell[:, 2]


def hand_coverage(clips: Sequence[Clip]) -> HandCoverage:
    """What the hands of all ``clips`` together cover."""
    kinematics, sphere = Kinematics(), _sphere(_DIRECTIONS)
    angles = np.concatenate([clip.joint_angles[:, _COLUMNS] for clip in clips])
    seen: tuple[set[int], set[int]] = (set(), set())
    for clip in clips:
        _, quats = kinematics.trajectory(clip.qpos)
        hands = quats[:, list(g1.WRISTS)]
        heading = rotations.heading(clip.root_quat)[:, None]
        # The fingers point along x; the left palm faces -y, the right one +y.
        for found, axes in zip(
            seen, (((1, 0, 0), (1, 0, 0)), ((0, -1, 0), (0, 1, 0))), strict=True
        ):
            axis = np.broadcast_to(np.array(axes, dtype=float), (*hands.shape[:2], 3))
            direction = rotations.rotate_inverse(
                np.broadcast_to(heading, hands.shape), rotations.rotate(hands, axis)
            )
            nearest = np.argmax(direction.reshape(-1, 3) @ sphere.T, axis=1)
            found.update(np.unique(nearest).tolist())
    span = np.diff(np.quantile(angles, [0.01, 0.99], axis=0), axis=0)[0]
    full = g1.JOINT_UPPER[_COLUMNS] - g1.JOINT_LOWER[_COLUMNS]
    return HandCoverage(
        joint_range=dict(zip(WRIST_JOINTS, (span / full).tolist(), strict=True)),
        cells=len(np.unique(_cell_numbers(angles))) / _CELLS**3,
        fingers=len(seen[0]) / _DIRECTIONS,
        palms=len(seen[1]) / _DIRECTIONS,
    )
