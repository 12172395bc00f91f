"""The project's own motions: G1 clips made from a seed, for every category.

The clips need no recording and no retargeting. Feet neither slide nor sink, and the
zero-moment point stays inside the soles, because the motions are planned that way
(`choreography`) and solved for the whole body (`whole_body`).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from openclone.errors import InputError
from openclone.motion.clip import CATEGORIES, Clip, ClipInfo, clip_from_qpos
from openclone.motion.sources import gestures, locomotion
from openclone.motion.sources.choreography import FPS, Choreography
from openclone.motion.sources.elbow_room import (
    LEFT_ROLL,
    RIGHT_ROLL,
    deepest_overlap,
    spread,
)
from openclone.motion.sources.jumping import jump
from openclone.motion.sources.track import oscillation
from openclone.motion.sources.whole_body import Plan, Unreachable, solve
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
_MEAN_CLIP_S = 8.0


def _start(rng: np.random.Generator, **changes: float | bool) -> Choreography:
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


def _finish(score: Choreography) -> None:
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


def _stand(score: Choreography) -> None:
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


def _squat(score: Choreography) -> None:
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


def _jump(score: Choreography) -> None:
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
    jump(
        score,
        rng.uniform(0.04, 0.07),
        rng.uniform(0.13, 0.17),
        rng.choice([0.0, 0.0, 0.1]),
        rng.uniform(0.03, 0.05),
        rng.uniform(0.5, 0.7),
    )


def _wave(score: Choreography) -> None:
    rng = score.rng
    seconds = rng.uniform(3.0, 6.0)
    sides = [0, 1] if rng.uniform() < 0.25 else [int(rng.integers(2))]
    for side in sides:
        gestures.wave(score, side, score.time_s, seconds)
    score.hold(seconds)


def _punch(score: Choreography) -> None:
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


def _reach(score: Choreography) -> None:
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


def _pickup(score: Choreography) -> None:
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


def _transition(score: Choreography) -> None:
    rng = score.rng
    if rng.uniform() < 0.5:
        locomotion.wander(score)
        return
    parts = (
        locomotion.forward, locomotion.turn, locomotion.stepside, _wave, _squat,
        locomotion.backward, _reach,
    )  # fmt: skip
    chosen = rng.choice(len(parts), size=2, replace=False)
    for index in chosen:
        parts[index](score)
        score.hold(rng.uniform(0.2, 0.6))


_CHOREOGRAPHIES: dict[str, Callable[[Choreography], None]] = {
    "stand": _stand, "forward": locomotion.forward, "backward": locomotion.backward,
    "stepside": locomotion.stepside, "turn": locomotion.turn, "squat": _squat,
    "crouchwalk": locomotion.crouchwalk, "jump": _jump, "punch": _punch, "wave": _wave,
    "reach": _reach, "pickup": _pickup, "transition": _transition,
}  # fmt: skip


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


def generate(category: str, rng: np.random.Generator, name: str = "") -> Clip:
    """Make one clip at 50 frames per second.

    Args:
        category: one of `clip.CATEGORIES`.
        rng: source of all chance; equal states give equal clips.
        name: the clip's name; by default ``synthetic/<category>``.

    Raises:
        InputError: there is no such category.
    """
    if category not in _CHOREOGRAPHIES:
        raise InputError(
            f"unknown category {category!r}",
            remedy="use one of " + ", ".join(CATEGORIES),
        )
    info = ClipInfo(
        name or f"synthetic/{category}",
        category,
        "openclone synthetic generator",
        LICENCE,
        FPS,
    )
    while True:
        if category == "jump":
            score = _start(rng, ballistic=True, height=rng.uniform(0.67, 0.68))
        elif category == "crouchwalk":
            score = _start(rng, width=rng.uniform(0.185, 0.21))
        else:
            score = _start(rng)
        _CHOREOGRAPHIES[category](score)
        _finish(score)
        if score.time_s > _LONGEST_S:
            continue
        try:
            qpos = _solve_clear(score.plan())
        except Unreachable:
            continue  # The chosen step is too long for the chosen height: draw again.
        if deepest_overlap(qpos[::2]) < _MAX_OVERLAP:
            return clip_from_qpos(info, qpos)


def default_set(seed: int, minutes: float = 10.0) -> list[Clip]:
    """About ``minutes`` of motion of all categories, the same for the same seed."""
    total = sum(_SHARES.values())
    clips = []
    for index, category in enumerate(CATEGORIES):
        share = minutes * 60.0 / _MEAN_CLIP_S * _SHARES[category] / total
        for number in range(max(1, round(share))):
            rng = np.random.default_rng([seed, index, number])
            clips.append(generate(category, rng, f"synthetic/{category}_{number:02d}"))
    return clips
