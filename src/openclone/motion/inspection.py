"""What belongs to a clip file: the human recording that it was made of."""

from __future__ import annotations

import itertools
import json
from dataclasses import replace
from pathlib import Path

import numpy as np

from openclone.errors import InputError
from openclone.motion import library
from openclone.motion.clip import Clip
from openclone.motion.curate import BUILD_FILE
from openclone.motion.enrich import slowness
from openclone.motion.skeleton import JOINTS, SIDES, HumanMotion, start_at_origin

_CHAINS = (
    ("hips", "chest", "neck", "head"),
    *(("hips", f"{s}_hip", f"{s}_knee", f"{s}_ankle", f"{s}_toe") for s in SIDES),
    *(("neck", f"{s}_shoulder", f"{s}_elbow", f"{s}_wrist") for s in SIDES),
)
BONES = tuple(
    (JOINTS.index(a), JOINTS.index(b))
    for chain in _CHAINS
    for a, b in itertools.pairwise(chain)
)
"""Pairs of indices into `skeleton.JOINTS` that are connected."""


def find_recording(clip: Clip, path: Path) -> Path | None:
    """The recording of a clip in a data set made by `curate.build`, if it is there."""
    build = path.resolve().parent.parent / BUILD_FILE
    try:
        sources = json.loads(build.read_text(encoding="utf-8"))["sources"]
    except (OSError, ValueError, KeyError, TypeError):
        return None
    # The name starts with the source's when two sources had one name.
    for source in (build.parent / str(item) for item in sources):
        for root in (source, source.parent):
            recording = root / clip.info.source
            if recording.is_file() and recording.suffix != ".npz":
                return recording
    return None


def human_beside(clip: Clip, recording: Path) -> np.ndarray:
    """(T, 18, 3), metres: the recorded human's joints in the clip's world and rate.

    Raises:
        InputError: the recording cannot be read or is not this clip's.
    """
    motion: HumanMotion = library.read_recording(recording)
    motion = replace(motion, fps=motion.fps / slowness(clip.info.name))
    motion = start_at_origin(motion.resampled(clip.info.fps))
    if abs(motion.num_frames - clip.num_frames) > 2:
        raise InputError(
            f"lasts {motion.num_frames} frames, the clip {clip.num_frames}",
            where=str(recording),
            remedy="give the recording that the clip was made of",
        )
    frames = np.minimum(np.arange(clip.num_frames), motion.num_frames - 1)
    positions = motion.positions[frames].copy()
    positions[..., 2] -= np.percentile(positions[..., 2].min(axis=1), 5)
    return positions
