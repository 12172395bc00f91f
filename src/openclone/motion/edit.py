"""Motion editing (section 3.4): new clips from old ones."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from openclone.motion.clip import Clip
from openclone.robot import g1


def _mirrored_joint(name: str) -> tuple[int, float]:
    """Index of the joint on the other side, and the sign its angle takes there."""
    if name.startswith("left"):
        other = name.replace("left", "right", 1)
    else:
        other = name.replace("right", "left", 1)
    sign = -1.0 if ("roll" in name or "yaw" in name) else 1.0
    return g1.JOINT_NAMES.index(other), sign


_MIRROR = [_mirrored_joint(name) for name in g1.JOINT_NAMES]
MIRROR_INDEX = np.array([index for index, _ in _MIRROR])
MIRROR_SIGN = np.array([sign for _, sign in _MIRROR])
MIRRORED = "~mirror"
"""Ends the names of mirrored clips."""


def mirror(clip: Clip) -> Clip:
    """Swap left and right: reflect the motion in the world's xz plane."""
    return Clip(
        replace(clip.info, name=clip.info.name + MIRRORED),
        clip.root_position * np.array([1.0, -1.0, 1.0]),
        clip.root_quat * np.array([1.0, -1.0, 1.0, -1.0]),
        clip.joint_angles[:, MIRROR_INDEX] * MIRROR_SIGN,
    )


def pad_start(clip: Clip, seconds: float, max_speed: float = 0.25) -> Clip:
    """Hold the first frame for ``seconds`` before the clip; else like `pad_still`."""
    turned = Clip(
        clip.info, clip.root_position[::-1], clip.root_quat[::-1],
        clip.joint_angles[::-1],
    )  # fmt: skip
    padded = pad_still(turned, seconds, max_speed)
    if padded is turned:
        return clip
    return Clip(
        clip.info,
        padded.root_position[::-1].copy(),
        padded.root_quat[::-1].copy(),
        padded.joint_angles[::-1].copy(),
    )


def pad_still(clip: Clip, seconds: float, max_speed: float = 0.25) -> Clip:
    """Hold the last frame for ``seconds`` if the clip ends (nearly) at rest.

    ``max_speed`` bounds the root's speed (m/s) over the last tenth of a second; a clip
    that ends in motion is returned unchanged, since a held stride is no posture.
    """
    frames = max(2, round(0.1 * clip.info.fps))
    travel = clip.root_position[-1] - clip.root_position[-frames]
    if np.linalg.norm(travel) * clip.info.fps / (frames - 1) > max_speed:
        return clip
    count = round(seconds * clip.info.fps)

    def hold(values: np.ndarray) -> np.ndarray:
        return np.concatenate((values, np.repeat(values[-1:], count, axis=0)))

    return Clip(
        clip.info,
        hold(clip.root_position),
        hold(clip.root_quat),
        hold(clip.joint_angles),
    )
