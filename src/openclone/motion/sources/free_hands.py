"""Hands that go wherever arms can, above the head too, while the body does its part.

Recordings show what their actors happened to do; an operator points at a shelf, wipes a
window or stretches. A student that never saw a hand up there guesses the arm wrongly,
by half a metre, and falls over its own arm.
"""

from __future__ import annotations

import numpy as np

from openclone.motion.clip import Clip, ClipInfo
from openclone.motion.sources import gestures, locomotion
from openclone.motion.sources.choreography import FPS, LEFT, RIGHT, Choreography
from openclone.motion.sources.synthetic import LICENCE, finish, solved, start
from openclone.motion.sources.track import oscillation

_LOWEST = np.array([-1.3, 0.0, -0.9, -0.8, -1.6, -0.9, -0.9])
_HIGHEST = np.array([0.5, 1.4, 0.9, 1.3, 1.6, 0.9, 0.9])
"""Radians between which joints of the left arm are drawn."""
_RAISED = (-2.7, -1.3)
"""Radians of shoulder pitch: the upper arm level or higher."""
_RAISED_SHARE = 0.5
_LOCOMOTION_SHARE = 0.3
_SWAY_HZ = (0.25, 0.55)
_SCRUB_HZ = (0.5, 1.5)
_LONGEST_S = 24.0


def random_arm(rng: np.random.Generator, side: int) -> np.ndarray:
    """(7,) radians, motor order, of arm ``side`` (`LEFT`, `RIGHT`); half are raised."""
    arm = rng.uniform(_LOWEST, _HIGHEST)
    if rng.uniform() < _RAISED_SHARE:
        arm[0] = rng.uniform(*_RAISED)
    return gestures.mirrored(arm, side)


def _roam(score: Choreography, start_s: float, end_s: float) -> None:
    """Arms at work from ``start_s`` to ``end_s``: go somewhere, wait or scrub there."""
    rng, relaxed = score.rng, score.arms.end.copy()
    time_s = start_s
    while time_s < end_s - 3.0:
        sides = [LEFT, RIGHT] if rng.uniform() < 0.5 else [int(rng.integers(2))]
        arms = score.arms.end.copy()
        for side in sides:
            arms[gestures.arm_columns(side)] = random_arm(rng, side)
        farthest = float(np.abs(arms - score.arms.end).max())
        seconds = max(0.5, farthest / rng.uniform(1.0, 2.8))
        score.arms.move(time_s, time_s + seconds, arms)
        time_s += seconds
        stay_s = rng.uniform(0.1, 1.0)
        if rng.uniform() < 0.5:
            stay_s = rng.uniform(1.5, 3.5)
            amount = np.zeros(14)
            for side in sides:
                swing = rng.uniform(0.1, 0.4) * rng.normal(size=7)
                amount[gestures.arm_columns(side)] = swing
            cycles = stay_s * rng.uniform(*_SCRUB_HZ)
            score.arms.add(time_s, time_s + stay_s, amount, oscillation(cycles))
        time_s += stay_s
    farthest = float(np.abs(relaxed - score.arms.end).max())
    score.arms.move(time_s, time_s + max(0.8, farthest / 1.8), relaxed)


def _sway(score: Choreography, seconds: float) -> None:
    """From foot to foot, the trunk with it."""
    rng = score.rng
    apart = score.feet[LEFT].end[:2] - score.feet[RIGHT].end[:2]
    wave = oscillation(seconds * rng.uniform(*_SWAY_HZ))
    end_s = score.time_s + seconds
    aside = 0.5 * rng.uniform(0.2, 0.7) * apart
    score.zmp.add(score.time_s, end_s, aside, wave)
    tilt = [0.0, -rng.uniform(0.0, 0.25), 0.0]
    score.waist.add(score.time_s, end_s, tilt, wave)


def _on_the_spot(score: Choreography, seconds: float) -> None:
    """Sway, twist, lean and squat a little; stand upright in the end."""
    rng, upright = score.rng, float(score.height.end[0])
    end_s = score.time_s + seconds
    while score.time_s < end_s:
        phrase_s = rng.uniform(1.0, 2.5)
        until_s = score.time_s + phrase_s
        kind = rng.integers(6)
        if kind == 0:
            _sway(score, 2.0 * phrase_s)
            score.hold(phrase_s)
        elif kind == 1:
            side, share = int(rng.integers(2)), rng.uniform(0.2, 0.8)
            score.shift_weight(side, share, phrase_s)
            continue
        elif kind == 2:
            twist = [rng.uniform(-0.6, 0.6), rng.uniform(-0.25, 0.25)]
            score.waist.move(score.time_s, until_s, [*twist, score.waist.end[2]])
        elif kind == 3:
            score.lean(rng.uniform(-0.05, 0.4), score.time_s, until_s)
        elif kind == 4:
            score.change_height(rng.uniform(0.6, upright), phrase_s)
        score.hold(phrase_s)
    score.lean(0.0, score.time_s, score.time_s + 1.2)
    score.waist.move(score.time_s, score.time_s + 1.2, [0.0, 0.0, score.waist.end[2]])
    score.change_height(upright, 1.2)
    score.settle(1.4)


_ON_FOOT = (
    locomotion.forward, locomotion.backward, locomotion.stepside, locomotion.turn,
    locomotion.wander,
)  # fmt: skip


def _compose(rng: np.random.Generator) -> Choreography:
    score = start(rng)
    start_s = score.time_s
    if rng.uniform() < _LOCOMOTION_SHARE:
        score.arm_swing = 0.0
        _ON_FOOT[int(rng.integers(len(_ON_FOOT)))](score)
    else:
        _on_the_spot(score, rng.uniform(8.0, 14.0))
    _roam(score, start_s, score.time_s)
    score.hold(1.0)
    finish(score)
    return score


def free_hands_set(seed: int, count: int) -> list[Clip]:
    """``count`` clips of category ``reach``, 50 Hz; equal seeds give equal ones."""
    clips = []
    for number in range(count):
        rng = np.random.default_rng([seed, number, 1])
        name = f"synthetic/free_hands_{number:02d}"
        info = ClipInfo(name, "reach", "openclone free hands", LICENCE, FPS)
        clips.append(solved(info, lambda rng=rng: _compose(rng), _LONGEST_S))
    return clips
