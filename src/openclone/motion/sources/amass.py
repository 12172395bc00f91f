"""AMASS recordings (``.npz``): SMPL-H rotations on a fixed skeleton of average size.

The licensed body models are not needed: bone lengths come from the skeleton map, and
``betas`` and ``gender``, which only say how such a model is shaped, are not used.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from openclone.errors import InputError
from openclone.motion.npz import array_names, read_numbers, read_scalar
from openclone.motion.skeleton import HumanMotion, make_motion
from openclone.motion.skeleton_maps import KINDS, maps_for, pose_fixed, to_body_axes

RATES = ("mocap_framerate", "mocap_frame_rate")
"""The two spellings in AMASS (SMPL-H and SMPL-X releases)."""
WIDTHS = (72, 156, 165)
"""Columns of ``poses``: SMPL, SMPL-H and SMPL-X; the body comes first in each."""
MAX_TURN = 4 * np.pi
"""Radians; a rotation vector is no longer than this in a sound file."""


def is_amass(names: frozenset[str]) -> bool:
    """Whether an npz file with these arrays is an AMASS recording."""
    return {"poses", "trans"} <= names


def read(path: Path) -> HumanMotion:
    """Read an AMASS recording.

    Raises:
        InputError: the file is missing, damaged, or its arrays do not fit.
    """
    names = array_names(path)
    rate = [name for name in RATES if name in names]
    if not is_amass(names) or not rate:
        raise InputError(
            f"no array {'trans or poses' if rate else RATES[0]}",
            where=str(path),
            remedy="use an AMASS recording, not its shape.npz",
        )
    fps = read_scalar(path, rate[0])
    poses = read_numbers(path, "poses", (None, None))
    root = read_numbers(path, "trans", (len(poses), 3))
    item = maps_for("amass", path)[0]
    used = max(joint.column + KINDS[joint.kind] for joint in item.joints)
    if poses.shape[1] not in WIDTHS or used > poses.shape[1]:
        raise InputError(
            f"poses has {poses.shape[1]} columns, expected one of {WIDTHS}",
            where=str(path),
            remedy="use rotation vectors of SMPL-H",
        )
    body = poses[:, :used]
    if len(body) and np.abs(body).max() > MAX_TURN:
        frame = int(np.abs(body).max(1).argmax())
        raise InputError(
            f"poses[{frame}] holds {np.abs(body[frame]).max():.4g}",
            where=str(path),
            remedy="rotation vectors are in radians",
        )
    positions, quats = pose_fixed(item.joints, root, body)
    assert item.world is not None  # maps of this format name their axes
    return make_motion(
        path.stem, fps, positions @ item.world.T, to_body_axes(quats, item), str(path)
    )
