"""Jumping: push-off, ballistic flight and landing of the centre of mass."""

from __future__ import annotations

import math

import numpy as np

from openclone.motion.sources.choreography import FPS, LEFT, RIGHT, Choreography
from openclone.motion.sources.whole_body import GRAVITY


def jump(
    score: Choreography,
    rise: float,
    crouch: float,
    forward: float,
    tuck: float,
    lean: float,
) -> None:
    """Crouch, push off with both feet, fly, land and stand up.

    Args:
        score: the clip so far.
        rise: metres that the centre of mass flies up.
        crouch: metres that it sinks before.
        forward: metres between take-off and landing.
        tuck: metres that the feet rise.
        lean: radians that the trunk leans forward when crouching.
    """
    top = float(score.height.end[0])
    speed = math.sqrt(2.0 * GRAVITY * rise)
    flight_s = round(2.0 * speed / GRAVITY * FPS) / FPS
    speed = 0.5 * GRAVITY * flight_s
    push = crouch - 0.02
    push_s = round(2.2 * push / speed * FPS) / FPS
    sink_s, rest_s = 0.6, 0.9
    score.height.move(score.time_s, score.time_s + sink_s, top - crouch)
    score.lean(lean, score.time_s, score.time_s + sink_s)
    score.time_s += sink_s
    off = score.time_s + push_s
    land = off + flight_s
    leave = _push_off(push, speed, push_s)
    score.height.add(
        score.time_s, land + push_s, 1.0,
        lambda phase: _jump_height(
            phase * (2 * push_s + flight_s), leave, push_s, flight_s
        ),
    )  # fmt: skip
    score.lift.bump(off, land, tuck)
    score.lean(0.3 * lean, score.time_s, off)
    score.lean(lean, land, land + push_s)
    score.body[0] += forward
    for side in (LEFT, RIGHT):
        target = score.feet[side].end + np.array([forward, 0.0, 0.0])
        swing = 0.12 * flight_s
        score.feet[side].move(off + swing, land - swing, target)
    score.zmp.move(off, land, score.between())
    score.time_s = land + push_s
    score.height.move(score.time_s, score.time_s + rest_s, top)
    score.lean(0.0, score.time_s, score.time_s + rest_s)
    score.time_s += rest_s


def _push_off(distance: float, speed: float, seconds: float) -> np.ndarray:
    """Quintic coefficients (6,), highest power first, of the push-off.

    From rest without acceleration to ``speed`` at ``distance``, where the ground's
    force has gone to zero (acceleration -g).
    """
    powers = np.arange(6)
    end = seconds**powers
    speed_row = np.concatenate(([0.0], powers[1:] * seconds ** (powers[1:] - 1)))
    accel_row = np.concatenate(
        ([0.0, 0.0], powers[2:] * (powers[2:] - 1) * seconds ** (powers[2:] - 2))
    )
    rows = [np.eye(6)[0], np.eye(6)[1], np.eye(6)[2], end, speed_row, accel_row]
    ends = np.array([0, 0, 0, distance, speed, -GRAVITY])
    return np.linalg.solve(np.array(rows), ends)[::-1]


def _jump_height(
    time_s: np.ndarray, leave: np.ndarray, push_s: float, flight_s: float
) -> np.ndarray:
    """Height above the crouch: push-off, parabola, and the push-off backwards."""
    total = 2.0 * push_s + flight_s
    mirrored = np.minimum(time_s, total - time_s)
    push = np.polyval(leave, np.clip(mirrored, 0.0, push_s))
    airborne = np.clip(mirrored - push_s, 0.0, None)
    return push + 0.5 * GRAVITY * airborne * (flight_s - airborne)
