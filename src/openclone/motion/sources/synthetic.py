"""The project's own motions: G1 clips made from a seed, for every category.

The clips need no recording and no retargeting. Feet neither slide nor sink, and the
zero-moment point stays inside the soles, because the motions are planned that way
(`choreography`) and solved for the whole body (`whole_body`).
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from openclone.errors import InputError
from openclone.motion.clip import CATEGORIES, Clip, ClipInfo, clip_from_qpos
from openclone.motion.sources import actions, gestures, locomotion
from openclone.motion.sources.choreography import FPS, Choreography
from openclone.motion.sources.elbow_room import (
    LEFT_ROLL,
    RIGHT_ROLL,
    deepest_overlap,
    spread,
)
from openclone.motion.sources.track import oscillation
from openclone.motion.sources.whole_body import Plan, Unreachable, solve
from openclone.motion.workers import worker_pool
from openclone.robot import g1

LICENCE = "Apache-2.0, made by OpenClone"
_SHARES = {
    "stand": 1.0, "forward": 1.4, "backward": 1.4, "stepside": 1.1, "turn": 2.2,
    "squat": 1.0, "crouchwalk": 0.8, "jump": 0.5, "punch": 0.8, "wave": 0.8,
    "reach": 0.8, "pickup": 0.8, "transition": 1.6,
}  # fmt: skip
"""How many clips of each category a default set holds, relative to each other."""
_MAX_OVERLAP = 0.005
"""Metres; a motion whose body parts overlap more is drawn anew."""
_SHORTEST_S, _LONGEST_S = 4.2, 12.0
_MEAN_CLIP_S = 8.3


def start(rng: np.random.Generator, **changes: float | bool) -> Choreography:
    """A robot standing quietly in a pose of its own."""
    settings = {
        "width": rng.uniform(0.21, 0.26),
        "height": rng.uniform(0.762, 0.782),
        "toe_out": rng.uniform(0.0, 0.1),
    }
    score = Choreography(
        rng,
        arms=gestures.hanging_arms(rng),
        stagger=float(changes.get("stagger", 0.0)),
        ballistic=bool(changes.get("ballistic", False)),
        **{key: float(changes.get(key, value)) for key, value in settings.items()},
    )
    score.hold(rng.uniform(0.7, 1.2))
    return score


def finish(score: Choreography) -> None:
    """Stand quietly at the end; breathe and sway a little throughout."""
    rng = score.rng
    score.hold(max(rng.uniform(0.8, 1.3), _SHORTEST_S - score.time_s))
    end_s = score.time_s
    for track, scale in ((score.waist, 0.02), (score.arms, 0.03), (score.zmp, 0.004)):
        size = len(track.end)
        for hertz in (0.15, 0.3, 0.5):
            amount = scale * rng.normal(size=size)
            cycles = hertz * end_s * rng.uniform(0.8, 1.2)
            track.add(0.0, end_s, amount, oscillation(cycles))


_CHOREOGRAPHIES: dict[str, Callable[[Choreography], None]] = {
    "stand": actions.stand,
    "forward": locomotion.forward,
    "backward": locomotion.backward,
    "stepside": locomotion.stepside,
    "turn": locomotion.turn,
    "squat": actions.squat,
    "crouchwalk": locomotion.crouchwalk,
    "jump": actions.jump,
    "punch": actions.punch,
    "wave": actions.wave,
    "reach": actions.reach,
    "pickup": actions.pickup,
    "transition": actions.transition,
}


def _solve_clear(plan: Plan) -> np.ndarray:
    """Positions ``(T, 36)`` for ``plan`` with arms that stay out of the body."""
    qpos = solve(plan)
    offset = spread(qpos)
    if not offset.any():
        return qpos
    upper = plan.upper_joints.copy()
    upper[:, LEFT_ROLL - 19] += offset[:, 0]
    upper[:, RIGHT_ROLL - 19] -= offset[:, 1]
    lower, highest = g1.JOINT_LOWER[12:] + 0.05, g1.JOINT_UPPER[12:] - 0.05
    return solve(replace(plan, upper_joints=np.clip(upper, lower, highest)))


def _compose(category: str, rng: np.random.Generator, pace: float) -> Choreography:
    """Write down one motion; it may be too long, or beyond the robot's reach."""
    if category == "jump":
        score = start(rng, ballistic=True, height=rng.uniform(0.67, 0.68))
    elif category == "crouchwalk":
        score = start(rng, width=rng.uniform(0.185, 0.21))
    else:
        score = start(rng)
    score.pace = pace
    _CHOREOGRAPHIES[category](score)
    finish(score)
    return score


