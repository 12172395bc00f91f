"""A few lines of text about a clip: what it is, where it goes, what looks wrong."""

from __future__ import annotations

import numpy as np

from openclone.motion.clip import Clip
from openclone.robot import g1
from openclone.robot.kinematics import Kinematics
from openclone.robot.model import SOLE_CORNERS
from openclone.robot.state import key_point_poses
from openclone.spatial import rotations

_NOTABLE_DEPTH = 0.005
"""Metres a sole may sink before the summary calls it a fault."""


def _sole_heights(position: np.ndarray, quat: np.ndarray) -> np.ndarray:
    """(T,) height of the lowest sole corner, metres, from key-body poses."""
    feet = list(g1.FEET)
    corners = position[:, feet, None] + rotations.rotate(
        quat[:, feet, None], SOLE_CORNERS
    )
    return corners[..., 2].min(axis=(1, 2))


def _faults(clip: Clip, soles: np.ndarray, speeds: np.ndarray) -> list[str]:
    faults = []
    angles = clip.joint_angles
    outside = np.maximum(g1.JOINT_LOWER - angles, angles - g1.JOINT_UPPER)
    frame, joint = np.unravel_index(np.argmax(outside), outside.shape)
    if outside[frame, joint] > 1e-3:
        name, excess = g1.JOINT_NAMES[joint], outside[frame, joint]
        faults.append(f"frame {frame}: {name} is {excess:.3f} rad beyond its limit")
    ratio = speeds / g1.MAX_SPEED
    frame, joint = np.unravel_index(np.argmax(ratio), ratio.shape)
    if ratio[frame, joint] > 1:
        name, speed = g1.JOINT_NAMES[joint], speeds[frame, joint]
        faults.append(
            f"frame {frame}: {name} turns at {speed:.1f} rad/s, "
            f"its motor reaches {g1.MAX_SPEED[joint]:.0f}"
        )
    if soles.min() < -_NOTABLE_DEPTH:
        depth = -1000 * soles.min()
        faults.append(f"frame {np.argmin(soles)}: a sole is {depth:.0f} mm underground")
    return faults


def summarize(clip: Clip) -> str:
    """Describe ``clip`` in about ten lines, one fact each."""
    position, quat = Kinematics().trajectory(clip.qpos)
    points, _ = key_point_poses(position, quat)
    head_w = points[:, 0]
    soles = _sole_heights(position, quat)
    speeds = np.abs(np.diff(clip.joint_angles, axis=0)) * clip.info.fps
    steps = np.linalg.norm(np.diff(clip.root_position[:, :2], axis=0), axis=1)
    heading = np.degrees(np.unwrap(rotations.yaw(clip.root_quat)))
    fastest = g1.JOINT_NAMES[int(np.argmax(speeds.max(0)))]
    rows = {
        "name": clip.info.name,
        "category": clip.info.category,
        "source": clip.info.source,
        "licence": clip.info.licence,
        "length": f"{clip.num_frames} frames, {clip.seconds:.2f} s at "
        f"{clip.info.fps:g} fps",
        "path": f"{steps.sum():.2f} m, {steps.sum() / clip.seconds:.2f} m/s, "
        f"turns {heading[-1] - heading[0]:+.0f} deg",
        "head": f"{head_w[:, 2].min():.2f} to {head_w[:, 2].max():.2f} m high",
        "soles": f"the lower one {round(1000 * soles.min())} to "
        f"{round(1000 * soles.max())} mm above the ground",
        "fastest": f"{fastest}, {speeds.max():.1f} rad/s",
        "faults": "; ".join(_faults(clip, soles, speeds)) or "none",
    }
    return "\n".join(f"{name:9} {text}" for name, text in rows.items())
