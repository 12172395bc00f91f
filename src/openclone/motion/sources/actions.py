"""Clips of what is done on the spot: stand, squat, jump, punch, wave, reach, pick up.

And transitions, which string several things together.
"""

from __future__ import annotations

import numpy as np

from openclone.motion.sources import gestures, locomotion
from openclone.motion.sources.choreography import Choreography
from openclone.motion.sources.jumping import jump as leap


def stand(score: Choreography) -> None:
    """Stand, shift the weight, twist, lean and move the arms."""
    rng = score.rng
    for _ in range(int(rng.integers(1, 4))):
        kind = rng.integers(4)
        seconds = rng.uniform(1.2, 2.0)
        start_s = score.time_s
        if kind == 0:
            score.shift_weight(int(rng.integers(2)), rng.uniform(0.2, 0.7), seconds)
        elif kind == 1:
            score.arms.move(start_s, start_s + seconds, gestures.hanging_arms(rng))
        elif kind == 2:
            twist = [rng.uniform(-0.5, 0.5), rng.uniform(-0.1, 0.1), 0.0]
            score.waist.bump(start_s, start_s + 2 * seconds, twist)
            score.hold(seconds)
        else:
            score.lean(rng.uniform(-0.05, 0.25), start_s, start_s + seconds)
        score.hold(seconds)
    score.lean(0.0, score.time_s, score.time_s + 1.0)
    score.settle(1.0)


def squat(score: Choreography) -> None:
    """Squat once or twice, with the arms hanging or stretched forward."""
    rng = score.rng
    upright = float(score.height.end[0])
    for _ in range(int(rng.integers(1, 3))):
        low = rng.uniform(0.33, 0.6)
        seconds = rng.uniform(1.1, 2.0)
        start_s = score.time_s
        _crouch(score, low, seconds)
        before = score.arms.end.copy()
        if rng.uniform() < 0.5:
            arm = np.array([-rng.uniform(0.6, 1.3), 0.15, 0.0, 1.0, 0.0, 0.0, 0.0])
            arms = np.concatenate((arm, gestures.mirrored(arm, 1)))
        else:
            arms = gestures.hang_leaning(before, 2.0 * score.trunk.end[1])
        score.arms.move(start_s, start_s + seconds, arms)
        score.hold(seconds + rng.uniform(0.1, 0.8))
        score.arms.move(score.time_s, score.time_s + seconds, before)
        _crouch(score, upright, seconds)
        score.hold(seconds)


def _crouch(score: Choreography, height: float, seconds: float) -> None:
    """Go to a pelvis height with the trunk bent as far as balance asks."""
    depth = np.clip((0.74 - height) / 0.44, 0.0, 1.0)
    score.change_height(height, seconds)
    score.lean(0.75 * float(depth) ** 0.6, score.time_s, score.time_s + seconds)


def jump(score: Choreography) -> None:
    """Jump once or twice."""
    rng = score.rng
    for _ in range(int(rng.integers(1, 3))):
        _jump_once(score)
        score.hold(rng.uniform(0.4, 0.8))


def _jump_once(score: Choreography) -> None:
    rng = score.rng
    before = score.arms.end.copy()
    back = np.zeros(14)
    back[[0, 7]] = rng.uniform(0.3, 0.6)
    start_s = score.time_s
    score.arms.move(start_s, start_s + 0.6, before + back)
    score.arms.move(start_s + 0.6, start_s + 1.0, before - 1.5 * back)
    score.arms.move(start_s + 1.1, start_s + 1.9, before)
    leap(
        score,
        rng.uniform(0.04, 0.07),
        rng.uniform(0.13, 0.17),
        rng.choice([0.0, 0.0, 0.1]),
        rng.uniform(0.03, 0.05),
        rng.uniform(0.5, 0.7),
    )


def wave(score: Choreography) -> None:
    """Wave with one hand, at times with both."""
    rng = score.rng
    seconds = rng.uniform(3.0, 6.0)
    sides = [0, 1] if rng.uniform() < 0.25 else [int(rng.integers(2))]
    for side in sides:
        gestures.wave(score, side, score.time_s, seconds)
    score.hold(seconds)


def punch(score: Choreography) -> None:
    """Raise the guard and punch."""
    rng = score.rng
    relaxed = score.arms.end.copy()
    gestures.raise_guard(score, 0.8)
    score.change_height(rng.uniform(0.69, 0.74), 0.8)
    score.hold(0.9)
    side = int(rng.integers(2))
    for _ in range(int(rng.integers(2, 7))):
        score.hold(gestures.punch(score, side, score.time_s) + rng.uniform(0.1, 0.5))
        side = 1 - side if rng.uniform() < 0.7 else side
    score.arms.move(score.time_s, score.time_s + 0.9, relaxed)
    score.hold(0.9)


def reach(score: Choreography) -> None:
    """Reach for one to three points with one hand or both."""
    rng = score.rng
    for _ in range(int(rng.integers(1, 4))):
        sides = [0, 1] if rng.uniform() < 0.4 else [int(rng.integers(2))]
        seconds = rng.uniform(0.8, 1.5)
        start_s = score.time_s
        before = score.arms.end.copy()
        for side in sides:
            arm = gestures.reaching_arm(side, gestures.random_reach(rng, side))
            gestures.move_arm(score, side, arm, start_s, start_s + seconds)
        score.lean(rng.uniform(0.0, 0.3), start_s, start_s + seconds)
        score.hold(seconds + rng.uniform(0.2, 0.9))
        score.arms.move(score.time_s, score.time_s + seconds, before)
        score.lean(0.0, score.time_s, score.time_s + seconds)
        score.hold(seconds)


def pickup(score: Choreography) -> None:
    """Squat down, grasp something, and carry it up."""
    rng = score.rng
    upright, before = float(score.height.end[0]), score.arms.end.copy()
    low, seconds = rng.uniform(0.32, 0.5), rng.uniform(1.3, 2.0)
    start_s = score.time_s
    _crouch(score, low, seconds)
    sides = [0, 1] if rng.uniform() < 0.6 else [int(rng.integers(2))]
    for side in sides:
        sign = 1.0 if side == 0 else -1.0
        point = np.array([rng.uniform(0.2, 0.3), sign * rng.uniform(0.24, 0.32), -0.1])
        arm = gestures.reaching_arm(side, point)
        gestures.move_arm(score, side, arm, start_s + 0.2, start_s + seconds)
    score.hold(seconds + rng.uniform(0.3, 0.8))
    carry = np.array([-0.2, 0.2, 0.0, rng.uniform(0.0, 0.5), 0.0, 0.0, 0.0])
    for side in sides:
        arm = gestures.mirrored(carry, side)
        gestures.move_arm(score, side, arm, score.time_s, score.time_s + seconds)
    _crouch(score, upright, seconds)
    score.hold(seconds + rng.uniform(0.3, 0.8))
    score.arms.move(score.time_s, score.time_s + 1.0, before)
    score.hold(1.0)


def transition(score: Choreography) -> None:
    """Two things in a row, or a walk whose direction changes."""
    rng = score.rng
    if rng.uniform() < 0.5:
        locomotion.wander(score)
        return
    parts = (
        locomotion.forward, locomotion.turn, locomotion.stepside, wave, squat,
        locomotion.backward, reach, pickup, punch, locomotion.crouchwalk,
    )  # fmt: skip
    chosen = rng.choice(len(parts), size=2, replace=False)
    for index in chosen:
        parts[index](score)
        score.hold(rng.uniform(0.2, 0.6))
