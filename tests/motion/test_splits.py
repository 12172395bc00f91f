"""Splits: takes of one performance never part."""

from __future__ import annotations

from collections import defaultdict

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from openclone.motion.splits import DEV, TRAIN, Take, assign, performance_of, settle


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("accad/Female1_B02_WalkToStand", "accad/Female1_B02_WalkToStandT2"),
        ("accad/Female1_B21_PutDownBoxToWalk", "accad/Female1_B21_S2_PutDownBoxToWalk"),
        ("accad/Female1_A06_LiftBox", "accad/Female1_A06_LiftBoxT2"),
        ("cmu/box-1", "cmu/box-3"),
        ("cmu/basketball_signal_1", "cmu/basketball_signal_4"),
        ("cmu/test_walking_1", "cmu/walking_5"),
        ("hdm05/HDM_bd_squat1Reps_001_120", "hdm05/HDM_bd_squat1Reps_004_120"),
        ("amass/01/01_01_poses", "amass/01/01_07_poses"),
        ("cmu/walking_1", "cmu/walking_1~mirror"),
    ],
)
def test_takes_of_one_performance(one: str, other: str) -> None:
    assert performance_of(one) == performance_of(other)


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("hdm05/HDM_bd_squat1Reps_001_120", "hdm05/HDM_bk_squat1Reps_013_120"),
        ("accad/Female1_B09_WalkTurnLeft90", "accad/Female1_B11_WalkTurnLeft135"),
        ("cmu/walking_1", "cmu/jumping_1"),
        ("a/walk_1", "b/walk_1"),
    ],
)
def test_different_performances(one: str, other: str) -> None:
    assert performance_of(one) != performance_of(other)


def takes(count: int) -> list[Take]:
    """``count`` performances of three takes in two categories."""
    return [
        Take(f"p{k}_{n}", f"p{k}", "walk" if k % 2 else "jump", 1.0 + k % 5)
        for k in range(count)
        for n in range(3)
    ]


@settings(max_examples=40, deadline=None)
@given(
    st.lists(
        st.tuples(
            st.integers(0, 8),
            st.sampled_from(("walk", "jump", "turn")),
            st.floats(0.5, 60),
            st.sampled_from(("", "train", "dev")),
        ),
        min_size=1,
        max_size=30,
    ),
    st.integers(0, 5),
    st.floats(0, 0.5),
)
def test_performances_never_part(
    rows: list[tuple[int, str, float, str]], seed: int, share: float
) -> None:
    items = [
        Take(f"n{k}", f"p{group}", category, seconds, split)
        for k, (group, category, seconds, split) in enumerate(rows)
    ]
    kept, moved = settle(items, seed, share)
    for take in items:
        if take.split == DEV:
            assert kept[take.name] == DEV
        assert (
            kept[take.name] == take.split
            or not take.split
            or take.name in {item.name for item in moved}
        )
    for sides in (assign(items, seed, share), kept):
        assert set(sides) == {take.name for take in items}
        found = defaultdict(set)
        for take in items:
            found[take.performance].add(sides[take.name])
        assert all(len(splits) == 1 for splits in found.values())


def test_each_category_is_on_both_sides() -> None:
    items = takes(12)
    sides = assign(items, seed=0, dev_share=0.2)
    for category in ("walk", "jump"):
        seconds = {TRAIN: 0.0, DEV: 0.0}
        for take in items:
            if take.category == category:
                seconds[sides[take.name]] += take.seconds
        assert 0.05 < seconds[DEV] / sum(seconds.values()) < 0.35


def test_one_performance_stays_in_training() -> None:
    items = [Take(f"only_{n}", "only", "wave", 3.0) for n in range(4)]
    assert set(assign(items, 0, 0.3).values()) == {TRAIN}
    assert set(assign(takes(6), 0, 0.0).values()) == {TRAIN}


def test_the_seed_decides_and_nothing_else() -> None:
    items = takes(20)
    assert assign(items, 3, 0.2) == assign(items[::-1], 3, 0.2)
    assert assign(items, 3, 0.2) != assign(items, 4, 0.2)


def test_what_is_held_out_never_gets_into_training() -> None:
    items = [
        Take("a1", "a", "walk", 5.0, "train"),
        Take("a2", "a", "walk", 2.0, "dev"),
        Take("b1", "b", "walk", 2.0, "test"),
        Take("c1", "c", "walk", 9.0, "train"),
        Take("c2", "c", "walk", 9.0),
    ]
    sides, moved = settle(items, 0, 0.5)
    assert sides == {"a1": DEV, "a2": DEV, "b1": "test", "c1": TRAIN, "c2": TRAIN}
    assert [(item.name, item.given, item.split) for item in moved] == [
        ("a1", "train", "dev")
    ]
    assert "a1 is in dev, not in train" in str(moved[0])


def test_motions_without_a_split_are_drawn() -> None:
    free = takes(20)
    given = [Take("given", "given", "walk", 100.0, "train")]
    sides, moved = settle([*free, *given], 0, 0.2)
    assert sides == {**assign(free, 0, 0.2), "given": "train"}
    assert not moved
