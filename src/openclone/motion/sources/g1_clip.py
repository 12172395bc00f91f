"""What the readers and writers of G1 motions share."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

from openclone.errors import InputError
from openclone.motion.clip import Clip, ClipInfo, check_clip
from openclone.spatial import rotations

CATEGORY = "transition"
LICENCE = "unknown"
MAX_ANGLE = 10.0
"""Radians; no joint of the G1 turns that far."""
MAX_DISTANCE = 1000.0
"""Metres from the origin."""


def clip_from_arrays(
    path: Path,
    fps: float,
    position: np.ndarray,
    quat: np.ndarray,
    joints: np.ndarray,
    where: str = "",
) -> Clip:
    """Check the arrays of a file and make a clip of them.

    Args:
        path: the file, which also gives the clip its name.
        fps: frames per second.
        position: (T, 3), metres, world: the pelvis.
        quat: (T, 4), wxyz, world from pelvis.
        joints: (T, 29), radians, motor order.
        where: the place in the file, for errors.

    Raises:
        InputError: lengths differ, or a value makes no sense.
    """
    where = where or str(path)
    # Quaternions that are unit already stay as they are: round trips are exact.
    lengths = np.linalg.norm(quat, axis=-1, keepdims=True)
    if len(quat) and abs(lengths - 1).max() > 0.01:
        frame = int(abs(lengths - 1).argmax())
        length = lengths[frame, 0]
        raise InputError(
            f"the root's quaternion in frame {frame} has length {length:.4g}",
            where=where,
            remedy="write unit quaternions",
        )
    unit = np.where(abs(lengths - 1) < 1e-9, quat, rotations.normalize(quat))
    info = ClipInfo(path.stem, CATEGORY, path.name, LICENCE, fps)
    clip = Clip(info, position, rotations.make_continuous(unit), joints)
    clip = check_clip(clip, where)
    for name, values, most in (
        ("a joint angle in radians", joints, MAX_ANGLE),
        ("the pelvis position in metres", position, MAX_DISTANCE),
    ):
        frame = int(np.abs(values).max(1).argmax())
        if np.abs(values[frame]).max() > most:
            raise InputError(
                f"{name} is {np.abs(values[frame]).max():.4g} in frame {frame}",
                where=where,
                remedy="check units and columns",
            )
    return clip


def write_whole(path: Path, data: bytes) -> None:
    """Write a file; an interrupted write leaves no half file behind."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(path.name + ".partial")
    partial.write_bytes(data)
    partial.replace(path)


def npz_bytes(arrays: dict[str, np.ndarray]) -> bytes:
    """The content of an ``.npz`` file."""
    stream = io.BytesIO()
    np.savez_compressed(stream, allow_pickle=False, **arrays)
    return stream.getvalue()
