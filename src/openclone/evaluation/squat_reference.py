"""References for squatting: down to a head height, hold, and up again (Fig. 3)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from openclone.evaluation.episode import Reference, make_reference
from openclone.motion.clip import ClipInfo, clip_from_qpos
from openclone.motion.heights import SHOULDER_PITCH
from openclone.motion.sources.deep_squats import (
    DEEPEST,
    in_seconds,
    way_down,
)
from openclone.robot.model import CONTROL_PERIOD, build_model

STAND_S, HOLD_S, AFTER_S = 1.0, 2.0, 2.0
"""Seconds: before going down, at the bottom, and after coming up."""
_LOWEST_HAND = 0.1
"""Metres; commanded hands stay above the ground."""


@dataclass(frozen=True)
class SquatReference:
    """What one trial commands.

    Attributes:
        target: metres, head height at the bottom.
        reference: key points to follow and, down to `DEEPEST`, the whole body.
        low: frames of the reference at the bottom, without the first second there.
        risen: frames at the end, upright again.
    """

    target: float
    reference: Reference
    low: slice
    risen: slice

    @property
    def has_body(self) -> bool:
        """Whether the whole-body reference is as low as the commanded points."""
        return self.target >= DEEPEST


def squat_reference(target: float, rng: np.random.Generator) -> SquatReference:
    """One squat with the head at ``target`` metres; arms and pace are drawn.

    Arms reach forward by up to 0.8 rad, going down and up takes 1.5 to 3 s each.

    Raises:
        InputError: the robot's legs cannot do it.
    """
    down = way_down(max(target, DEEPEST), _arms, rng)
    down_s, up_s = rng.uniform(1.5, 3.0, 2)
    going, rising = in_seconds(down, down_s), in_seconds(down, up_s)[::-1]
    stand, hold, after = (
        round(seconds / CONTROL_PERIOD) for seconds in (STAND_S, HOLD_S, AFTER_S)
    )
    parts = (
        np.repeat(going[:1], stand, axis=0),
        going,
        np.repeat(going[-1:], hold, axis=0),
        rising,
        np.repeat(rising[-1:], after, axis=0),
    )
    qpos = np.concatenate(parts)
    info = ClipInfo("squat", "squat", "openclone", "Apache-2.0", 1.0 / CONTROL_PERIOD)
    reference = make_reference(clip_from_qpos(info, qpos), build_model())
    if target < DEEPEST:
        reference = _further_down(reference, DEEPEST - target)
    bottom = stand + len(going)
    second = round(1.0 / CONTROL_PERIOD)
    low = slice(bottom + second, bottom + hold)
    return SquatReference(target, reference, low, slice(len(qpos) - second, len(qpos)))


def _arms(qpos: np.ndarray, rng: np.random.Generator) -> None:
    """Stretch both arms forward by up to 0.8 rad."""
    qpos[:, SHOULDER_PITCH] -= rng.uniform(0.0, 0.8)


def _further_down(reference: Reference, depth: float) -> Reference:
    """The commanded points up to ``depth`` metres lower, in step with the head."""
    height = reference.points[:, 0, 2]
    share = (height[0] - height) / (height[0] - height.min())
    points = reference.points.copy()
    points[..., 2] -= depth * share[:, None]
    points[:, 1:, 2] = np.maximum(points[:, 1:, 2], _LOWEST_HAND)
    velocities = np.gradient(points, CONTROL_PERIOD, axis=0)
    return replace(reference, points=points, point_velocities=velocities)
