"""Feet side by side: footprints worked out by hand."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from openclone.motion.contacts import foot_contacts
from openclone.motion.footing import apart, foot_targets
from openclone.motion.proportions import FPS, RetargetConfig
from openclone.motion.skeleton import HumanMotion
from openclone.robot.model import SOLE_CORNERS
from openclone.spatial import rotations

LEAST = 0.16


def stepping(width: float) -> tuple[np.ndarray, np.ndarray]:
    """A walk along +X: steps of 0.4 m, 30 frames of stance, 20 of swing.

    Returns:
        Places (2, T, 2) of the left and the right foot and contacts (T, 2).
    """
    place, contact = np.zeros((2, 200, 2)), np.zeros((200, 2), dtype=bool)
    place[0, :, 1], place[1, :, 1] = width / 2, -width / 2
    for side in range(2):
        for frame in range(200):
            cycle, phase = divmod(frame + 25 * side, 50)
            contact[frame, side] = phase < 30
            share = max(phase - 30, 0) / 20
            place[side, frame, 0] = 0.4 * (cycle + share) - 0.2 * side
    return place, contact


def heading(yaw: float) -> np.ndarray:
    return np.tile(rotations.from_yaw(np.array(yaw)), (200, 1))


@pytest.mark.parametrize("width", [0.0, 0.06, 0.12])
def test_feet_on_a_line_come_apart_and_stay_planted(width: float) -> None:
    place, contact = stepping(width)
    moved = place + apart(place, contact, heading(0.0), LEAST)
    gap = moved[0, :, 1] - moved[1, :, 1]
    assert gap.min() > LEAST - 0.005
    # Both give way, so that the body's path stays in the middle.
    assert moved[0, :, 1].mean() == pytest.approx(-moved[1, :, 1].mean(), abs=0.01)
    for side in range(2):
        stands = contact[1:, side] & contact[:-1, side]
        assert np.abs(np.diff(moved[side], axis=0)[stands]).max() < 1e-9


def test_feet_that_are_apart_stay_where_they_are() -> None:
    place, contact = stepping(0.17)
    assert np.abs(apart(place, contact, heading(0.0), LEAST)).max() == 0.0


def test_apart_is_across_the_heading() -> None:
    place, contact = stepping(0.06)
    turn = rotations.from_yaw(np.array(1.0))
    flat = np.concatenate((place, np.zeros((2, 200, 1))), axis=-1)
    turned = rotations.rotate(turn[None, None], flat)[..., :2]
    moves = apart(turned, contact, heading(1.0), LEAST)
    ahead = np.array([np.cos(1.0), np.sin(1.0)])
    assert np.abs(moves @ ahead).max() < 1e-9
    assert np.abs(moves).max() > 0.03


def test_a_swinging_foot_goes_round_the_standing_one() -> None:
    place, contact = stepping(0.2)
    swings = np.flatnonzero(~contact[:, 1])
    place[1, swings, 1] += 0.12 * np.sin(np.pi * (np.arange(len(swings)) % 20) / 20)
    before = place[0, :, 1] - place[1, :, 1]
    moves = apart(place, contact, heading(0.0), LEAST)
    after = before + moves[0, :, 1] - moves[1, :, 1]
    assert before.min() < 0.09
    assert after.min() > 0.13
    assert np.abs(moves[0]).max() < 1e-9


def test_no_foot_is_moved_far() -> None:
    place, contact = stepping(-0.3)
    moves = apart(place, contact, heading(0.0), LEAST)
    for side in range(2):
        stands = contact[:, side]
        assert np.linalg.norm(moves[side, stands], axis=-1).max() < 0.0801


def runner_soles(motion: HumanMotion, contact: np.ndarray) -> np.ndarray:
    """(2, T, 4, 3), metres: the corners of both soles of a runner, as wanted."""
    feet = foot_targets(motion, contact, 0.75, RetargetConfig())
    return np.stack(
        [
            place[:, None] + rotations.rotate(quat[:, None], SOLE_CORNERS[None])
            for place, quat in feet
        ]
    )


def test_a_runner_pushes_off_over_the_front_edge_of_the_sole(
    runner: Callable[..., tuple[HumanMotion, np.ndarray]],
) -> None:
    motion, _ = runner()
    contact = foot_contacts(motion)
    soles = runner_soles(motion, contact)
    front = SOLE_CORNERS[:, 0] == SOLE_CORNERS[:, 0].max()
    for side in range(2):
        stands = contact[:, side]
        heel = soles[side][stands][:, ~front, 2]
        assert heel.max() > 0.03
        assert heel.max() < 0.09
        edge = soles[side][:, front]
        assert np.abs(edge[stands][..., 2]).max() < 0.002
        held = stands[1:] & stands[:-1]
        assert np.linalg.norm(np.diff(edge, axis=0)[held], axis=-1).max() < 0.002


def test_a_swinging_sole_does_not_scrape(
    runner: Callable[..., tuple[HumanMotion, np.ndarray]],
) -> None:
    # A shuffling human, whose toes hardly rise.
    soles = runner_soles(*runner(lift=0.01))
    low = soles[..., 2] < 0.005
    speed = np.linalg.norm(np.diff(soles[..., :2], axis=1), axis=-1) * FPS
    touches = low[:, 1:] & low[:, :-1]
    assert touches.mean() > 0.15
    assert speed[touches].mean() < 0.05
