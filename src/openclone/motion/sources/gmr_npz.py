"""G1 motions in the manner of GMR (General Motion Retargeting), as ``.npz``.

The arrays are those of GMR's own files, which are pickles and therefore never read:
``fps``, ``root_pos`` (T, 3), ``root_rot`` (T, 4) **xyzw**, ``dof_pos`` (T, 29).
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from openclone.motion.clip import Clip
from openclone.motion.npz import read_numbers, read_scalar
from openclone.motion.sources.g1_clip import clip_from_arrays, npz_bytes, write_whole
from openclone.robot import g1

ARRAYS = ("fps", "root_pos", "root_rot", "dof_pos")


def is_gmr(names: frozenset[str]) -> bool:
    """Whether an npz file with these arrays is of this kind."""
    return set(ARRAYS) <= names


def read(path: Path) -> Clip:
    """Read a GMR-style file.

    Raises:
        InputError: the file is missing, damaged, or its arrays do not fit.
    """
    position = read_numbers(path, "root_pos", (None, 3))
    quat = read_numbers(path, "root_rot", (len(position), 4))
    joints = read_numbers(path, "dof_pos", (len(position), g1.NUM_JOINTS))
    fps = read_scalar(path, "fps")
    return clip_from_arrays(path, fps, position, quat[:, [3, 0, 1, 2]], joints)


def write(clip: Clip, path: Path) -> None:
    """Write ``clip`` at its own frame rate."""
    arrays = {
        "fps": np.array(clip.info.fps),
        "root_pos": clip.root_position,
        "root_rot": clip.root_quat[:, [1, 2, 3, 0]],
        "dof_pos": clip.joint_angles,
    }
    write_whole(path, npz_bytes(arrays))
