"""Clips that are commands and no motions: what head and hands ask for, no more.

Their legs slide or sink and are no example for anyone. They are marked by their source,
for training only, and exempt from the limits that they break on purpose.
"""

from __future__ import annotations

import math
from dataclasses import replace

from openclone.motion.clip import ClipInfo
from openclone.motion.quality import Gate

GLIDING = "openclone gliding laps"
"""Source of gliding laps, see `motion.sources.gliding`."""
COMMAND = "openclone command: "
"""How the source of all other commands begins."""


def is_command(info: ClipInfo) -> bool:
    """Whether a clip is a command alone."""
    return info.source == GLIDING or info.source.startswith(COMMAND)


def gate_for(info: ClipInfo, gate: Gate) -> Gate:
    """``gate`` as it is for ``info``: commands may slide their feet.

    Those other than gliding laps may also sink them into the ground.
    """
    if not is_command(info):
        return gate
    ground = gate.ground_share if info.source == GLIDING else math.inf
    return replace(gate, slide_cm_s=math.inf, ground_share=ground)
