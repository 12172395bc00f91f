"""G1 motions as CSV: what Unitree's retargeted LAFAN1 set and mjlab's converter use.

A row is a frame: pelvis position (metres, world), pelvis quaternion **xyzw**, and the
29 joint angles (radians, motor order), with commas between and no header. The file does
not hold the frame rate; it is 30 Hz by convention.
"""

from __future__ import annotations

from array import array
from pathlib import Path

import numpy as np

from openclone.errors import InputError
from openclone.motion.clip import Clip
from openclone.motion.skeleton import MAX_FRAMES
from openclone.motion.sources.g1_clip import (
    MAX_ANGLE,
    MAX_DISTANCE,
    clip_from_arrays,
    write_whole,
)
from openclone.motion.sources.text_lines import Lines, parse_numbers
from openclone.robot import g1

FPS = 30.0
COLUMNS = 7 + g1.NUM_JOINTS


def read(path: Path, fps: float = FPS) -> Clip:
    """Read a G1 CSV file recorded at ``fps``.

    Raises:
        InputError: the file is missing or a row malformed; the message names the line.
    """
    values = array("d")
    most = np.repeat((MAX_DISTANCE, 1.01, MAX_ANGLE), (3, 4, g1.NUM_JOINTS))
    with Lines(path) as lines:
        for line in lines:
            if not line:
                continue
            row = parse_numbers(line.split(","), COLUMNS, lines.where)
            far = np.flatnonzero(np.abs(row) > most)
            if len(far):
                raise InputError(
                    f"column {far[0] + 1} is {row[far[0]]:.4g}",
                    where=lines.where,
                    remedy="positions are in metres, joint angles in radians",
                )
            length = float(np.linalg.norm(row[3:7]))
            if abs(length - 1) > 0.01:
                raise InputError(
                    f"the quaternion has length {length:.4g}, expected 1",
                    where=lines.where,
                    remedy="columns 4 to 7 are the quaternion, w last",
                )
            if len(values) >= MAX_FRAMES * COLUMNS:
                raise InputError(
                    f"more than {MAX_FRAMES} frames",
                    where=lines.where,
                    remedy="cut the motion into pieces",
                )
            values.extend(row.tolist())
        where = lines.where
    rows = np.frombuffer(values, dtype=float).reshape(-1, COLUMNS)
    quat = rows[:, [6, 3, 4, 5]]
    return clip_from_arrays(path, fps, rows[:, :3], quat, rows[:, 7:], where)


def write(clip: Clip, path: Path) -> None:
    """Write ``clip`` at its own frame rate; numbers are written exactly."""
    rows = np.concatenate(
        (clip.root_position, clip.root_quat[:, [1, 2, 3, 0]], clip.joint_angles), axis=1
    )
    text = "\n".join(",".join(map(repr, row)) for row in rows.tolist()) + "\n"
    write_whole(path, text.encode())
