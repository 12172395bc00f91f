"""Legs of one motion, arms and waist of another (section 3.4).

What belongs together in time stays together: the upper body is played at one constant
rate from where its own activity begins, so that it happens while the legs do their
part; where it is too short it waits in its first and last pose.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from openclone.motion.clip import Clip, clip_from_qpos
from openclone.motion.contacts import smooth
from openclone.motion.planted import EditRefused, feet_of, replanted
from openclone.motion.soundness import check_edit
from openclone.motion.sources.elbow_room import LEFT_ROLL, RIGHT_ROLL, spread
from openclone.motion.sources.track import minimum_jerk
from openclone.motion.sources.whole_body import centre_of_mass
from openclone.robot import g1

_UPPER = slice(12, 29)
"""Columns of waist and arms among the joints."""
_MOVING = 0.3
"""Radians per second of the fastest joint; less is rest."""


@dataclass(frozen=True)
class RecombineConfig:
    """How the upper body is fitted to the legs.

    Attributes:
        slowest, fastest: limits of the rate at which the upper body is played.
        hold_s: seconds in which the upper body's start and end poses are taken from
            and given back to the lower clip's own.
    """

    slowest: float = 0.75
    fastest: float = 1.33
    hold_s: float = 0.6


def active_span(joint_angles: np.ndarray, fps: float) -> tuple[int, int]:
    """Half-open span of frames in which any of ``joint_angles (T, n)`` moves.

    The whole motion if nothing ever does.
    """
    speed = np.abs(np.gradient(smooth(joint_angles, 0.04 * fps), 1.0 / fps, axis=0))
    moving = np.flatnonzero(speed.max(axis=1) > _MOVING)
    if not len(moving):
        return 0, len(joint_angles)
    return int(moving[0]), int(moving[-1]) + 1


def _sampled(values: np.ndarray, at: np.ndarray) -> np.ndarray:
    """``values (T, n)`` at fractional frames ``at``, held beyond both ends."""
    at = np.clip(at, 0, len(values) - 1)
    low = np.minimum(at.astype(int), len(values) - 2)
    part = (at - low)[:, None]
    return values[low] * (1 - part) + values[low + 1] * part


def fitted_upper(lower: Clip, upper: Clip, config: RecombineConfig) -> np.ndarray:
    """(T, 17) waist and arms of ``upper`` on the time line of ``lower``.

    Activity begins and, if the rate allows, ends together with that of the legs.
    """
    fps = lower.info.fps
    upper = upper.resampled(fps)
    legs = active_span(lower.joint_angles[:, g1.LOWER_BODY], fps)
    arms = active_span(upper.joint_angles[:, _UPPER], fps)
    rate = (arms[1] - arms[0]) / max(legs[1] - legs[0], 1)
    rate = float(np.clip(rate, config.slowest, config.fastest))
    needed = (arms[1] - arms[0]) / rate
    # Too long for the legs' activity: centre it there, within the clip.
    middle = 0.5 * (legs[0] + legs[1])
    start = legs[0] if needed <= legs[1] - legs[0] else middle - 0.5 * needed
    start = float(np.clip(start, 0.0, max(lower.num_frames - needed, 0.0)))
    at = arms[0] + (np.arange(lower.num_frames) - start) * rate
    at = np.clip(at, min(arms[0], max(at[0], 0)), arms[1] - 1)
    return _sampled(upper.joint_angles[:, _UPPER], at)


def recombined(lower: Clip, upper: Clip, config: RecombineConfig | None = None) -> Clip:
    """Pelvis and legs of ``lower`` with waist and arms of ``upper``.

    The upper body starts and ends in the lower clip's own pose. The pelvis moves
    aside by as much as the other arms shift the centre of mass; the feet stay.

    Raises:
        EditRefused: the legs cannot make up for the arms, or parts would touch.
    """
    config = config or RecombineConfig()
    name = f"{lower.info.name}~with~{upper.info.name.replace('/', '_')}"
    fps = lower.info.fps
    if lower.seconds < 2 * config.hold_s:
        raise EditRefused(
            f"the lower body's clip has only {lower.seconds:.2f} s",
            reason="too short",
            where=name,
            remedy=f"choose one of at least {2 * config.hold_s:g} s",
        )
    frames = np.arange(lower.num_frames)
    ends = np.minimum(frames, frames[::-1]) / (config.hold_s * fps)
    weight = minimum_jerk(ends)[:, None]
    own = lower.joint_angles[:, _UPPER]
    qpos = lower.qpos
    qpos[:, 19:] = own + weight * (fitted_upper(lower, upper, config) - own)
    feet, com_xy = feet_of(lower.qpos), centre_of_mass(lower.qpos)[:, :2]
    offset = spread(qpos)
    qpos[:, LEFT_ROLL] += offset[:, 0]
    qpos[:, RIGHT_ROLL] -= offset[:, 1]
    qpos[:, 19:] = np.clip(qpos[:, 19:], g1.JOINT_LOWER[12:], g1.JOINT_UPPER[12:])
    qpos = replanted(qpos, feet, com_xy, what=name)
    source = f"{lower.info.source} (legs), {upper.info.source} (arms)"
    licence = lower.info.licence
    if upper.info.licence != licence:
        licence = f"{licence}; {upper.info.licence}"
    info = replace(lower.info, name=name, source=source, licence=licence)
    clip = clip_from_qpos(info, qpos)
    check_edit(clip, (lower, upper))
    return clip