def generate(
    category: str, rng: np.random.Generator, name: str = "", *, pace: float = 1.0
) -> Clip:
    """Make one clip at 50 frames per second.

    Args:
        category: one of `clip.CATEGORIES`.
        rng: source of all chance; equal states give equal clips.
        name: the clip's name; by default ``synthetic/<category>``.
        pace: scales the speeds of walking and turning; 0.5 halves them.

    Raises:
        InputError: there is no such category, or the pace is not within (0, 1].
    """
    if category not in _CHOREOGRAPHIES:
        raise InputError(
            f"unknown category {category!r}",
            remedy="use one of " + ", ".join(CATEGORIES),
        )
    if not 0.0 < pace <= 1.0:
        raise InputError(f"the pace is {pace:g}", remedy="give 0.1 to 1")
    info = ClipInfo(
        name or f"synthetic/{category}",
        category,
        "openclone synthetic generator",
        LICENCE,
        FPS,
    )
    return solved(info, lambda: _compose(category, rng, pace))


def solved(
    info: ClipInfo,
    compose: Callable[[], Choreography],
    longest_s: float = _LONGEST_S,
) -> Clip:
    """The first of the scores that ``compose`` writes which the robot can play."""
    while True:
        score = compose()
        if score.time_s > longest_s:
            continue
        try:
            qpos = _solve_clear(score.plan())
        except Unreachable:
            continue  # The chosen step is too long for the chosen height: draw again.
        if deepest_overlap(qpos[::2]) < _MAX_OVERLAP:
            return clip_from_qpos(info, qpos)


@dataclass(frozen=True)
class _Order:
    """One clip of a set: what it is made from, and nothing else."""

    seed: int
    category: str
    number: int


def _make(order: _Order) -> Clip:
    index = list(_SHARES).index(order.category)
    rng = np.random.default_rng([order.seed, index, order.number])
    name = f"synthetic/{order.category}_{order.number:02d}"
    return generate(order.category, rng, name)


def _make_all(orders: list[_Order], workers: int) -> Iterator[Clip]:
    """The clips of ``orders`` in their order, whatever the number of processes."""
    if workers == 1:
        yield from map(_make, orders)
        return
    with worker_pool(workers) as pool:
        yield from pool.map(_make, orders, chunksize=2)


def _counts(minutes: float) -> dict[str, int]:
    """How many clips of each category make about ``minutes``."""
    total = sum(_SHARES.values())
    clips = minutes * 60.0 / _MEAN_CLIP_S
    return {name: max(1, round(clips * _SHARES[name] / total)) for name in CATEGORIES}


def default_set(
    seed: int,
    minutes: float = 30.0,
    *,
    workers: int = 1,
    progress: Callable[[float], None] | None = None,
) -> list[Clip]:
    """At least ``minutes`` of motion of all categories, no clip like another.

    The result depends on ``seed`` and ``minutes`` alone, not on ``workers``: every
    clip has a random generator of its own.

    Args:
        seed: equal seeds give equal motions.
        minutes: least length of all motions together.
        workers: processes that share the work; with more than one, the calling script
            must be importable (``if __name__ == "__main__"``).
        progress: receives the minutes made so far.
    """
    counts = _counts(minutes)
    orders = [
        _Order(seed, name, number)
        for name, count in counts.items()
        for number in range(count)
    ]
    clips: list[Clip] = []
    made_s = 0.0
    for extra in itertools.count():
        for clip in _make_all(orders, workers):
            clips.append(clip)
            made_s += clip.seconds
            if progress is not None:
                progress(made_s / 60.0)
        if made_s >= 60.0 * minutes:
            return clips
        orders = [_Order(seed, name, counts[name] + extra) for name in CATEGORIES]
    raise AssertionError("unreachable")
