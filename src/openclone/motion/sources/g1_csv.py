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
from openclone.motion.sources.g1_clip import clip_from_arrays, write_whole
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
    with Lines(path) as lines:
        for line in lines:
            if not line:
                continue
            row = parse_numbers(line.split(","), COLUMNS, lines.where)
            length = float(np.linalg.norm(np.clip(row[3:7], -1e6, 1e6)))
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
    rows = np.frombuffer(values, dtype=float).reshape(-1, COLUMNS)
    quat = rows[:, [6, 3, 4, 5]]
    return clip_from_arrays(path, fps, rows[:, :3], quat, rows[:, 7:])


def write(clip: Clip, path: Path) -> None:
    """Write ``clip`` at its own frame rate; numbers are written exactly."""
    rows = np.concatenate(
        (clip.root_position, clip.root_quat[:, [1, 2, 3, 0]], clip.joint_angles), axis=1
    )
    text = "\n".join(",".join(map(repr, row)) for row in rows.tolist()) + "\n"
    write_whole(path, text.encode())
