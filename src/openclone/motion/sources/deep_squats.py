"""Deep squats, made as the paper makes them: a standing motion brought down (Fig. 3).

Half of them are commands and no motions. An operator's head comes lower, for the
robot's size, than its legs allow; from the lowest stance on, the body then sinks into
the ground. A teacher that is rewarded for the body's place learns to stay up there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from openclone.errors import InputError
from openclone.motion.clip import Clip, ClipInfo, clip_from_qpos
from openclone.motion.commands import COMMAND
from openclone.motion.heights import (
    SHOULDER_PITCH,
    HeightConfig,
    head_heights,
    with_head_height,
)
from openclone.motion.planted import EditRefused
from openclone.motion.sources.choreography import FPS
from openclone.robot.model import standing_qpos

DEEPEST = 0.6
"""Metres; the lowest head of a whole-body reference with flat soles. Already at 0.55 m
the edit of `motion.heights` puts links into each other and is refused."""
_SHOULDER_ROLL, _ELBOW = (23, 30), (25, 32)
"""Columns of qpos, left and right."""
_LICENCE = "Apache-2.0, made by OpenClone"
_ATTEMPTS = 20
_EDIT_S = 1.0
_DEEPER = 0.17
"""Metres by which commands go below `DEEPEST`; the 0.6 m of a human need 0.13."""

Arms = Callable[[np.ndarray, np.random.Generator], None]
"""Moves the arms of standing poses (T, 36) in place."""


def way_down(target: float, arms: Arms, rng: np.random.Generator) -> Clip:
    """From standing to a head height of ``target`` metres in one second.

    Raises:
        InputError: the robot's legs cannot do it, with whatever arms were drawn.
    """
    frames = round(_EDIT_S * FPS) + 1
    info = ClipInfo("squat", "stand", "openclone", _LICENCE, FPS)
    reason = ""
    for _ in range(_ATTEMPTS):
        qpos = np.tile(standing_qpos(), (frames, 1))
        arms(qpos, rng)
        try:
            config = HeightConfig(approach_s=_EDIT_S)
            return with_head_height(clip_from_qpos(info, qpos), target, config)
        except EditRefused as refusal:
            reason = str(refusal)
    raise InputError(
        f"the robot cannot squat to a head height of {target:.2f} m ({reason})",
        remedy=f"choose heights between {DEEPEST} and 1.2 m",
    )


def in_seconds(clip: Clip, seconds: float) -> np.ndarray:
    """``clip`` stretched to last ``seconds``: qpos at 50 Hz."""
    fps = (clip.num_frames - 1) / seconds
    stretched = replace(clip, info=replace(clip.info, fps=fps))
    return stretched.resampled(FPS).qpos


def deep_squat_set(seed: int, count: int) -> list[Clip]:
    """``count`` deep squats, every other one a command; equal seeds give equal ones.

    Heads go down to between `DEEPEST` and 0.75 m; those of commands to `DEEPEST`, and
    then up to 0.17 m into the ground, with arms raised so that no hand gets there.
    """
    clips = []
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        command = number % 2 == 1
        qpos = _squat(rng, DEEPEST if command else rng.uniform(DEEPEST, 0.75), command)
        if command:
            height = head_heights(qpos)
            share = (height[0] - height) / (height[0] - height.min())
            qpos[:, 2] -= rng.uniform(0.0, _DEEPER) * share
        name = f"synthetic/deep_squat_{number:02d}"
        source = f"{COMMAND}deep squat" if command else "openclone deep squats"
        info = ClipInfo(name, "squat", source, _LICENCE, FPS)
        clips.append(clip_from_qpos(info, qpos))
    return clips


def _squat(rng: np.random.Generator, target: float, raised: bool) -> np.ndarray:
    """Wait, go down, hold, come up, wait: ``(T, 36)``."""

    def arms(qpos: np.ndarray, rng: np.random.Generator) -> None:
        qpos[:, SHOULDER_PITCH] -= rng.uniform(*((0.9, 1.4) if raised else (0.0, 0.9)))
        qpos[:, _SHOULDER_ROLL[0]] += rng.uniform(0.0, 0.3)
        qpos[:, _SHOULDER_ROLL[1]] -= rng.uniform(0.0, 0.3)
        qpos[:, _ELBOW] += rng.uniform(*((0.0, 0.5) if raised else (-0.3, 0.3)))

    down = way_down(target, arms, rng)
    going, rising = (in_seconds(down, s) for s in rng.uniform(0.9, 3.0, 2))
    wait, hold = rng.uniform(0.5, 1.2), rng.uniform(0.5, 3.0)

    def still(row: np.ndarray, seconds: float) -> np.ndarray:
        return np.repeat(row, round(seconds * FPS), axis=0)

    return np.concatenate(
        (
            still(going[:1], wait),
            going,
            still(going[-1:], hold),
            rising[::-1],
            still(rising[:1], 1.5),
        )
    )
