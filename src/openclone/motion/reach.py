"""Targets brought within the robot's reach before the inverse kinematics sees them.

A target that no posture meets makes the solver choose what to give up, and it may
choose differently from frame to frame. Here the choice is made once: the torso and the
soles keep their attitude, the pelvis gives way.
"""

from __future__ import annotations

import numpy as np

from openclone.spatial import rotations

_NATURAL = np.radians(8.0)
"""Pelvis and chest of an upright human may lean by as much."""
_MOST_OFFSET = np.radians(30.0)
_UPRIGHT = np.cos(np.radians(12.0))
_MIN_FRAMES = 10
_WAIST_SOFT, _WAIST_MOST = 0.35, 0.48
"""Radians of waist roll and pitch: from where they bend, and what they never pass;
the joints end at 0.52."""


def upright_offset(quat: np.ndarray, upright: np.ndarray) -> float:
    """Radians of pitch, nose down positive, to take off a body's orientations.

    Skeletons fitted to markers often tip the pelvis or the chest by a constant angle.
    What goes beyond a natural posture while the human stands upright is such an offset.

    Args:
        quat: (T, 4), world from body.
        upright: (T,), frames in which the human stands upright.
    """
    if upright.sum() < _MIN_FRAMES:
        return 0.0
    turn = rotations.conjugate(rotations.heading(quat[upright]))
    axis = rotations.rotate(
        rotations.multiply(turn, quat[upright]), np.array([0.0, 0.0, 1.0])
    )
    pitch = float(np.median(np.arctan2(axis[:, 0], axis[:, 2])))
    excess = np.sign(pitch) * max(abs(pitch) - _NATURAL, 0.0)
    return float(np.clip(excess, -_MOST_OFFSET, _MOST_OFFSET))


def pitched(quat: np.ndarray, angle: float) -> np.ndarray:
    """``quat (T, 4)`` turned nose down by ``angle`` about its own y axis."""
    turn = rotations.from_axis_angle(np.array([0.0, 1.0, 0.0]), angle)
    return rotations.multiply(quat, np.broadcast_to(turn, quat.shape))


def is_upright(hip: np.ndarray, neck: np.ndarray, leg: np.ndarray) -> np.ndarray:
    """(T,), the human stands upright on straight legs.

    Args:
        hip: (T, 3), metres, midpoint of the hips.
        neck: (T, 3), metres.
        leg: (T, 2), distance from hip to ankle as a share of the leg's length.
    """
    spine = neck - hip
    straight = spine[:, 2] > _UPRIGHT * np.linalg.norm(spine, axis=1)
    return straight & (leg > 0.96).all(axis=1)


def _bent(angle: np.ndarray, soft: float, most: float) -> np.ndarray:
    """``angle``, compressed from ``soft`` on so that it never passes ``most``."""
    room = most - soft
    over = np.maximum(np.abs(angle) - soft, 0.0)
    return np.sign(angle) * (
        np.minimum(np.abs(angle), soft) + room * np.tanh(over / room)
    )


def within_waist(pelvis: np.ndarray, torso: np.ndarray) -> np.ndarray:
    """Orientation of the pelvis (T, 4) from which the waist reaches the torso's.

    The waist yaws, rolls, then pitches; roll and pitch end at 0.52 rad.

    Args:
        pelvis: (T, 4), world from body, as wanted.
        torso: (T, 4), likewise.
    """
    turn = rotations.to_matrix(rotations.multiply(rotations.conjugate(pelvis), torso))
    roll = np.arcsin(np.clip(turn[:, 2, 1], -1.0, 1.0))
    pitch = np.arctan2(-turn[:, 2, 0], turn[:, 2, 2])
    yaw = np.arctan2(-turn[:, 0, 1], turn[:, 1, 1])
    roll = _bent(roll, _WAIST_SOFT, _WAIST_MOST)
    pitch = _bent(pitch, _WAIST_SOFT, _WAIST_MOST)
    waist = rotations.from_euler(np.stack((yaw, roll, pitch), axis=1), "ZXY")
    return rotations.make_continuous(
        rotations.multiply(torso, rotations.conjugate(waist))
    )


def ankle_bend(
    leg: np.ndarray, sole_pitch: np.ndarray, thigh: float, shank: float
) -> np.ndarray:
    """Radians (T,) between shank and the sole's normal, knee ahead.

    Args:
        leg: (T, 2), metres, from the ankle to the hip: ahead in the foot's heading, up.
        sole_pitch: (T,), radians, toes up positive.
        thigh: metres.
        shank: metres.
    """
    reach = np.clip(np.hypot(leg[:, 0], leg[:, 1]), 1e-3, thigh + shank - 1e-6)
    cosine = (shank**2 + reach**2 - thigh**2) / (2 * shank * reach)
    knee = np.arccos(np.clip(cosine, -1.0, 1.0))
    return np.arctan2(leg[:, 0], leg[:, 1]) + knee + sole_pitch


def hip_move(
    leg: np.ndarray,
    sole_pitch: np.ndarray,
    thigh: float,
    shank: float,
    most: float,
    farthest: tuple[float, float],
) -> np.ndarray:
    """How far to move the hip so that the ankle need not bend too far.

    Args:
        leg: (T, 2), metres, from the ankle to the hip: ahead in the foot's heading, up.
        sole_pitch: (T,), radians, toes up positive.
        thigh: metres.
        shank: metres.
        most: radians, greatest bend of the ankle.
        farthest: metres, the largest move, ahead and up; the move is a share of it.

    Returns:
        The least share (T,), 0 to 1; 1 where even that is not enough.
    """
    low, high = np.zeros(len(leg)), np.ones(len(leg))

    def fits(share: np.ndarray) -> np.ndarray:
        moved = leg + share[:, None] * np.array(farthest)
        return ankle_bend(moved, sole_pitch, thigh, shank) <= most

    for _ in range(12):
        middle = 0.5 * (low + high)
        enough = fits(middle)
        high = np.where(enough, middle, high)
        low = np.where(enough, low, middle)
    return np.where(fits(np.zeros(len(leg))), 0.0, high)
