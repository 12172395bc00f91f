"""Where the robot's feet go: planted, flat, apart from each other, lifted in a step."""

from __future__ import annotations

import numpy as np

from openclone.motion.contacts import ground_level, runs, smooth
from openclone.motion.proportions import (
    ANKLE_HEIGHT,
    FPS,
    HIP_HALF_WIDTH,
    RetargetConfig,
)
from openclone.motion.skeleton import SIDES, HumanMotion
from openclone.robot.model import SOLE_CORNERS
from openclone.spatial import rotations

_PITCH_RANGE = (-0.6, 0.5)
"""Radians; a foot in flight points down or up no further."""


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
    """Hold a foot in its place in each stance, shift the swings between to fit.

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
        shifts += list(_planted(held, values[start:stop, 4]) - values[start:stop])
    at = np.arange(len(values))
    table = np.array(shifts)
    shift = [np.interp(at, frames, table[:, k]) for k in range(values.shape[1])]
    return values + np.stack(shift, 1)


_FLAT, _MOST_ROLL = 0.25, 0.35
"""Radians; a foot that points down by less than the first stands flat; the heel of
one that points down further rises by the rest, up to the second."""
_BALL = float(SOLE_CORNERS[:, 0].max())
"""Metres from the ankle to the front edge of the sole."""


def _planted(held: np.ndarray, pitch: np.ndarray) -> np.ndarray:
    """(T, 5): a foot in the place ``held (5,)`` that rolls over its front edge.

    A flat foot would ask too much of the ankle of a leg that pushes off.

    Args:
        held: x, y, height, yaw and pitch of the flat foot, metres and radians.
        pitch: (T,), that of the human foot.
    """
    roll = np.clip(-pitch - _FLAT, 0.0, _MOST_ROLL)
    forward = _BALL * (1.0 - np.cos(roll)) + ANKLE_HEIGHT * np.sin(roll)
    out = np.tile(held, (len(pitch), 1))
    out[:, 0] += forward * np.cos(held[3])
    out[:, 1] += forward * np.sin(held[3])
    out[:, 4] = -roll
    return out


_LONGEST_SWING_S = 1.2
"""Seconds; longer ones are kicks or stances that were not seen: they get no arch."""
_FULL_STRIDE = 0.2
"""Metres; shorter steps lift the foot in proportion to their length."""


def _swing_height(stands: np.ndarray, place: np.ndarray, height: float) -> np.ndarray:
    """Least height of the sole (T,), metres: an arch over each step.

    It is steep at its ends, so that no sole scrapes over the ground while its foot
    gathers speed or still has some.

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
        arch[start:stop] = top * np.sin(np.pi * phase)
    return arch


