"""Several clips as one: a programme that a single run can follow."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from openclone.errors import InputError
from openclone.motion.clip import Clip, ClipInfo, clip_from_qpos
from openclone.robot.model import CONTROL_PERIOD
from openclone.robot.state import key_point_poses
from openclone.spatial import rotations

BLEND_SECONDS = 0.8


@dataclass(frozen=True)
class Part:
    """Where a clip lies in a programme: ``[first, last)``, frames at 50 Hz."""

    name: str
    category: str
    first: int
    last: int


@dataclass(frozen=True)
class Programme:
    """Clips one after the other, at 50 Hz.

    Attributes:
        clip: all of them, joined; each starts where the one before it ended.
        parts: the clips in it. The blend into a clip belongs to that clip.
    """

    clip: Clip
    parts: tuple[Part, ...]


def make_programme(clips: Sequence[Clip], name: str) -> Programme:
    """Join ``clips`` by turning, moving and blending each onto its predecessor.

    The blends are for operators: hands and head go smoothly over, but feet that stand
    differently in two clips slide by the difference.
    """
    if not clips:
        raise InputError("a programme needs one clip or more", where=name)
    joined = np.empty((0, 36))
    parts = []
    for clip in clips:
        qpos = clip.resampled(1.0 / CONTROL_PERIOD).qpos
        first = len(joined)
        if first:
            qpos = place(qpos, qpos[0], joined[-1, :2], rotations.yaw(joined[-1, 3:7]))
            joined = np.concatenate((joined, _blend(joined[-1], qpos[0])))
        joined = np.concatenate((joined, qpos))
        parts.append(Part(clip.info.name, clip.info.category, first, len(joined)))
    fps = 1.0 / CONTROL_PERIOD
    info = ClipInfo(name, "transition", "joined clips", clips[0].info.licence, fps)
    return Programme(clip_from_qpos(info, joined), tuple(parts))


def place(
    qpos: np.ndarray, anchor: np.ndarray, xy: np.ndarray, yaw: np.ndarray | float
) -> np.ndarray:
    """Turn and move ``qpos (T, 36)`` so that ``anchor`` comes to lie at ``xy, yaw``.

    Args:
        qpos: the motion.
        anchor: (7,) or longer: position and quaternion in the motion's old world, of
            which only the horizontal place and the heading count.
        xy: (2,), metres, new world.
        yaw: radians, new world.
    """
    angle = np.asarray(yaw - rotations.yaw(anchor[3:7]))
    turn = np.tile(rotations.from_yaw(angle), (len(qpos), 1))
    offset = qpos[:, :3] - np.append(anchor[:2], 0.0)
    position = rotations.rotate(turn, offset) + np.append(xy, 0.0)
    quat = rotations.multiply(turn, qpos[:, 3:7])
    return np.concatenate((position, quat, qpos[:, 7:]), axis=1)


def place_head(
    qpos: np.ndarray, bodies: tuple[np.ndarray, np.ndarray], head_xy: np.ndarray
) -> np.ndarray:
    """Move ``qpos`` so that its first head lies at ``head_xy`` and looks along +X.

    This is what calibration does with an operator (`teleop.calibration`).

    Args:
        qpos: (T, 36).
        bodies: key-body poses of the first frame, (14, 3) and (14, 4).
        head_xy: (2,), metres.
    """
    points, quats = key_point_poses(*bodies)
    return place(qpos, np.concatenate((points[0], quats[0])), head_xy, 0.0)


def _blend(before: np.ndarray, after: np.ndarray) -> np.ndarray:
    """Frames strictly between two poses ``(36,)``, starting and ending at rest."""
    count = round(BLEND_SECONDS / CONTROL_PERIOD)
    part = np.arange(1, count)[:, None] / count
    part = part * part * (3.0 - 2.0 * part)
    frames = before * (1.0 - part) + after * part
    ends = np.tile(before[3:7], (count - 1, 1)), np.tile(after[3:7], (count - 1, 1))
    frames[:, 3:7] = rotations.slerp(*ends, part[:, 0])
    return frames
