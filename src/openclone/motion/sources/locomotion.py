"""Clips of locomotion: forward, backward, sideways, turning, crouched, and wandering.

Speeds, directions, rates of turn and manners are drawn for every clip. All of them
may be combined, as an operator combines them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from openclone.motion.sources import gestures
from openclone.motion.sources.choreography import Choreography, Gait
from openclone.motion.sources.walking import (
    Velocity,
    draw_gait,
    eased,
    pelvis_height,
    stroll,
    walk,
)

MAX_FORWARD = 1.0
MAX_BACKWARD = 0.6
MAX_SIDEWAYS = 0.2
MAX_TURN = 1.6
"""m/s, m/s, m/s and rad/s that the walks reach."""


def _sign(rng: np.random.Generator) -> float:
    return float(rng.choice([-1.0, 1.0]))


def _sometimes(rng: np.random.Generator, chance: float, limit: float) -> float:
    """A value within ``limit`` with this ``chance``, else zero."""
    value = _sign(rng) * rng.uniform(0.3 * limit, limit)
    return value if rng.uniform() < chance else 0.0


def _narrow(score: Choreography) -> None:
    """Walk with the feet closer: wide steps would tilt the ankles to their limits."""
    score.width = min(score.width, score.rng.uniform(0.17, 0.21))


def _walk_at(score: Choreography, velocity: Velocity) -> None:
    """Walk 2.5 to 6 seconds at ``velocity``, with steps that are a little unequal.

    A third of the walks carries something or points somewhere with the arms; a fifth
    goes with bent knees, so that the head's height says nothing about the speed.
    """
    rng = score.rng
    velocity = velocity.scaled(score.pace)
    if velocity.sideways or velocity.turn:
        _narrow(score)
    gait = draw_gait(rng, velocity)
    gaits = [gait] * max(round(rng.uniform(2.5, 6.0) / gait.step_s), 4)
    height = pelvis_height(rng, gait)
    if rng.uniform() < 0.2:
        height -= rng.uniform(0.02, 0.07)
    with gestures.busy_arms(score, 0.35):
        stroll(score, _uneven(rng, gaits), height)


def _uneven(rng: np.random.Generator, gaits: list[Gait]) -> list[Gait]:
    """Steps that differ by a few percent, as a person's do."""
    factors = 1.0 + 0.05 * rng.uniform(-1.0, 1.0, (len(gaits), 3))
    return [
        replace(gait, forward=a * gait.forward, sideways=b * gait.sideways,
                turn=c * gait.turn)
        for gait, (a, b, c) in zip(gaits, factors, strict=True)
    ]  # fmt: skip


def forward(score: Choreography) -> None:
    """Walk ahead, straight or nearly so."""
    rng = score.rng
    speed = rng.uniform(0.2, MAX_FORWARD)
    score.lean(0.08 * speed, score.time_s, score.time_s + 0.8)
    _walk_at(score, Velocity(speed, turn=_sometimes(rng, 0.3, 0.2)))


def backward(score: Choreography) -> None:
    """Walk back, often with a turn or a drift to one side."""
    rng = score.rng
    speed = rng.uniform(0.15, MAX_BACKWARD)
    side = _sometimes(rng, 0.25, 0.1)
    _walk_at(score, Velocity(-speed, side, _sometimes(rng, 0.45, 0.6)))


def stepside(score: Choreography) -> None:
    """Step to one side, at times obliquely or with a turn."""
    rng = score.rng
    velocity = Velocity(
        _sometimes(rng, 0.3, 0.25),
        _sign(rng) * rng.uniform(0.08, MAX_SIDEWAYS),
        _sometimes(rng, 0.3, 0.4),
    )
    _walk_at(score, velocity)


def turn(score: Choreography) -> None:
    """Turn on the spot, or walk an arc ahead or back."""
    rng = score.rng
    spin = _sign(rng) * rng.uniform(0.4, MAX_TURN)
    if rng.uniform() < 0.5:
        velocity = Velocity(turn=spin)
    else:
        back = rng.uniform() < 0.3
        ahead = -rng.uniform(0.15, 0.4) if back else rng.uniform(0.2, 0.7)
        velocity = Velocity(ahead, turn=0.65 * spin)
    _walk_at(score, velocity)


def crouchwalk(score: Choreography) -> None:
    """Sink, lean, walk low, and rise again."""
    rng = score.rng
    upright = float(score.height.end[0])
    low, lean = rng.uniform(0.6, 0.67), rng.uniform(0.45, 0.65)
    score.change_height(low, 1.2)
    score.lean(lean, score.time_s, score.time_s + 1.2)
    before = score.arms.end.copy()
    arms = gestures.hang_leaning(before, lean)
    score.arms.move(score.time_s, score.time_s + 1.2, arms)
    score.hold(1.0)
    back = rng.uniform() < 0.2
    speed = -rng.uniform(0.1, 0.2) if back else rng.uniform(0.12, 0.4)
    velocity = Velocity(speed, turn=_sometimes(rng, 0.3, 0.4)).scaled(score.pace)
    gait = draw_gait(rng, velocity)
    gait = replace(gait, heel=rng.uniform(0.3, 0.5), toe_off=0.0, strike=0.0)
    steps = max(round(rng.uniform(2.5, 5.0) / gait.step_s), 4)
    walk(score, eased([gait] * steps))
    score.change_height(upright, 1.3)
    score.lean(0.0, score.time_s, score.time_s + 1.3)
    score.arms.move(score.time_s, score.time_s + 1.3, before)
    score.hold(1.3)


def wander(score: Choreography) -> None:
    """Walk without a stop while speed, direction and turning change three times."""
    rng = score.rng
    _narrow(score)
    gaits: list[Gait] = []
    step_s = rng.uniform(0.45, 0.6)
    for _ in range(int(rng.integers(3, 5))):
        ahead = rng.uniform(-0.4, 0.7)
        velocity = Velocity(
            ahead, _sometimes(rng, 0.3, 0.15), _sometimes(rng, 0.6, 0.9)
        )
        gait = draw_gait(rng, velocity.scaled(score.pace))
        share = step_s / gait.step_s
        gait = replace(gait, step_s=step_s, shift_s=share * gait.shift_s)
        gaits += [gait] * int(rng.integers(3, 6))
    lowest = min(pelvis_height(rng, gait) for gait in gaits)
    with gestures.busy_arms(score, 0.35):
        stroll(score, _uneven(rng, gaits), lowest)
