"""Where the G1's links should be: a human's motion scaled to the robot's limbs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from openclone.motion.contacts import (
    foot_contacts,
    ground_level,
    level_ground,
    runs,
    smooth,
)
from openclone.motion.reach import (
    hip_move,
    is_upright,
    pitched,
    upright_offset,
    within_waist,
)
from openclone.motion.skeleton import SIDES, HumanMotion, operator_points
from openclone.robot.model import SOLE_CORNERS, SOLE_Z
from openclone.spatial import rotations

FPS = 50.0
THIGH, SHANK, UPPER_ARM, FOREARM = 0.306, 0.318, 0.185, 0.184
"""Metres; limb lengths of the G1, hip to knee to ankle, shoulder to elbow to wrist."""
HIP_HEIGHT = -0.133
HIP_HALF_WIDTH = 0.1165
"""Metres; hip centres in the pelvis frame."""
SHOULDER = np.array([0.004, 0.1468, 0.245])
"""Metres; left shoulder centre in the frame of ``torso_link``."""
TORSO = np.array([-0.004, 0.0, 0.044])
"""Metres; origin of ``torso_link`` in the pelvis frame, waist straight."""
ANKLE_HEIGHT = -SOLE_Z
_PITCH_RANGE = (-0.6, 0.5)
"""Radians; a foot in flight points down or up no further."""


@dataclass(frozen=True)
class RetargetConfig:
    """Weights and limits of the retargeting.

    Attributes:
        crouch: share of the straight leg used at the human's full height; keeps the
            knees off their singular straight pose.
        min_knee: radians, smallest bend of a knee.
        max_ankle: radians, largest bend of an ankle, toes towards the shin.
        lowest_pelvis: metres; the ankles allow no deeper squat on flat feet.
        smooth_s: seconds, width of the Gaussian over the targets.
        max_joint_speed: radians per second.
        clearance: metres that links keep from each other.
        swing_clearance: metres that the sole of a stepping foot rises; the scaled
            human foot, whose toes bend, would drag the robot's stiff sole.
        solves: IK steps per frame, at most.
        first_solves: IK steps for the first frame.
        converged: radians; smaller steps end a frame early.
    """

    crouch: float = 0.97
    min_knee: float = 0.08
    max_ankle: float = 0.8
    lowest_pelvis: float = 0.38
    smooth_s: float = 0.03
    max_joint_speed: float = 15.0
    clearance: float = 0.005
    swing_clearance: float = 0.05
    solves: int = 4
    first_solves: int = 120
    converged: float = 0.002


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


def _foot_angles(motion: HumanMotion, side: str) -> tuple[np.ndarray, np.ndarray]:
    """Yaw and pitch (T,) of the foot, radians, pitch up positive.

    A level foot's yaw is that of the line from ankle to ball. The steeper the line,
    the more counts the twist of the foot's rotation about the vertical, which stays
    defined when the foot points straight down.
    """
    quat = motion.orientation(f"{side}_ankle")
    twist = 2.0 * np.arctan2(quat[:, 3], quat[:, 0])
    bone = motion.joint(f"{side}_toe") - motion.joint(f"{side}_ankle")
    level = np.linalg.norm(bone[:, :2], axis=1) / np.linalg.norm(bone, axis=1)
    weight = np.clip((level - 0.5) / 0.3, 0.0, 1.0)
    line = np.arctan2(bone[:, 1], bone[:, 0])
    yaw = np.unwrap(twist + weight * rotations.wrap_angle(line - twist))
    ahead = bone[:, 0] * np.cos(yaw) + bone[:, 1] * np.sin(yaw)
    return yaw, np.arctan2(bone[:, 2], ahead)


def _lock(values: np.ndarray, contact: np.ndarray) -> np.ndarray:
    """Hold a foot still and flat in each stance, shift the swings between to fit.

    Args:
        values: (T, 5), x, y, height, yaw, pitch of the foot, metres and radians.
        contact: (T,), the foot stands.
    """
    spans = runs(contact)
    if not spans:
        return values
    frames, shifts = [], []
    for start, stop in spans:
        held = np.median(values[start:stop], axis=0)
        held[[2, 4]] = 0.0
        frames += range(start, stop)
        shifts += list(held - values[start:stop])
    at = np.arange(len(values))
    table = np.array(shifts)
    shift = [np.interp(at, frames, table[:, k]) for k in range(values.shape[1])]
    return values + np.stack(shift, 1)


_LONGEST_SWING_S = 1.2
"""Seconds; longer ones are kicks or stances that were not seen: they get no arch."""
_FULL_STRIDE = 0.2
"""Metres; shorter steps lift the foot in proportion to their length."""


def _swing_height(stands: np.ndarray, place: np.ndarray, height: float) -> np.ndarray:
    """Least height of the sole (T,), metres: an arch over each step.

    Args:
        stands: (T,), the foot stands.
        place: (T, 2), metres, where the foot is.
        height: metres, top of the arch of a full stride.
    """
    arch = np.zeros(len(stands))
    for start, stop in runs(~stands):
        if stop - start > _LONGEST_SWING_S * FPS:
            continue
        travel = np.linalg.norm(place[stop - 1] - place[start])
        phase = (np.arange(start, stop) - start + 1) / (stop - start + 1)
        top = height * min(1.0, travel / _FULL_STRIDE)
        arch[start:stop] = top * np.sin(np.pi * phase) ** 2
    return arch


def _foot_targets(
    motion: HumanMotion,
    contact: np.ndarray,
    side: str,
    scale: float,
    config: RetargetConfig,
) -> tuple[np.ndarray, np.ndarray]:
    """Pose of ``*_ankle_roll_link``: stance flat, still and on the ground."""
    stands = contact[:, SIDES.index(side)]
    sigma = config.smooth_s * FPS
    sign = 1.0 if side == "left" else -1.0
    ankle = motion.joint(f"{side}_ankle")
    human_half = 0.5 * motion.bone_length("left_hip", "right_hip")
    heading = rotations.heading(_smooth_quat(motion.orientation("hips"), 0.2 * FPS))
    widen = np.array([0.0, sign * (HIP_HALF_WIDTH - scale * human_half), 0.0])
    position = ankle * scale + rotations.rotate(heading, widen)
    position[:, 2] = scale * (ankle[:, 2] - ground_level(motion, "ankle"))
    yaw, pitch = _foot_angles(motion, side)
    rest = np.median(pitch[stands]) if stands.any() else np.percentile(pitch, 60)
    pitch = np.clip(pitch - rest, *_PITCH_RANGE)
    pose = np.concatenate((position, yaw[:, None], pitch[:, None]), axis=1)
    pose = _lock(smooth(pose, sigma, going_on=True), stands)
    tilt = rotations.from_axis_angle(np.array([0.0, 1, 0]), -pose[:, 4])
    quat = rotations.multiply(rotations.from_yaw(pose[:, 3]), tilt)
    corners = rotations.rotate(quat[:, None], SOLE_CORNERS[None])
    position = pose[:, :3].copy()
    lowest = -corners[..., 2].min(1)
    lowest += _swing_height(stands, position[:, :2], config.swing_clearance)
    position[:, 2] = np.maximum(position[:, 2] + ANKLE_HEIGHT, lowest)
    return position, quat


def make_targets(motion: HumanMotion, config: RetargetConfig) -> Targets:
    """Scale ``motion`` (at `FPS`) to the G1 and lock its standing feet."""
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
    feet = [_foot_targets(motion, contact, side, scale, config) for side in SIDES]
    pelvis += _fit_squat(pelvis, pelvis_quat, feet, config)
    pelvis[:, 2] -= _reach_drop(pelvis, pelvis_quat, [foot[0] for foot in feet], config)
    torso = pelvis + rotations.rotate(pelvis_quat, TORSO)
    position = {"pelvis": pelvis}
    quat = {"pelvis": pelvis_quat, "torso_link": torso_quat}
    hands = _smooth_quat_columns(operator_points(motion)[1][:, 1:], sigma)
    for index, side in enumerate(SIDES):
        ankle = f"{side}_ankle_roll_link"
        position[ankle], quat[ankle] = feet[index]
        mirrored = SHOULDER * np.array([1.0, 1.0 - 2.0 * index, 1.0])
        shoulder = torso + rotations.rotate(torso_quat, mirrored)
        upper = _direction(motion, f"{side}_shoulder", f"{side}_elbow", sigma)
        fore = _direction(motion, f"{side}_elbow", f"{side}_wrist", sigma)
        elbow = shoulder + UPPER_ARM * upper
        position[f"{side}_elbow_link"] = elbow
        position[f"{side}_wrist_yaw_link"] = elbow + FOREARM * fore
        quat[f"{side}_wrist_yaw_link"] = hands[:, index]
    return Targets(position, quat, contact)


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

    def needed(farthest: tuple[float, float]) -> np.ndarray:
        shares = [
            hip_move(leg, pitch, THIGH, SHANK, config.max_ankle, farthest)
            for leg, pitch in zip(legs, pitches, strict=True)
        ]
        return _held_over(np.max(shares, axis=0))

    back = _SQUAT_BACK * needed((-_SQUAT_BACK, 0.0))
    legs = [leg - np.stack((back, 0.0 * back), axis=1) for leg in legs]
    up = _SQUAT_UP * needed((0.0, _SQUAT_UP))
    heading = rotations.heading(quat)
    return rotations.rotate(heading, np.stack((-back, 0.0 * back, up), axis=1))


def _held_over(need: np.ndarray) -> np.ndarray:
    """``need (T,)``, smoothed without ever falling below itself by much."""
    reach = round(0.06 * FPS)
    padded = np.pad(need, reach, mode="edge")
    widened = [np.roll(padded, k) for k in range(-reach, reach + 1)]
    return smooth(np.max(widened, axis=0)[reach:-reach], reach / 2)


def _smooth_quat_columns(quats: np.ndarray, sigma: float) -> np.ndarray:
    return np.stack([_smooth_quat(quats[:, k], sigma) for k in range(2)], 1)
