"""Where the G1's links should be: a human's motion scaled to the robot's limbs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from openclone.motion.balance import balancing_shift
from openclone.motion.contacts import (
    foot_contacts,
    ground_level,
    level_ground,
    smooth,
)
from openclone.motion.footing import foot_targets
from openclone.motion.masses import Arm, centre_of_limbs
from openclone.motion.proportions import (
    ANKLE_HEIGHT,
    FOREARM,
    FPS,
    HIP_HALF_WIDTH,
    HIP_HEIGHT,
    SHANK,
    SHOULDER,
    THIGH,
    TORSO,
    UPPER_ARM,
    RetargetConfig,
)
from openclone.motion.reach import (
    hip_move,
    is_upright,
    pitched,
    upright_offset,
    within_waist,
)
from openclone.motion.skeleton import SIDES, HumanMotion, operator_points
from openclone.robot.model import SOLE_CORNERS
from openclone.spatial import rotations


@dataclass(frozen=True)
class Targets:
    """Where the robot's links should be, T frames, world.

    Attributes:
        position: link -> (T, 3), metres.
        quat: link -> (T, 4), wxyz.
        contact: (T, 2), the left and right foot stand.
    """

    position: dict[str, np.ndarray]
    quat: dict[str, np.ndarray]
    contact: np.ndarray


def _smooth_quat(quat: np.ndarray, sigma: float) -> np.ndarray:
    """Gaussian over sign-continuous quaternions, good for small widths."""
    return rotations.normalize(
        smooth(rotations.make_continuous(quat), sigma, going_on=True)
    )


def _direction(motion: HumanMotion, start: str, end: str, sigma: float) -> np.ndarray:
    """(T, 3) unit vector from one joint to another, smoothed."""
    bone = smooth(motion.joint(end) - motion.joint(start), sigma, going_on=True)
    return bone / np.maximum(np.linalg.norm(bone, axis=1, keepdims=True), 1e-9)


def make_targets(motion: HumanMotion, config: RetargetConfig) -> Targets:
    """Scale ``motion`` (at `FPS`) to the G1, plant its feet and balance it."""
    sigma = config.smooth_s * FPS
    motion = level_ground(motion)
    contact = foot_contacts(motion)
    scale = (THIGH + SHANK) / motion.leg_length
    pelvis_quat, torso_quat = _attitudes(motion, contact, sigma)
    hip = smooth(motion.hip_center, sigma, going_on=True) * scale
    level = ground_level(motion, "ankle")
    hip[:, 2] = config.crouch * (hip[:, 2] - scale * level) + ANKLE_HEIGHT
    pelvis = hip - rotations.rotate(pelvis_quat, np.array([0.0, 0.0, HIP_HEIGHT]))
    pelvis[:, 2] = _soft_floor(pelvis[:, 2], config.lowest_pelvis)
    feet = foot_targets(motion, contact, scale, config)
    pelvis += _fit_squat(pelvis, pelvis_quat, feet, config)
    arms = _arms(motion, torso_quat, sigma)
    if config.most_shift > 0:
        com = centre_of_limbs(pelvis, pelvis_quat, torso_quat, feet, arms)
        soles = [_sole_corners(*foot) for foot in feet]
        pelvis[:, :2] += _COM_GAIN * balancing_shift(
            com, np.stack(soles, axis=1), contact, FPS, config.most_shift
        )
    pelvis[:, 2] -= _reach_drop(pelvis, pelvis_quat, [foot[0] for foot in feet], config)
    torso = pelvis + rotations.rotate(pelvis_quat, TORSO)
    position = {"pelvis": pelvis}
    quat = {"pelvis": pelvis_quat, "torso_link": torso_quat}
    hands = _smooth_quat_columns(operator_points(motion)[1][:, 1:], sigma)
    for index, side in enumerate(SIDES):
        ankle = f"{side}_ankle_roll_link"
        position[ankle], quat[ankle] = feet[index]
        position[f"{side}_elbow_link"] = torso + arms[index][1]
        position[f"{side}_wrist_yaw_link"] = torso + arms[index][2]
        quat[f"{side}_wrist_yaw_link"] = hands[:, index]
    return Targets(position, quat, contact)


def _arms(motion: HumanMotion, torso_quat: np.ndarray, sigma: float) -> list[Arm]:
    """Shoulder, elbow and wrist (T, 3) of both arms from the torso, metres, world."""
    arms = []
    for index, side in enumerate(SIDES):
        mirrored = SHOULDER * np.array([1.0, 1.0 - 2.0 * index, 1.0])
        shoulder = rotations.rotate(torso_quat, mirrored)
        upper = _direction(motion, f"{side}_shoulder", f"{side}_elbow", sigma)
        fore = _direction(motion, f"{side}_elbow", f"{side}_wrist", sigma)
        elbow = shoulder + UPPER_ARM * upper
        arms.append((shoulder, elbow, elbow + FOREARM * fore))
    return arms


_COM_GAIN = 1.4
"""Metres of pelvis per metre of centre of mass: the feet stay where they are."""


def _sole_corners(position: np.ndarray, quat: np.ndarray) -> np.ndarray:
    """(T, 4, 2) corners of a sole, metres, world."""
    corners = position[:, None] + rotations.rotate(quat[:, None], SOLE_CORNERS[None])
    return corners[..., :2]


def _attitudes(
    motion: HumanMotion, contact: np.ndarray, sigma: float
) -> tuple[np.ndarray, np.ndarray]:
    """Orientations (T, 4) of pelvis and torso, within what the waist can do."""
    stretch = [
        np.linalg.norm(
            motion.joint(f"{side}_hip") - motion.joint(f"{side}_ankle"), axis=1
        )
        for side in SIDES
    ]
    leg = np.stack(stretch, axis=1) / motion.leg_length
    upright = is_upright(motion.hip_center, motion.joint("neck"), leg)
    upright &= contact.all(axis=1)
    found = []
    for joint in ("hips", "chest"):
        quat = _smooth_quat(motion.orientation(joint), sigma)
        found.append(pitched(quat, -upright_offset(quat, upright)))
    pelvis, torso = found
    return within_waist(pelvis, torso), torso


def _soft_floor(height: np.ndarray, lowest: float, bend: float = 0.1) -> np.ndarray:
    """``height``, bent from ``lowest + bend`` on so that it never passes ``lowest``."""
    depth = np.maximum(lowest + bend - height, 0.0)
    return np.where(depth > 0, lowest + bend * np.exp(-depth / bend), height)


def _reach_drop(
    pelvis: np.ndarray, quat: np.ndarray, feet: list[np.ndarray], config: RetargetConfig
) -> np.ndarray:
    """Metres (T,) to lower the pelvis so that both legs reach their feet."""
    longest = np.sqrt(
        THIGH**2 + SHANK**2 + 2 * THIGH * SHANK * np.cos(config.min_knee + 0.1)
    )
    drops = [np.zeros(len(pelvis))]
    for sign, foot in zip((1.0, -1.0), feet, strict=True):
        offset = np.array([0.0, sign * HIP_HALF_WIDTH, HIP_HEIGHT])
        leg = pelvis + rotations.rotate(quat, offset) - foot
        flat = np.linalg.norm(leg[:, :2], axis=1)
        height = np.sqrt(np.maximum(longest**2 - flat**2, 0.2**2))
        drops.append(leg[:, 2] - height)
    return _held_over(np.max(drops, axis=0))


_SQUAT_BACK, _SQUAT_UP = 0.2, 0.3
"""Metres; a squatting pelvis moves back at most this far, then up."""
_HOLD_S = 0.06
"""Seconds by which a move begins early and ends late."""
_RISE_S = 0.3
"""Seconds over which a move up is spread: at the bottom of a quick squat a shorter one
throws the pelvis up and down again faster than gravity allows."""


def _fit_squat(
    pelvis: np.ndarray,
    quat: np.ndarray,
    feet: list[tuple[np.ndarray, np.ndarray]],
    config: RetargetConfig,
) -> np.ndarray:
    """Move (T, 3) of the pelvis so that no ankle bends beyond its range.

    People squat on their toes with the hips above the feet; the robot's soles stay
    flat, so its hips go back, and up only where that is not enough.
    """
    legs, pitches = [], []
    for sign, (place, turn) in zip((1.0, -1.0), feet, strict=True):
        offset = np.array([0.0, sign * HIP_HALF_WIDTH, HIP_HEIGHT])
        leg = pelvis + rotations.rotate(quat, offset) - place
        ahead = rotations.rotate(turn, np.array([1.0, 0.0, 0.0]))
        level = np.linalg.norm(ahead[:, :2], axis=1)
        forward = (leg[:, :2] * ahead[:, :2]).sum(axis=1) / np.maximum(level, 1e-6)
        legs.append(np.stack((forward, leg[:, 2]), axis=1))
        pitches.append(np.arctan2(ahead[:, 2], level))

    def needed(farthest: tuple[float, float], seconds: float) -> np.ndarray:
        shares = [
            hip_move(leg, pitch, THIGH, SHANK, config.max_ankle, farthest)
            for leg, pitch in zip(legs, pitches, strict=True)
        ]
        return _held_over(np.max(shares, axis=0), seconds)

    back = _SQUAT_BACK * needed((-_SQUAT_BACK, 0.0), _HOLD_S)
    legs = [leg - np.stack((back, 0.0 * back), axis=1) for leg in legs]
    up = _SQUAT_UP * needed((0.0, _SQUAT_UP), _RISE_S)
    heading = rotations.heading(quat)
    return rotations.rotate(heading, np.stack((-back, 0.0 * back, up), axis=1))


def _held_over(need: np.ndarray, seconds: float = _HOLD_S) -> np.ndarray:
    """``need (T,)``, smoothed without ever falling below itself by much."""
    reach = round(seconds * FPS)
    padded = np.pad(need, reach, mode="edge")
    widened = [np.roll(padded, k) for k in range(-reach, reach + 1)]
    return smooth(np.max(widened, axis=0)[reach:-reach], reach / 2)


def _smooth_quat_columns(quats: np.ndarray, sigma: float) -> np.ndarray:
    return np.stack([_smooth_quat(quats[:, k], sigma) for k in range(2)], 1)
