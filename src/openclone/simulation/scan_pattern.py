"""Where each beam of a Livox Mid-360 points.

The pattern is made here, not copied: four lines a few degrees apart turn about the
sensor's axis 182 times a second while their common elevation goes down and up in 0.1 s,
and the bundle of lines rolls as it turns. Rates and ranges were read off the published
table (800 000 angle pairs, 4 s; MIT, PyPI ``mujoco-lidar``): like it, the pattern fills
-7 to 52 degrees evenly, touches about 13 400 one-degree cells in a frame, and does not
repeat from frame to frame.
"""

from __future__ import annotations

import numpy as np

POINTS_PER_SECOND = 200_000
_LINES = 4
_TURNS_PER_SECOND = 182.4176
_SWEEPS_PER_SECOND = 10.0
_MIDDLE_DEG, _SWEEP_DEG = 22.45, 25.7
_LINE_GAP_DEG = 2.75
"""Between neighbouring lines of the bundle."""


def beam_directions(index: np.ndarray) -> np.ndarray:
    """Unit vectors ``(N, 3)``, LiDAR frame, of the beams number ``index (N,)``.

    Beam 0 is the first one after power-on; 200 000 follow in a second.
    """
    group, line = np.divmod(np.asarray(index, dtype=np.int64), _LINES)
    time_s = group * (_LINES / POINTS_PER_SECOND)
    turn = -2.0 * np.pi * ((_TURNS_PER_SECOND * time_s) % 1.0)
    sweep = 4.0 * np.abs((_SWEEPS_PER_SECOND * time_s) % 1.0 - 0.5) - 1.0
    offset = (line - 0.5 * (_LINES - 1)) * _LINE_GAP_DEG
    # The bundle lies along the sweep at one side of the turn, across it a quarter on.
    elevation = np.radians(_MIDDLE_DEG + _SWEEP_DEG * sweep - offset * np.cos(turn))
    azimuth = turn + np.radians(offset) * np.sin(turn) / np.cos(elevation)
    flat = np.cos(elevation)
    return np.stack(
        (flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)), axis=-1
    )
