"""The G1's centre of mass from where its limbs should be, before inverse kinematics.

The knees count: in a deep squat they carry a quarter of the weight forward. Without
them, balance was found for a body whose weight lay 3 cm behind the real one's, and the
robot would have tipped over its toes.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from openclone.motion.proportions import (
    HIP_HALF_WIDTH,
    HIP_HEIGHT,
    SHANK,
    THIGH,
    TORSO,
)
from openclone.spatial import rotations

_MASSES = {
    "pelvis": 3.813,
    "torso": 8.118,
    "upper arm": 2.095,
    "forearm": 1.424,
    "thigh": 4.572,
    "shank": 2.006,
    "foot": 0.608,
}
"""Kilograms, of the G1's model; arms and legs one side."""
_PELVIS, _TORSO = np.array([0.0, 0.0, -0.076]), np.array([0.002, 0.0, 0.177])
_FOOT = np.array([0.0265, 0.0, -0.034])
"""Metres; centres of mass in the frames of ``pelvis``, ``torso_link`` and
``*_ankle_roll_link``."""
_UPPER_ARM, _FOREARM, _LEG = 0.45, 0.73, 0.42
"""Shares of the way from shoulder to elbow, elbow to wrist, hip to knee to ankle."""
_THIGH_AHEAD = 0.021
"""Metres of the thigh's centre of mass in front of the line from hip to knee."""
_SHORTEST = 0.15
"""Metres from hip to ankle; no leg folds further."""

Arm = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Shoulder, elbow and wrist (T, 3) from the torso, metres, world."""
Foot = tuple[np.ndarray, np.ndarray]
"""Place (T, 3) and orientation (T, 4) of ``*_ankle_roll_link``, world."""


def centre_of_limbs(
    pelvis: np.ndarray,
    pelvis_quat: np.ndarray,
    torso_quat: np.ndarray,
    feet: Sequence[Foot],
    arms: Sequence[Arm],
) -> np.ndarray:
    """Centre of mass (T, 3), metres, world.

    Args:
        pelvis: (T, 3), metres, world.
        pelvis_quat: (T, 4), world from pelvis.
        torso_quat: (T, 4), world from torso.
        feet: left and right.
        arms: left and right.
    """
    torso = pelvis + rotations.rotate(pelvis_quat, TORSO)
    parts = [
        ("pelvis", pelvis + rotations.rotate(pelvis_quat, _PELVIS)),
        ("torso", torso + rotations.rotate(torso_quat, _TORSO)),
    ]
    for sign, (ankle, turn), (shoulder, elbow, wrist) in zip(
        (1.0, -1.0), feet, arms, strict=True
    ):
        offset = np.array([0.0, sign * HIP_HALF_WIDTH, HIP_HEIGHT])
        hip = pelvis + rotations.rotate(pelvis_quat, offset)
        ahead = rotations.rotate(turn, np.array([1.0, 0.0, 0.0]))
        knee = knee_between(hip, ankle, ahead)
        thigh = knee - hip
        parts += [
            ("thigh", hip + _LEG * thigh + _THIGH_AHEAD * _across(ahead, thigh)),
            ("shank", knee + _LEG * (ankle - knee)),
            ("foot", ankle + rotations.rotate(turn, _FOOT)),
            ("upper arm", torso + shoulder + _UPPER_ARM * (elbow - shoulder)),
            ("forearm", torso + elbow + _FOREARM * (wrist - elbow)),
        ]
    total = sum(_MASSES[name] for name, _ in parts)
    return np.sum([_MASSES[name] * place for name, place in parts], axis=0) / total


def knee_between(hip: np.ndarray, ankle: np.ndarray, ahead: np.ndarray) -> np.ndarray:
    """Where a knee is that bends forward, ``(T, 3)``; all in metres, world.

    Args:
        hip: (T, 3).
        ankle: (T, 3).
        ahead: (T, 3), direction of the foot.
    """
    leg = ankle - hip
    length = np.linalg.norm(leg, axis=1, keepdims=True)
    reach = np.clip(length, _SHORTEST, THIGH + SHANK)
    along = (THIGH**2 - SHANK**2 + reach**2) / (2.0 * reach)
    bend = np.sqrt(np.maximum(THIGH**2 - along**2, 0.0))
    return hip + along * leg / np.maximum(length, 1e-6) + bend * _across(ahead, leg)


def _across(direction: np.ndarray, line: np.ndarray) -> np.ndarray:
    """Unit vectors (T, 3) across ``line`` that point towards ``direction``."""
    unit = line / np.maximum(np.linalg.norm(line, axis=1, keepdims=True), 1e-6)
    rest = direction - (direction * unit).sum(axis=1, keepdims=True) * unit
    return rest / np.maximum(np.linalg.norm(rest, axis=1, keepdims=True), 1e-6)
