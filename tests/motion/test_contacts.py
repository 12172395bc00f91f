"""Contact detection against feet whose steps are known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from openclone.motion.contacts import (
    foot_contacts,
    ground_level,
    level_ground,
    runs,
    smooth,
)
from openclone.motion.skeleton import JOINTS, HumanMotion

Human = Callable[..., HumanMotion]
FOOT = {
    side: [JOINTS.index(f"{side}_{part}") for part in ("ankle", "toe")]
    for side in ("left", "right")
}


def with_step(motion: HumanMotion, side: str, start: int, stop: int) -> HumanMotion:
    """Lift one foot 10 cm and put it down 50 cm ahead, between two frames."""
    phase = np.clip((np.arange(motion.num_frames) - start) / (stop - start), 0, 1)
    ahead = 0.5 * (phase - np.sin(2 * np.pi * phase) / (2 * np.pi))
    positions = motion.positions.copy()
    for joint in FOOT[side]:
        positions[:, joint, 0] += ahead
        positions[:, joint, 2] += 0.1 * np.sin(np.pi * phase) ** 2
    return replace(motion, positions=positions)


def test_a_step_is_found_where_it_is(human: Human) -> None:
    motion = with_step(human(100), "left", 40, 65)
    contact = foot_contacts(motion)
    assert contact[:, 1].all()
    flights = runs(~contact[:, 0])
    assert len(flights) == 1
    start, stop = flights[0]
    assert abs(start - 40) <= 6
    assert abs(stop - 65) <= 6


def test_a_jump_has_no_contact(human: Human) -> None:
    motion = human(100)
    time = (np.arange(100) - 40) / 50
    height = np.maximum(1.5 * time - 9.81 / 2 * time**2, 0)
    lifted = motion.positions + height[:, None, None] * np.array([0, 0, 1.0])
    contact = foot_contacts(replace(motion, positions=lifted))
    airborne = height > 0.06
    assert not contact[airborne].any()
    assert contact[:38].all()
    assert contact[65:].all()


@pytest.mark.parametrize("offset", [-0.3, 0.0, 0.25])
def test_the_ground_may_lie_anywhere(human: Human, offset: float) -> None:
    motion = with_step(human(100), "right", 30, 55)
    raised = replace(motion, positions=motion.positions + np.array([0, 0, offset]))
    assert ground_level(raised, "ankle") == pytest.approx(0.09 + offset, abs=0.005)
    assert np.array_equal(foot_contacts(raised), foot_contacts(motion))


def walk_uphill(motion: HumanMotion, rise: float) -> HumanMotion:
    """Four steps while the floor, and everything on it, rises by ``rise`` metres."""
    for index, side in enumerate(("left", "right", "left", "right")):
        motion = with_step(motion, side, 20 + 40 * index, 45 + 40 * index)
    slope = np.linspace(0, rise, motion.num_frames)
    lift = slope[:, None, None] * np.array([0, 0, 1.0])
    return replace(motion, positions=motion.positions + lift)


def test_a_rising_floor_hides_no_stance(human: Human) -> None:
    flat, steep = walk_uphill(human(200), 0.0), walk_uphill(human(200), 0.12)
    different = foot_contacts(flat) != foot_contacts(steep)
    assert different.mean() < 0.02


def test_levelling_brings_all_stances_to_one_height(human: Human) -> None:
    steep = walk_uphill(human(200), 0.12)
    level = level_ground(steep)
    for index, side in enumerate(("left", "right")):
        stands = foot_contacts(level)[:, index]
        assert np.ptp(steep.joint(f"{side}_ankle")[stands, 2]) > 0.09
        assert np.ptp(level.joint(f"{side}_ankle")[stands, 2]) < 0.045
    # The same floor is taken out under the head.
    shift = level.positions[..., 2] - steep.positions[..., 2]
    assert np.allclose(shift, shift[:, :1])


def test_a_level_recording_stays_as_it_is(human: Human) -> None:
    flat = walk_uphill(human(200), 0.0)
    assert np.allclose(level_ground(flat).positions, flat.positions, atol=0.005)


def test_a_foot_that_is_held_up_does_not_stand(human: Human) -> None:
    motion = human(200)
    positions = motion.positions.copy()
    up = 0.3 * np.clip((np.arange(200) - 50) / 20, 0, 1)
    for joint in FOOT["left"]:
        positions[:, joint, 2] += up
    contact = foot_contacts(replace(motion, positions=positions))
    assert not contact[75:, 0].any()
    assert contact[:, 1].all()


def test_slow_sliding_is_still_standing_but_walking_is_not(human: Human) -> None:
    drift = np.linspace(0, 1, 100)[:, None, None] * np.array([1.0, 0, 0])
    motion = human(100)
    slow = replace(motion, positions=motion.positions + 0.1 * drift)
    fast = replace(motion, positions=motion.positions + 3.0 * drift)
    assert foot_contacts(slow).all()
    assert not foot_contacts(fast).any()


def test_a_runner_stands_until_the_ball_leaves_the_ground(
    runner: Callable[..., tuple[HumanMotion, np.ndarray]],
) -> None:
    motion, stands = runner()
    contact = foot_contacts(motion)
    inner = slice(36, 144)  # three strides
    for side in range(2):
        assert len(runs(contact[inner, side])) == len(runs(stands[inner, side]))
        share = contact[inner, side].mean() / stands[inner, side].mean()
        assert 0.75 < share < 1.15
    flight = np.logical_not(stands.any(axis=1))
    found = np.logical_not(contact.any(axis=1))
    assert flight[inner].mean() == pytest.approx(10 / 36)
    assert 0.2 < found[inner].mean() < 0.42
    # Never both at once, as in a walk.
    assert not contact[inner].all(axis=1).any()


def test_runs_and_smoothing() -> None:
    assert runs(np.array([1, 1, 0, 0, 1], dtype=bool)) == [(0, 2), (4, 5)]
    assert runs(np.zeros(3, dtype=bool)) == []
    ramp = np.arange(50.0)[:, None]
    assert smooth(ramp, 2.0)[10:40] == pytest.approx(ramp[10:40])
    # Held ends slow a ramp down; ends that go on leave it as it is.
    assert np.diff(smooth(ramp, 2.0)[:2, 0])[0] < 0.6
    assert smooth(ramp, 2.0, going_on=True) == pytest.approx(ramp)
    impulse = np.zeros(101)
    impulse[50] = 1.0
    spread = smooth(impulse, 3.0)
    offsets = np.arange(101) - 50
    assert spread.sum() == pytest.approx(1.0)
    assert np.sqrt((spread * offsets**2).sum()) == pytest.approx(3.0, rel=0.02)
