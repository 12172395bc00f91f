"""Other timings of a motion: slower, faster, uneven, and backwards in time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from openclone.errors import InputError
from openclone.motion.clip import Clip, clip_from_qpos
from openclone.motion.contacts import runs, smooth
from openclone.motion.planted import EditRefused, Feet, feet_of
from openclone.motion.soundness import check_edit
from openclone.robot import g1
from openclone.spatial import rotations

_SLOWEST, _FASTEST = 0.4, 2.5
_FLIGHT_S = 0.06
"""Seconds off the ground that count as flight."""
_FLIGHT_TOLERANCE = 0.05
"""Share by which the time in flight may change: gravity cannot be warped."""
_AIRBORNE = 0.01
"""Metres above the ground at which a sole carries nothing."""
_REVERSED = {"forward": "backward", "backward": "forward"}


def flights(feet: Feet, fps: float) -> list[tuple[int, int]]:
    """Half-open spans of frames in which neither foot is on the ground."""
    airborne = feet.lowest().min(axis=1) > _AIRBORNE
    return [
        (start, stop)
        for start, stop in runs(airborne)
        if (stop - start) / fps > _FLIGHT_S
    ]


def _resampled_at(clip: Clip, at: np.ndarray) -> np.ndarray:
    """Positions ``(n, 36)`` at fractional frames ``at``."""
    low = np.clip(at.astype(int), 0, clip.num_frames - 2)
    part = at - low
    mix = part[:, None]
    position, angles = clip.root_position, clip.joint_angles
    quat = rotations.slerp(clip.root_quat[low], clip.root_quat[low + 1], part)
    return np.column_stack(
        (
            position[low] * (1 - mix) + position[low + 1] * mix,
            quat,
            angles[low] * (1 - mix) + angles[low + 1] * mix,
        )
    )


def random_rates(
    rng: np.random.Generator, seconds: float, spread: float, fps: float
) -> np.ndarray:
    """Rates ``(T,)`` that wander smoothly between 1 / (1 + spread) and 1 + spread."""
    knots = rng.uniform(-1.0, 1.0, max(int(seconds / 1.2) + 2, 3))
    at = np.linspace(0, len(knots) - 1, round(seconds * fps) + 1)
    shape = np.interp(at, np.arange(len(knots)), knots)
    return (1.0 + spread) ** smooth(shape[:, None], 0.3 * fps)[:, 0]


def time_warped(clip: Clip, rate: float | np.ndarray) -> Clip:
    """``clip`` played at ``rate`` (above 1: faster).

    Args:
        clip: the motion.
        rate: one number, or one per frame ``(T,)`` of ``clip``.

    Raises:
        InputError: a rate is out of range or their number is wrong.
        EditRefused: a flight would last longer or shorter than gravity allows, a
            motor is too slow, feet would slide, or the balance is lost.
    """
    rates = np.broadcast_to(np.asarray(rate, dtype=float), (clip.num_frames,))
    name = f"{clip.info.name}~rate{100 * float(rates.mean()):.0f}"
    if not (np.isfinite(rates) & (rates >= _SLOWEST) & (rates <= _FASTEST)).all():
        raise InputError(
            f"the rates are {rates.min():g} to {rates.max():g}",
            where=clip.info.name,
            remedy=f"give {_SLOWEST:g} to {_FASTEST:g}",
        )
    for start, stop in flights(feet_of(clip.qpos), clip.info.fps):
        mean = float(rates[start:stop].mean())
        if abs(mean - 1.0) > _FLIGHT_TOLERANCE:
            raise EditRefused(
                f"the robot flies in the frames {start} to {stop}: at {mean:.2f} times "
                "the speed it would not fall as gravity makes it",
                reason="flight",
                where=name,
                remedy="warp the parts before and after the flight only",
            )
    # When each old frame is shown, and from it which old frame is shown when.
    shown = np.concatenate(([0.0], np.cumsum(2.0 / (rates[1:] + rates[:-1]))))
    count = int(shown[-1] + 1e-9) + 1
    at = np.interp(np.arange(count), shown, np.arange(clip.num_frames))
    info = replace(clip.info, name=name)
    warped = clip_from_qpos(info, _resampled_at(clip, at))
    check_edit(warped, (clip,))
    return warped


def time_reversed(clip: Clip) -> Clip:
    """``clip`` backwards in time; walking forward becomes walking backward.

    Positions and accelerations are those of the original, so balance, contacts and
    flights stay what they were; the check shows it.

    Raises:
        EditRefused: the motion is not clean.
    """
    category = _REVERSED.get(clip.info.category, clip.info.category)
    info = replace(clip.info, name=f"{clip.info.name}~reversed", category=category)
    result = clip_from_qpos(info, clip.qpos[::-1])
    check_edit(result, (clip,))
    return result


def speed_margin(clip: Clip) -> float:
    """How many times faster the clip could play before a motor is too slow."""
    speed = np.abs(np.diff(clip.joint_angles, axis=0)) * clip.info.fps
    return float(1.0 / max((speed / g1.MAX_SPEED).max(), 1e-9))
