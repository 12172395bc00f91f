"""MuJoCo Warp on the CPU device beside MuJoCo's threads: the same robots.

Warp compiles its kernels on first use (about 15 s on one core) and keeps them in its
cache, so later runs are quick.
"""

from dataclasses import replace

import numpy as np
import pytest
import torch

from openclone.robot import g1
from openclone.robot.model import SUBSTEPS, SensorLayout, standing_qpos
from openclone.training.physics import ThreadedPhysics
from openclone.training.randomization import (
    TABLE_A2,
    RandomizationConfig,
    draw_parameters,
)
from openclone.training.task import TrackingTask
from openclone.training.task_config import TaskConfig
from openclone.training.terrain import build_training_model

pytestmark = pytest.mark.timeout(180)
N = 3
FLAT = ("flat",)


@pytest.fixture(scope="module")
def lean():
    """Training's model, with a solver that goes on until it has converged.

    Training stops it after 5 iterations; where that is too early, the two solvers stop
    at different points and the joints differ by up to 0.013 rad.
    """
    model = build_training_model()
    model.opt.iterations, model.opt.ls_iterations = 100, 50
    return model


@pytest.fixture(scope="module")
def pair(lean):
    from openclone.training.warp_physics import WarpPhysics

    return ThreadedPhysics(lean, N, threads=1), WarpPhysics(lean, N, device="cpu")


def births(lean):
    rng = np.random.default_rng(0)
    qpos = np.tile(standing_qpos(), (N, 1))
    qpos[:, 0] = np.arange(N)
    qpos[:, 7:] += 0.05 * rng.standard_normal((N, 29))
    qvel = 0.1 * rng.standard_normal((N, lean.nv))
    return qpos, qvel


def targets(rng):
    noise = 0.04 * rng.standard_normal((N, 1, 29))
    return torch.from_numpy(g1.DEFAULT_POSE + noise).expand(-1, SUBSTEPS, -1)


def run(physics, lean, steps):
    qpos, qvel = births(lean)
    physics.reset(np.arange(N), qpos, qvel)
    rng = np.random.default_rng(1)
    states = []
    for step in range(steps):
        if step == 10:
            physics.push(np.array([1]), np.array([[0.3, -0.1, 0.0]]))
        physics.step(targets(rng))
        states.append([part.double().numpy() for part in physics.read()])
    return [np.stack(parts) for parts in zip(*states, strict=True)]


def test_same_trajectory_for_fifty_steps(pair, lean):
    threaded, warp = (run(physics, lean, 50) for physics in pair)
    qpos, other = threaded[0], warp[0]
    assert np.abs(qpos[-1] - qpos[0]).max() > 0.05
    # Single against double precision, metres and radians; contacts amplify it.
    np.testing.assert_allclose(other[:20], qpos[:20], atol=2e-5)
    np.testing.assert_allclose(other, qpos, atol=1e-2)
    layout = SensorLayout.of(lean)
    # Before contacts amplify anything, all sensors agree, forces included.
    for part in ("position", "quat", "velocity", "angular_velocity"):
        span = getattr(layout, part)
        np.testing.assert_allclose(
            warp[2][:5, :, span], threaded[2][:5, :, span], atol=2e-4
        )
    for part in ("torque", "foot_force"):
        span = getattr(layout, part)
        np.testing.assert_allclose(
            warp[2][:5, :, span], threaded[2][:5, :, span], atol=0.5
        )


def test_a_reset_leaves_the_other_robots_alone(pair, lean):
    _, warp = pair
    run(warp, lean, 3)
    before = [part.numpy().copy() for part in warp.read()]
    qpos, qvel = births(lean)
    warp.reset(np.array([1]), qpos[:1], qvel[:1])
    after = [part.numpy() for part in warp.read()]
    for old, new in zip(before, after, strict=True):
        np.testing.assert_array_equal(new[[0, 2]], old[[0, 2]])
        assert not np.array_equal(new[1], old[1])
    np.testing.assert_allclose(after[0][1], qpos[0], atol=1e-6)


@pytest.mark.parametrize(
    "row", ["friction", "com_offset", "link_mass", "p_gain", "d_gain"]
)
def test_each_row_acts_alike_on_both(pair, lean, row):
    """Rows change the motion, and both back-ends move the changed robots alike."""
    only = RandomizationConfig(**{row: getattr(TABLE_A2, row)})
    if row == "friction":
        only = RandomizationConfig(friction=(0.05, 0.1))  # slides, so that it matters
    drawn = draw_parameters(only, N, pair[0].links, np.random.default_rng(3))
    nominal = draw_parameters(
        RandomizationConfig(), N, pair[0].links, np.random.default_rng(3)
    )
    plain = run(pair[0], lean, 8)[0]
    for physics in pair:
        physics.randomize(np.arange(N), drawn)
    qpos, other = (run(physics, lean, 8)[0] for physics in pair)
    assert np.abs(plain - qpos).max() > 1e-3
    np.testing.assert_allclose(other, qpos, atol=5e-5)
    for physics in pair:
        physics.randomize(np.arange(N), nominal)
    for name, field in pair[1]._fields.items():
        expected = np.broadcast_to(getattr(lean, name), field.shape)
        np.testing.assert_allclose(field.numpy(), expected, rtol=1e-5, atol=1e-7)


def test_the_same_task_code_runs_on_warp(pair, lean, reference):
    def play(physics):
        config = TaskConfig(num_envs=N, randomization=replace(TABLE_A2, terrain=FLAT))
        task = TrackingTask(reference, physics, SensorLayout.of(lean), config, 0)
        rewards = []
        for _ in range(10):
            result = task.step(task.residual_to_target(torch.zeros(N, 29)))
            rewards.append(result.reward)
        return torch.stack(rewards), task.teacher_observation()

    (rewards, seen), (other, other_seen) = (play(physics) for physics in pair)
    assert float(rewards.abs().max()) > 0.01
    torch.testing.assert_close(other, rewards, atol=1e-3, rtol=0)
    torch.testing.assert_close(other_seen, seen, atol=2e-2, rtol=0)
