"""Hand-orientation augmentation (section 3.4): the same motion, other hands.

Recordings and synthetic motions rarely turn the wrists. Here each hand gets 6D
targets: orientations drawn over the whole range of the G1's wrist and small offsets of
its position, joined by spherical linear interpolation (SLERP). The arms are solved for
the targets frame by frame; where a target is out of reach, the hand stays as much
nearer to the original as needed.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.ndimage import gaussian_filter1d, maximum_filter1d

from openclone.motion.clip import Clip, clip_from_qpos
from openclone.motion.soundness import check_edit
from openclone.motion.sources.elbow_room import touching
from openclone.motion.sources.serial_chain import SerialChain
from openclone.motion.sources.track import minimum_jerk
from openclone.motion.sources.whole_body import g1_model
from openclone.robot import g1
from openclone.spatial import rotations

_SIDES = ("left", "right")
_ARM = (slice(22, 29), slice(29, 36))
"""Columns of both arms in qpos; the last three of each are the wrist."""
_PASSES = 8
_RETREAT = 0.25
"""Share of the way to the original by which one pass takes a hand back."""
_RETREAT_S = 0.25
"""Seconds around a frame out of reach in which the hand is taken back as well."""


@dataclass(frozen=True)
class HandConfig:
    """How hands are varied.

    Attributes:
        limit_share: share of the wrist's range from which orientations are drawn.
        offset: metres by which a hand's position may differ from the original.
        shortest_s, longest_s: between two targets, seconds.
        peak_speed: rad/s that a hand turns at most between two targets.
        ease_s: seconds at both ends in which the hands leave and meet the original.
        position_tolerance, angle_tolerance: metres and radians by which a reached
            hand may miss its target.
        speed_share: share of a motor's speed that the arms may use.
    """

    limit_share: float = 0.9
    offset: float = 0.05
    shortest_s: float = 0.6
    longest_s: float = 2.0
    peak_speed: float = 4.0
    ease_s: float = 0.4
    position_tolerance: float = 0.01
    angle_tolerance: float = 0.09
    speed_share: float = 0.4


@dataclass(frozen=True)
class WristTargets:
    """Targets of one hand over T frames.

    Attributes:
        offset: (T, 3), metres, torso frame, from the original position.
        quat: (T, 4), wxyz, forearm from hand.
    """

    offset: np.ndarray
    quat: np.ndarray


@cache
def _arm(side: int) -> SerialChain:
    end = f"{_SIDES[side]}_wrist_yaw_link"
    return SerialChain.of(g1_model(), "torso_link", end, g1.HAND_OFFSET)


@cache
def _wrist(side: int) -> SerialChain:
    name = _SIDES[side]
    return SerialChain.of(
        g1_model(), f"{name}_elbow_link", f"{name}_wrist_yaw_link", (0.0, 0.0, 0.0)
    )


def wrist_quat(side: int, angles: np.ndarray) -> np.ndarray:
    """Forearm from hand ``(B, 4)`` for wrist roll, pitch and yaw ``(B, 3)``."""
    return rotations.from_matrix(_wrist(side).forward(angles).rotation)


def draw_targets(
    rng: np.random.Generator, side: int, frames: int, fps: float, config: HandConfig
) -> tuple[WristTargets, np.ndarray]:
    """Targets for ``frames`` frames, and wrist angles ``(T, 3)`` that are near them.

    Orientations are drawn uniformly over the wrist's joints, so each can be reached
    by the wrist; SLERP joins them at a speed that starts and ends at rest.
    """
    chain = _wrist(side)
    middle, half = 0.5 * (chain.lower + chain.upper), 0.5 * (chain.upper - chain.lower)
    half = config.limit_share * half

    def draw() -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        angles = middle + rng.uniform(-half, half)
        return angles, wrist_quat(side, angles[None])[0], _in_ball(rng, config.offset)

    angles, quats, offsets = (
        np.empty((frames, 3)),
        np.empty((frames, 4)),
        np.empty((frames, 3)),
    )
    start, here = 0, draw()
    while start < frames:
        there = draw()
        turn = float(rotations.angle_between(here[1], there[1]))
        # The curve of least jerk is 1.875 times faster in its middle than on average.
        seconds = max(
            rng.uniform(config.shortest_s, config.longest_s),
            1.875 * turn / config.peak_speed,
        )
        count = max(round(seconds * fps), 2)
        part = minimum_jerk(np.arange(count) / count)[: frames - start]
        span = slice(start, start + len(part))
        ones = np.ones((len(part), 1))
        quats[span] = rotations.slerp(here[1] * ones, there[1] * ones, part)
        angles[span] = here[0] + part[:, None] * (there[0] - here[0])
        offsets[span] = here[2] + part[:, None] * (there[2] - here[2])
        start, here = start + count, there
    return WristTargets(offsets, rotations.make_continuous(quats)), angles


def _in_ball(rng: np.random.Generator, radius: float) -> np.ndarray:
    """(3,) uniform in a ball."""
    direction = rng.normal(size=3)
    direction /= np.linalg.norm(direction) + 1e-12
    return direction * radius * rng.uniform() ** (1 / 3)


@dataclass(frozen=True)
class _Reached:
    """Arm angles (T, 7) and which frames (T,) missed their target."""

    angles: np.ndarray
    missed: np.ndarray


def _reach(
    side: int,
    arm: np.ndarray,
    targets: WristTargets,
    wrist: np.ndarray,
    weight: np.ndarray,
    config: HandConfig,
) -> _Reached:
    """Solve one arm for its targets, ``weight (T,)`` of the way from the original."""
    chain = _arm(side)
    pose = chain.forward(arm)
    hand = rotations.from_matrix(pose.rotation)
    forearm = rotations.multiply(
        hand, rotations.conjugate(wrist_quat(side, arm[:, 4:]))
    )
    wanted = rotations.slerp(hand, rotations.multiply(forearm, targets.quat), weight)
    position = pose.position + weight[:, None] * targets.offset
    start = arm.copy()
    start[:, 4:] += weight[:, None] * (wrist - arm[:, 4:])
    found, _ = chain.reach_pose(position, rotations.to_matrix(wanted), start, 25)
    found = np.clip(found, chain.lower + 0.01, chain.upper - 0.01)
    # Where nothing is to change, nothing changes, limits or not.
    found = np.where(weight[:, None] > 1e-3, found, arm)
    got = chain.forward(found)
    away = np.linalg.norm(got.position - position, axis=1)
    turned = rotations.angle_between(rotations.from_matrix(got.rotation), wanted)
    missed = (away > config.position_tolerance) | (turned > config.angle_tolerance)
    return _Reached(found, missed & (weight > 1e-3))


def _too_fast(angles: np.ndarray, side: int, fps: float, share: float) -> np.ndarray:
    """(T,) frames in which a joint of the arm is faster than ``share`` of its motor."""
    limit = share * g1.MAX_SPEED[15 + 7 * side : 22 + 7 * side]
    fast = (np.abs(np.diff(angles, axis=0)) * fps > limit).any(axis=1)
    return np.append(fast, False) | np.insert(fast, 0, False)


def with_varied_hands(
    clip: Clip, rng: np.random.Generator, config: HandConfig | None = None
) -> Clip:
    """``clip`` with hands that turn over the wrist's whole range.

    Body and legs stay as they are. Where a target cannot be reached, is too fast for
    a motor, or would push the arm into the body, the hand follows the original more.

    Raises:
        EditRefused: the result is not clean; says why.
    """
    config = config or HandConfig()
    qpos, fps, frames = clip.qpos, clip.info.fps, clip.num_frames
    ends = np.minimum(np.arange(frames), np.arange(frames)[::-1])
    ease = minimum_jerk(ends / max(config.ease_s * fps, 1.0))
    drawn = [draw_targets(rng, side, frames, fps, config) for side in range(2)]
    retreat = np.zeros((frames, 2))
    edited = qpos.copy()
    for attempt in range(_PASSES):
        bad = np.zeros((frames, 2), dtype=bool)
        for side in range(2):
            weight = ease * np.clip(1.0 - retreat[:, side], 0.0, 1.0)
            arm, (targets, wrist) = qpos[:, _ARM[side]], drawn[side]
            reached = _reach(side, arm, targets, wrist, weight, config)
            edited[:, _ARM[side]] = reached.angles
            fast = _too_fast(reached.angles, side, fps, config.speed_share)
            bad[:, side] = reached.missed | (fast & (weight > 1e-3))
        hit = np.repeat(touching(edited[::3]), 3, axis=0)[:frames]
        bad |= hit & (retreat < 1.0)
        if not bad.any() or attempt == _PASSES - 1:
            break
        retreat = _taken_back(retreat, bad, fps)
    info = replace(clip.info, name=f"{clip.info.name}~hands")
    result = clip_from_qpos(info, edited)
    check_edit(result, (clip,))
    return result


def _taken_back(retreat: np.ndarray, bad: np.ndarray, fps: float) -> np.ndarray:
    """``retreat (T, 2)`` raised, smoothly in time, around the ``bad`` frames."""
    reach = round(_RETREAT_S * fps)
    wide = maximum_filter1d(bad.astype(float), 4 * reach + 1, axis=0)
    return retreat + _RETREAT * gaussian_filter1d(wide, reach, axis=0, mode="nearest")
