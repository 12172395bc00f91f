"""DeepMimic's JSON recordings (``humanoid3d_*.txt``): Y-up, facing +X, arms hanging."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from openclone.errors import InputError
from openclone.motion.skeleton import JOINTS, MAX_FRAMES, HumanMotion, make_motion
from openclone.motion.sources.bvh import MAX_BYTES
from openclone.spatial import rotations

FRAME_SIZE = 44
Z_UP = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
_Z_UP_QUAT = rotations.from_matrix(Z_UP)
# joint: parent, first column of its rotation, columns (4 quaternion, 1 hinge about z,
# 0 fixed), offset from the parent in metres, file axes (x forward, y up, z right).
_SKELETON: dict[str, tuple[str, int, int, tuple[float, float, float]]] = {
    "hips": ("", 4, 4, (0, 0, 0)),
    "chest": ("hips", 8, 4, (0, 0.236, 0)),
    "neck": ("chest", 12, 4, (0, 0.224, 0)),
    "head": ("neck", 0, 0, (0.02, 0.12, 0)),
    "right_hip": ("hips", 16, 4, (0, 0, 0.085)),
    "right_knee": ("right_hip", 20, 1, (0, -0.4215, 0)),
    "right_ankle": ("right_knee", 21, 4, (0, -0.41, 0)),
    "right_toe": ("right_ankle", 0, 0, (0.12, -0.04, 0)),
    "right_shoulder": ("chest", 25, 4, (-0.024, 0.2435, 0.183)),
    "right_elbow": ("right_shoulder", 29, 1, (0, -0.275, 0)),
    "right_wrist": ("right_elbow", 0, 0, (0, -0.259, 0)),
    "left_hip": ("hips", 30, 4, (0, 0, -0.085)),
    "left_knee": ("left_hip", 34, 1, (0, -0.4215, 0)),
    "left_ankle": ("left_knee", 35, 4, (0, -0.41, 0)),
    "left_toe": ("left_ankle", 0, 0, (0.12, -0.04, 0)),
    "left_shoulder": ("chest", 39, 4, (-0.024, 0.2435, -0.183)),
    "left_elbow": ("left_shoulder", 43, 1, (0, -0.275, 0)),
    "left_wrist": ("left_elbow", 0, 0, (0, -0.259, 0)),
}


def _arm_turn(joint: str) -> np.ndarray:
    """World turn (Z-up) that takes a T-pose arm to this file's hanging arm."""
    if not joint.endswith(("shoulder", "elbow", "wrist")):
        return np.array(rotations.IDENTITY)
    sign = -1.0 if joint.startswith("left") else 1.0
    return rotations.from_axis_angle(np.array([1.0, 0, 0]), sign * np.pi / 2)


def _local(values: np.ndarray, column: int, width: int) -> np.ndarray:
    if width == 4:
        return rotations.normalize(values[:, column : column + 4])
    angle = values[:, column] if width else np.zeros(len(values))
    return rotations.from_axis_angle(np.array([0.0, 0, 1]), angle)


def _read_frames(path: Path) -> np.ndarray:
    """``(T, 44)`` finite numbers."""
    if not path.is_file():
        raise InputError("no such file", where=str(path), remedy="check the path")
    if path.stat().st_size > MAX_BYTES:
        raise InputError("larger than 512 MB", where=str(path), remedy="split it")
    try:
        data = json.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise InputError(
            f"not valid JSON ({error})",
            where=str(path),
            remedy="the file is truncated or damaged; copy it again",
        ) from error
    frames = data.get("Frames") if isinstance(data, dict) else None
    if not isinstance(frames, list) or not 2 <= len(frames) <= MAX_FRAMES:
        raise InputError(
            f'no list "Frames" of 2 to {MAX_FRAMES} frames',
            where=str(path),
            remedy="use a DeepMimic motion file",
        )
    for index, row in enumerate(frames):
        numbers = isinstance(row, list) and all(type(x) in (int, float) for x in row)
        if not numbers or len(row) != FRAME_SIZE or not np.isfinite(row).all():
            raise InputError(
                f"expected {FRAME_SIZE} finite numbers",
                where=f"{path}, Frames[{index}]",
                remedy="use the humanoid3d format: duration, root pose, 12 joints",
            )
    values = np.array(frames, dtype=float)
    for joint, (_, column, width, _) in _SKELETON.items():
        if width == 4:
            lengths = np.linalg.norm(values[:, column : column + 4], axis=1)
            worst = int(np.abs(lengths - 1).argmax())
            if abs(lengths[worst] - 1) > 0.5:  # blended by some exporters
                raise InputError(
                    f"the quaternion of {joint} has length {lengths[worst]:.3g}",
                    where=f"{path}, Frames[{worst}]",
                    remedy="write unit quaternions, w first",
                )
    return values


def read(path: Path) -> HumanMotion:
    """Read a DeepMimic motion on a fixed skeleton of average size.

    Raises:
        InputError: the file is missing, truncated, malformed or of another body.
    """
    values = _read_frames(path)
    steps = values[:-1, 0]
    if not (steps > 0).all():
        raise InputError(
            f"duration {steps.min():g} s",
            where=f"{path}, Frames[{int(steps.argmin())}]",
            remedy="every frame but the last lasts longer than zero",
        )
    positions, quats = {}, {}
    for joint, (parent, column, width, offset) in _SKELETON.items():
        turn = _local(values, column, width)
        if not parent:
            positions[joint], quats[joint] = values[:, 1:4], turn
            continue
        positions[joint] = positions[parent] + rotations.rotate(
            quats[parent], np.array(offset, dtype=float)
        )
        quats[joint] = rotations.multiply(quats[parent], turn)
    position = np.stack([positions[joint] for joint in JOINTS], 1) @ Z_UP.T
    quat = np.stack([quats[joint] for joint in JOINTS], 1)
    turn = np.broadcast_to(_Z_UP_QUAT, quat.shape)
    quat = rotations.multiply(rotations.multiply(turn, quat), rotations.conjugate(turn))
    hanging = np.stack([_arm_turn(joint) for joint in JOINTS])
    quat = rotations.multiply(quat, np.broadcast_to(hanging, quat.shape))
    return make_motion(
        path.stem, 1.0 / float(np.median(steps)), position, quat, str(path)
    )