def foot_targets(
    motion: HumanMotion, contact: np.ndarray, scale: float, config: RetargetConfig
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Poses of both ``*_ankle_roll_link``: in stance still and on the ground.

    Args:
        motion: the human, at `FPS`.
        contact: (T, 2), the left and right foot stand.
        scale: robot over human.
        config: settings.

    Returns:
        For left and right, positions (T, 3), metres, and quaternions (T, 4), wxyz.
    """
    heading = _heading(motion)
    poses = np.stack(
        [_foot_pose(motion, contact, side, scale, config, heading) for side in SIDES]
    )
    poses[..., :2] += apart(poses[..., :2], contact, heading, config.least_width)
    return [_lifted(poses[k], contact[:, k], config.swing_clearance) for k in range(2)]


def _heading(motion: HumanMotion) -> np.ndarray:
    """(T, 4), where the hips face."""
    hips = rotations.make_continuous(motion.orientation("hips"))
    return rotations.heading(
        rotations.normalize(smooth(hips, 0.2 * FPS, going_on=True))
    )


def _foot_pose(
    motion: HumanMotion,
    contact: np.ndarray,
    side: str,
    scale: float,
    config: RetargetConfig,
    heading: np.ndarray,
) -> np.ndarray:
    """(T, 5): x, y and height of the scaled ankle, yaw and pitch; locked in stance."""
    stands = contact[:, SIDES.index(side)]
    sign = 1.0 if side == "left" else -1.0
    ankle = motion.joint(f"{side}_ankle")
    human_half = 0.5 * motion.bone_length("left_hip", "right_hip")
    widen = np.array([0.0, sign * (HIP_HALF_WIDTH - scale * human_half), 0.0])
    position = ankle * scale + rotations.rotate(heading, widen)
    position[:, 2] = scale * (ankle[:, 2] - ground_level(motion, "ankle"))
    yaw, pitch = _foot_angles(motion, side)
    rest = np.median(pitch[stands]) if stands.any() else np.percentile(pitch, 60)
    pitch = np.clip(pitch - rest, *_PITCH_RANGE)
    pose = np.concatenate((position, yaw[:, None], pitch[:, None]), axis=1)
    return _lock(smooth(pose, config.smooth_s * FPS, going_on=True), stands)


def _lifted(
    pose: np.ndarray, stands: np.ndarray, clearance: float
) -> tuple[np.ndarray, np.ndarray]:
    """Position (T, 3) and quaternion (T, 4) of a foot whose sole clears the ground."""
    tilt = rotations.from_axis_angle(np.array([0.0, 1, 0]), -pose[:, 4])
    quat = rotations.multiply(rotations.from_yaw(pose[:, 3]), tilt)
    corners = rotations.rotate(quat[:, None], SOLE_CORNERS[None])
    position = pose[:, :3].copy()
    lowest = -corners[..., 2].min(1)
    lowest += _swing_height(stands, position[:, :2], clearance)
    position[:, 2] = np.maximum(position[:, 2] + ANKLE_HEIGHT, lowest)
    return position, quat


_MOST_APART = 0.08
"""Metres; no foot is moved aside further. What is then left is a crossing step."""
_PASSES = 20
_TAPER_S = 0.08
"""Seconds over which a swinging foot leaves the line between its footprints."""


def apart(
    place: np.ndarray, contact: np.ndarray, heading: np.ndarray, least: float
) -> np.ndarray:
    """Moves (2, T, 2) of both feet that keep them side by side.

    People place their feet on a line and, turning on one foot, across it. The robot's
    legs are thick and its soles narrow: it would stumble over its own foot.

    Args:
        place: (2, T, 2), metres, the left and the right foot, still in each stance.
        contact: (T, 2), they stand.
        heading: (T, 4), where the hips face.
        least: metres between the feet, across the heading.
    """
    across = rotations.rotate(heading, np.array([0.0, 1.0, 0.0]))[:, :2]
    outward = np.array([0.5, -0.5])
    frames = np.arange(place.shape[1])
    moves = np.zeros_like(place)
    steps = _footprints(place, contact, across, least)
    for side, spans in enumerate(steps):
        if spans:
            at = np.concatenate([np.arange(start, stop) for start, stop, _ in spans])
            held = np.concatenate([np.tile(m, (b - a, 1)) for a, b, m in spans])
            for k in range(2):
                moves[side, :, k] = np.interp(frames, at, held[:, k])
    gap = ((place[0] + moves[0] - place[1] - moves[1]) * across).sum(-1)
    lack = smooth(np.maximum(least - gap, 0.0), 0.04 * FPS)
    swings = np.stack([_swing_share(stands) for stands in contact.T])
    both = np.maximum(swings.sum(0), 1.0)
    for side in range(2):
        share = np.minimum(lack, _MOST_APART) * swings[side] / both
        moves[side] += (2.0 * outward[side] * share)[:, None] * across
    return moves


def _swing_share(stands: np.ndarray) -> np.ndarray:
    """(T,) 0 in stance, 1 in mid-swing."""
    share = np.zeros(len(stands))
    for start, stop in runs(~stands):
        at = np.arange(start, stop)
        edge = np.minimum(
            at - start + 1 if start > 0 else np.inf,
            stop - at if stop < len(stands) else np.inf,
        )
        share[start:stop] = np.minimum(edge / (_TAPER_S * FPS), 1.0)
    return share


def _footprints(
    place: np.ndarray, contact: np.ndarray, across: np.ndarray, least: float
) -> list[list[tuple[int, int, np.ndarray]]]:
    """For each foot its stances: start, stop, and the move (2,) that they need.

    A footprint and the next one of the other foot lie ``least`` metres apart, across
    the heading half-way between them.
    """
    stances = sorted(
        (start, stop, side)
        for side in range(2)
        for start, stop in runs(contact[:, side])
    )
    moves = [np.zeros(2) for _ in stances]
    pairs, newest = [], [-1, -1]
    for index, (_, _, side) in enumerate(stances):
        if newest[1 - side] >= 0:
            pairs.append((newest[1 - side], index))
        newest[side] = index
    for _ in range(_PASSES):
        # Of the moves that its neighbours ask of a footprint, it makes the longest.
        wanted = [np.zeros(2) for _ in stances]
        for before, after in pairs:
            pair = (before, after) if stances[before][2] == 0 else (after, before)
            middle = (stances[before][1] + stances[after][0]) // 2
            side_on = across[min(middle, len(across) - 1)]
            left, right = (place[stances[k][2], stances[k][0]] + moves[k] for k in pair)
            half = 0.5 * (least - float((left - right) @ side_on)) * side_on
            for k, move in zip(pair, (half, -half), strict=True):
                if half @ side_on > 0 and move @ move > wanted[k] @ wanted[k]:
                    wanted[k] = move
        moves = [_limited(old + new) for old, new in zip(moves, wanted, strict=True)]
    spans: list[list[tuple[int, int, np.ndarray]]] = [[], []]
    for (start, stop, side), move in zip(stances, moves, strict=True):
        spans[side].append((start, stop, move))
    return spans


def _limited(move: np.ndarray) -> np.ndarray:
    """``move (2,)``, not longer than `_MOST_APART`."""
    return move * min(1.0, _MOST_APART / max(float(np.linalg.norm(move)), 1e-9))
