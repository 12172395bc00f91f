"""Walking in any direction, at any rate of turn: gaits from velocities, and walks.

A walk is a list of gaits, one per step, so speed and direction may change under way.
The steps follow from the wanted velocity as in walking robots and people: faster
means longer and quicker steps, less double support and a lower pelvis.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from openclone.motion.sources.choreography import (
    LEFT,
    Choreography,
    Gait,
    rotated,
)

_FIRST_SHIFT_S = 0.5
"""Seconds to bring the weight from both feet onto the first standing foot."""
_STEP_CHANGE = 0.2
_SIDE_CHANGE = 0.12
_TURN_CHANGE = 0.5
"""Metres, metres and radians by which one step differs from the last, at most."""
_WIDEST_SIDE = 0.15
"""Metres per pair of steps; wider ones make the feet meet or the legs split."""


@dataclass(frozen=True)
class Velocity:
    """A wanted velocity in the walker's own frame.

    Attributes:
        forward: m/s, negative backward.
        sideways: m/s, positive to the left.
        turn: rad/s, positive to the left.
    """

    forward: float = 0.0
    sideways: float = 0.0
    turn: float = 0.0

    def scaled(self, share: float) -> Velocity:
        """All three, times ``share``."""
        return Velocity(share * self.forward, share * self.sideways, share * self.turn)


def draw_gait(rng: np.random.Generator, velocity: Velocity) -> Gait:
    """A gait that moves at ``velocity``; cadence and manner are drawn.

    Long steps need the feet to roll, or the ankles reach their limits: forward, the
    rear foot leaves from its toes; backward, the landing foot comes down toes first.
    """
    speed, spin = abs(velocity.forward), abs(velocity.turn)
    hurry = math.hypot(0.22 * speed, 0.12 * spin)
    step_s = float(np.clip(0.62 - hurry + rng.normal(0, 0.025), 0.40, 0.70))
    if abs(velocity.sideways) * 2.0 * step_s > _WIDEST_SIDE:
        step_s = max(_WIDEST_SIDE / (2.0 * abs(velocity.sideways)), 0.4)
    stride = velocity.forward * step_s
    rolls = max(abs(stride) - 0.1, 0.0)
    return Gait(
        forward=stride,
        sideways=velocity.sideways * 2.0 * step_s,
        turn=velocity.turn * 2.0 * step_s,
        lead=rng.uniform(0.5, 0.7),
        step_s=step_s,
        shift_s=step_s * (rng.uniform(0.24, 0.3) - 0.04 * speed),
        clearance=rng.uniform(0.055, 0.07),
        heel=rng.uniform(0.5, 0.9) * abs(stride),
        toe_off=rng.uniform(1.0, 1.6) * rolls if stride > 0 else 0.0,
        strike=rng.uniform(0.2, 0.5) * rolls if stride > 0 else -1.2 * rolls,
        bob=rng.uniform(0.003, 0.01),
    )


def pelvis_height(rng: np.random.Generator, gait: Gait) -> float:
    """Metres above the ground that leave the legs room for the steps of ``gait``."""
    stride = math.hypot(gait.forward, gait.sideways)
    return 0.773 - 0.22 * stride**2 - 0.015 * abs(gait.turn) - rng.uniform(0.0, 0.025)


def _between(low: float, high: float, value: float) -> float:
    return min(max(value, low), high)


def eased(gaits: Sequence[Gait]) -> list[Gait]:
    """``gaits`` with starts, stops and changes spread over several steps."""
    forward, sideways, turn = [0.0], [0.0], [0.0]
    for gait in gaits:
        for values, wish, change in (
            (forward, gait.forward, _STEP_CHANGE),
            (sideways, gait.sideways, _SIDE_CHANGE),
            (turn, gait.turn, _TURN_CHANGE),
        ):
            last = values[-1]
            values.append(_between(last - change, last + change, wish))
    result = []
    for index, gait in enumerate(gaits, 1):
        # The same limit backwards in time, from rest after the last step.
        left = len(gaits) + 1 - index
        limits = (_STEP_CHANGE * left, _SIDE_CHANGE * left, _TURN_CHANGE * left)
        step, side, spin = (
            _between(-limit, limit, values[index])
            for values, limit in zip((forward, sideways, turn), limits, strict=True)
        )
        share = abs(step / gait.forward) if gait.forward else 1.0
        share = min(share, 1.0)
        result.append(
            replace(
                gait,
                forward=step,
                sideways=side,
                turn=spin,
                heel=share * gait.heel,
                toe_off=share * gait.toe_off,
                strike=share * gait.strike,
            )
        )
    return result


def _inner_share(drift: float, side: int, lead: float) -> float:
    """Share of a pair's ``drift`` that the step of ``side`` takes."""
    inner = (drift > 0) == (side == LEFT)
    return lead if inner else 1.0 - lead


def advanced(body: np.ndarray, side: int, gait: Gait) -> np.ndarray:
    """``body (3,)``, x, y, yaw, after one step of ``side``."""
    body = body.copy()
    turn = gait.turn * _inner_share(gait.turn, side, gait.lead)
    drift = gait.sideways * _inner_share(gait.sideways, side, gait.lead)
    body[2] += 0.5 * turn
    body[:2] += rotated((gait.forward, drift), body[2])
    body[2] += 0.5 * turn
    return body


def walk(score: Choreography, gaits: Sequence[Gait], first: int | None = None) -> None:
    """Walk one step per gait and close the feet; at rest before and after.

    Args:
        score: the clip so far.
        gaits: one per step; see `eased`.
        first: the foot that starts; by default the one on the inside.
    """
    drift = gaits[0].sideways if gaits[0].sideways else gaits[0].turn
    if first is None:
        first = int(score.rng.integers(2)) if drift == 0 else int(drift < 0)
    body, side = score.body.copy(), first
    for index, gait in enumerate(gaits):
        body = advanced(body, side, gait)
        score.step(side, body, gait, _FIRST_SHIFT_S if index == 0 else gait.shift_s)
        side = 1 - side
    last = gaits[-1]
    closing = replace(
        last, forward=0.0, sideways=0.0, turn=0.0, toe_off=0.5 * last.toe_off, strike=0
    )
    score.step(side, body, closing, last.shift_s)
    score.body = body
    score.settle()


def stroll(score: Choreography, gaits: Sequence[Gait], height: float) -> None:
    """Sink to walking height, walk ``gaits``, and straighten up again."""
    upright = float(score.height.end[0])
    score.change_height(height, 0.5)
    walk(score, eased(gaits))
    score.time_s -= 0.5
    score.change_height(upright, 0.9)
    score.hold(0.7)
