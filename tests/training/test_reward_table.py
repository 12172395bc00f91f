"""The weights of Table A1 and of preset `fast`, and their sum."""

import math
from dataclasses import fields

import pytest

from openclone.training.reward_table import (
    FAST,
    PAPER,
    RewardWeights,
    RewardWidths,
    total_reward,
)

TERMS = {field.name for field in fields(RewardWeights)} - {"widths", "limit"}

# Printed weights of Table A1, in its order; the sign of the last but one is ours.
TABLE_A1 = (
    -0.0001, -2, -625, -50, -1e4, -1.1e-5, -0.004, -1.0, -0.3, 2500, -1.25e4, -80,
    -62.5, -750, -50, 100, 10, 250, 150, 400, 80, 8, -500, 500,
)  # fmt: skip


def test_paper_weights_are_the_printed_ones_row_by_row():
    names = [field.name for field in fields(RewardWeights)][: len(TABLE_A1)]
    assert [getattr(PAPER, name) for name in names] == pytest.approx(list(TABLE_A1))
    others = TERMS - set(names)
    assert all(getattr(PAPER, name) == 0 for name in others)


def test_every_weight_has_a_term(perfect):
    ones = RewardWeights(**dict.fromkeys(TERMS, 1.0))
    _, terms = total_reward(perfect, ones)
    assert set(terms) == TERMS


def test_total_is_the_weighted_sum(perfect):
    perfect.robot.body_position[:, :, 0] += 0.2
    weights = RewardWeights(root_position=2.0, body_position=0.5)
    total, terms = total_reward(perfect, weights)
    assert set(terms) == {"root_position", "body_position"}
    assert float(total) == pytest.approx(2 * math.exp(-1) + 0.5, abs=1e-4)


def test_widths_come_from_the_table(perfect):
    perfect.robot.body_position[:, :, 0] += 0.3
    narrow = RewardWeights(root_position=1.0, widths=RewardWidths(root_position=0.045))
    assert float(total_reward(perfect, narrow)[0]) == pytest.approx(
        math.exp(-2), abs=1e-5
    )


def test_fast_rewards_of_perfect_tracking(perfect):
    perfect.robot.foot_force[:] = 0
    perfect.robot.foot_force[:, :, 2] = 100.0
    perfect.robot.torque[:] = 0
    total, _ = total_reward(perfect, FAST)
    # The closeness weights sum to 24; the moving arms cost a little.
    assert float(total) == pytest.approx(24.0, abs=0.05)
