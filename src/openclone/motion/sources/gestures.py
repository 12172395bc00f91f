"""What the arms do: hanging, waving, punching, reaching."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache

import numpy as np

from openclone.motion.sources.choreography import Choreography
from openclone.motion.sources.serial_chain import SerialChain
from openclone.motion.sources.track import oscillation
from openclone.motion.sources.whole_body import g1_model
from openclone.robot import g1

_MIRROR = np.array([1.0, -1.0, -1.0, 1.0, -1.0, 1.0, -1.0])
"""Signs that turn left arm angles into right arm angles (roll and yaw flip)."""
_GUARD = np.array([-0.5, 0.15, 0.1, -0.55, 0.0, 0.0, 0.0])


def arm_columns(side: int) -> slice:
    """Columns of one arm among the 14 arm joints."""
    return slice(7 * side, 7 * side + 7)


def mirrored(arm: np.ndarray, side: int) -> np.ndarray:
    """``arm (7,)`` given for the left, for the arm of ``side``."""
    return arm if side == 0 else arm * _MIRROR


def hanging_arm(rng: np.random.Generator) -> np.ndarray:
    """(7,) a relaxed left arm: upper arm down, elbow a little bent."""
    return np.array(
        [
            rng.uniform(0.0, 0.3),
            rng.uniform(0.18, 0.35),
            rng.uniform(-0.15, 0.15),
            rng.triangular(0.3, 1.0, 1.25),
            rng.uniform(-0.3, 0.3),
            rng.uniform(-0.15, 0.15),
            rng.uniform(-0.15, 0.15),
        ]
    )


def hanging_arms(rng: np.random.Generator) -> np.ndarray:
    """(14,) both arms relaxed, nearly but not quite alike."""
    left = hanging_arm(rng)
    right = left + 0.15 * (hanging_arm(rng) - left)
    return np.concatenate((left, mirrored(right, 1)))


def hang_leaning(arms: np.ndarray, lean: float) -> np.ndarray:
    """``arms (14,)`` when the trunk leans forward: gravity keeps them hanging."""
    hanging = arms.copy()
    hanging[[0, 7]] -= lean
    return hanging


def move_arm(
    score: Choreography, side: int, arm: np.ndarray, start_s: float, end_s: float
) -> None:
    """Move one arm to ``arm (7,)`` (angles of that very side)."""
    target = score.arms.end.copy()
    target[arm_columns(side)] = arm
    score.arms.move(start_s, end_s, target)


def wave(score: Choreography, side: int, start_s: float, seconds: float) -> None:
    """Raise one hand beside the head, wave, and lower it again."""
    rng = score.rng
    before = score.arms.end[arm_columns(side)].copy()
    raised = np.array(
        [
            rng.uniform(-0.5, 0.0),
            rng.uniform(0.9, 1.4),
            rng.uniform(1.0, 1.5),
            rng.uniform(-0.4, 0.1),
            rng.uniform(-0.3, 0.3),
            0.0,
            0.0,
        ]
    )
    up_s = rng.uniform(0.8, 1.1)
    end_s = start_s + seconds
    move_arm(score, side, mirrored(raised, side), start_s, start_s + up_s)
    swing = np.zeros(14)
    swing[7 * side + 3] = rng.uniform(0.25, 0.45)
    swing[7 * side + 6] = rng.uniform(0.0, 0.2)
    cycles = (seconds - 2 * up_s + 0.4) * rng.uniform(0.9, 1.6)
    score.arms.add(start_s + up_s - 0.2, end_s - up_s + 0.2, swing, oscillation(cycles))
    move_arm(score, side, before, end_s - up_s, end_s)


def working_arms(rng: np.random.Generator, relaxed: np.ndarray) -> np.ndarray:
    """(14,) one hand or both hold or point at something; the rest is ``relaxed``."""
    arms = relaxed.copy()
    sides = [0, 1] if rng.uniform() < 0.5 else [int(rng.integers(2))]
    for side in sides:
        if rng.uniform() < 0.5:
            arm = reaching_arm(side, random_reach(rng, side))
        else:
            # The upper arm hangs; the bent forearm carries. The elbow is straight at
            # 1.6 rad or so: this hinge is bent by smaller angles.
            carried = [rng.uniform(-0.4, 0.1), rng.uniform(0.15, 0.4), 0.0]
            carried += [rng.uniform(-0.3, 0.4), rng.uniform(-0.5, 0.5), 0.0, 0.0]
            arm = mirrored(np.array(carried), side)
        arms[arm_columns(side)] = arm
    return arms


@contextmanager
def busy_arms(score: Choreography, chance: float) -> Iterator[None]:
    """With this ``chance`` the arms work while what is inside goes on.

    Halfway through they may change to another task; in the end they relax.
    """
    rng = score.rng
    if rng.uniform() >= chance:
        yield
        return
    relaxed, start_s = score.arms.end.copy(), score.time_s
    score.arm_swing *= rng.uniform(0.0, 0.6)
    yield
    end_s = score.time_s
    ready_s = rng.uniform(0.7, 1.2)
    score.arms.move(start_s, start_s + ready_s, working_arms(rng, relaxed))
    if rng.uniform() < 0.5:
        middle_s = rng.uniform(start_s + ready_s, end_s - 1.6)
        score.arms.move(middle_s, middle_s + 0.9, working_arms(rng, relaxed))
    score.arms.move(end_s - 0.8, end_s + 0.2, relaxed)


def raise_guard(score: Choreography, seconds: float) -> None:
    """Bring both fists in front of the chest."""
    for side in range(2):
        arm = mirrored(_GUARD, side)
        move_arm(score, side, arm, score.time_s, score.time_s + seconds)


def punch(score: Choreography, side: int, start_s: float) -> float:
    """Thrust one fist forward and take it back; returns the seconds it takes."""
    rng = score.rng
    out_s, back_s = rng.uniform(0.28, 0.4), rng.uniform(0.4, 0.6)
    sign = 1.0 if side == 0 else -1.0
    straight = np.array([-1.35, 0.05, 0.0, 1.35, 0.0, 0.0, 0.0])
    straight[0] += rng.uniform(-0.3, 0.3)
    straight[1] += rng.uniform(-0.1, 0.15)
    before = score.arms.end[arm_columns(side)].copy()
    move_arm(score, side, mirrored(straight, side), start_s, start_s + out_s)
    middle = start_s + out_s
    move_arm(score, side, before, middle, middle + back_s)
    twist = np.array([-sign * rng.uniform(0.15, 0.4), 0.0, 0.0])
    score.waist.bump(start_s - 0.05, middle + back_s, twist)
    return out_s + back_s


@cache
def _arms() -> tuple[SerialChain, SerialChain]:
    model = g1_model()
    return (
        SerialChain.of(model, "torso_link", "left_wrist_yaw_link", g1.HAND_OFFSET),
        SerialChain.of(model, "torso_link", "right_wrist_yaw_link", g1.HAND_OFFSET),
    )


def reaching_arm(side: int, point: np.ndarray) -> np.ndarray:
    """(7,) angles that bring a hand to ``point (3,)``, metres, torso frame."""
    rest = mirrored(np.array([-0.4, 0.25, 0.0, 0.5, 0.0, 0.0, 0.0]), side)
    return _arms()[side].reach_point(point, rest)


def random_reach(rng: np.random.Generator, side: int) -> np.ndarray:
    """(3,) a comfortable point for one hand, metres, torso frame."""
    sign = 1.0 if side == 0 else -1.0
    return np.array(
        [
            rng.uniform(0.22, 0.42),
            sign * rng.uniform(-0.05, 0.35),
            rng.uniform(-0.05, 0.45),
        ]
    )
