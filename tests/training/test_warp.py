"""MuJoCo Warp on the CPU device beside MuJoCo's threads: the same robots.

Warp compiles its kernels on first use (about 15 s on one core) and keeps them in its
cache, so later runs are quick.
"""

from dataclasses import replace

import numpy as np
import pytest
from beside_mujoco import (
    check_copies_do_alike,
    check_reset_leaves_others_alone,
    check_row_acts_alike,
    check_same_task,
    check_same_trajectory,
    converging_model,
)

from openclone.robot.model import SensorLayout
from openclone.training.physics import ThreadedPhysics
from openclone.training.randomization import TABLE_A2

pytestmark = pytest.mark.timeout(180)
N = 3
FLAT = ("flat",)


@pytest.fixture(scope="module")
def lean():
    return converging_model()


@pytest.fixture(scope="module")
def pair(lean):
    from openclone.training.warp_physics import WarpPhysics

    return ThreadedPhysics(lean, N, threads=1), WarpPhysics(lean, N, device="cpu")


def test_same_trajectory_for_fifty_steps(pair, lean):
    check_same_trajectory(*pair, SensorLayout.of(lean))


def test_copies_do_alike(pair):
    check_copies_do_alike(pair[1])


def test_a_reset_leaves_the_other_robots_alone(pair):
    check_reset_leaves_others_alone(pair[1])


@pytest.mark.parametrize(
    "row", ["friction", "com_offset", "link_mass", "p_gain", "d_gain"]
)
def test_each_row_acts_alike_on_both(pair, lean, row):
    check_row_acts_alike(*pair, row)
    for name, field in pair[1]._fields.items():
        expected = np.broadcast_to(getattr(lean, name), field.shape)
        np.testing.assert_allclose(field.numpy(), expected, rtol=1e-5, atol=1e-7)


def test_the_same_task_code_runs_on_warp(pair, lean, reference):
    flat = replace(TABLE_A2, terrain=FLAT)
    check_same_task(*pair, SensorLayout.of(lean), reference, flat)
