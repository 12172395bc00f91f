"""Uneven ground: where it lies, what it does to robots, what it leaves alone."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
import torch

from openclone.robot import g1
from openclone.robot.model import SensorLayout
from openclone.training.data import make_task
from openclone.training.hardware import Hardware
from openclone.training.physics import ThreadedPhysics
from openclone.training.randomization import RandomizationConfig
from openclone.training.task import TrackingTask
from openclone.training.task_config import TABLE_A2_TASK, TaskConfig
from openclone.training.terrain import (
    CELL,
    OBSTACLE_HEIGHT,
    PATCH,
    ROUGHNESS,
    build_terrain,
    build_training_model,
)

KINDS = ("flat", "rough", "obstacles")
CALM = TaskConfig(
    num_envs=6,
    push_speed=0.0,
    displaced_share=0.0,
    randomization=RandomizationConfig(terrain=KINDS),
)


@pytest.fixture(scope="module")
def terrain():
    return build_terrain(KINDS, np.random.default_rng(0))


@pytest.fixture(scope="module")
def world(terrain):
    return build_training_model(terrain)


def test_heights(terrain):
    columns = round(PATCH / CELL)
    rough, obstacles = terrain.heights[:, :columns], terrain.heights[:, columns:]
    assert np.abs(rough).max() <= ROUGHNESS
    assert np.ptp(rough) > 1.8 * ROUGHNESS
    assert np.abs(np.diff(rough, axis=0)).max() < 2 * ROUGHNESS
    assert obstacles.min() == 0.0
    assert 0.9 * OBSTACLE_HEIGHT < obstacles.max() <= OBSTACLE_HEIGHT
    assert 0.2 < (obstacles > 0).mean() < 0.35
    assert build_terrain(("flat",), np.random.default_rng(0)) is None


def test_the_compiled_field_has_these_heights(terrain, world):
    data = mujoco.MjData(world)
    mujoco.mj_forward(world, data)
    rows, columns = terrain.heights.shape
    rng = np.random.default_rng(1)
    geom = np.zeros(1, np.int32)
    for _ in range(50):
        row, column = int(rng.integers(1, rows - 1)), int(rng.integers(1, columns - 1))
        x = 100.0 + (column - 0.5 * (columns - 1)) * CELL
        y = (row - 0.5 * (rows - 1)) * CELL
        down = np.array([0.0, 0, -1])
        above = np.array([x, y, 3.0])
        hit = mujoco.mj_ray(world, data, above, down, None, 1, -1, geom)
        assert world.geom(geom[0]).name == "terrain"
        assert 3.0 - hit - 1.0 == pytest.approx(terrain.heights[row, column], abs=1e-5)


def test_robots_are_spread_and_born_on_top_of_their_ground(terrain, world, reference):
    physics = ThreadedPhysics(world, 6, threads=1)
    layout = SensorLayout.of(world)
    task = TrackingTask(reference, physics, layout, CALM, 0, terrain)
    x, y, z = physics.qpos[:, :3].T
    on_flat, on_rough, on_obstacles = [0, 3], [1, 4], [2, 5]
    assert (np.abs(x[on_flat]) < 5).all()
    assert ((x[on_rough] > 100 - PATCH) & (x[on_rough] < 100)).all()
    assert ((x[on_obstacles] > 100) & (x[on_obstacles] < 100 + PATCH)).all()
    assert (np.abs(y) < PATCH / 2).all()
    assert (z[on_rough] > 1.7).all()
    # Nobody starts inside the ground.
    data = mujoco.MjData(world)
    for robot in range(6):
        data.qpos[:] = physics.qpos[robot]
        mujoco.mj_forward(world, data)
        assert data.contact.dist.min(initial=0.0) > -0.012
    # Policies and rewards see the reference's frame.
    wanted = reference.at(task.frame)
    offset = task.robot_state().body_position - wanted.body_position
    assert float(offset.norm(dim=-1).max()) < 0.12 + OBSTACLE_HEIGHT


def test_robots_stand_on_uneven_ground(terrain, world, reference):
    physics = ThreadedPhysics(world, 6, threads=1)
    task = TrackingTask(reference, physics, SensorLayout.of(world), CALM, 0, terrain)
    force = torch.zeros(6)
    for _ in range(15):
        result = task.step(task.residual_to_target(torch.zeros(6, 29)))
        assert not result.terminated.any()
        force = torch.maximum(force, task.robot_state().foot_force[..., 2].sum(-1))
    assert (force > 150.0).all()
    # The plane is a metre below: the feet rest on the field.
    feet = physics.sensordata[:, SensorLayout.of(world).position].reshape(6, -1, 3)
    level = feet[1:3][:, list(g1.FEET), 2]
    assert (level > 1.0).all()
    assert (level < 1.2).all()


def test_flat_robots_do_not_notice_the_terrain(reference):
    def run(kinds):
        config = replace(
            CALM, num_envs=3, randomization=RandomizationConfig(terrain=kinds)
        )
        # Rough ground is MuJoCo's; so is the flat one that it is compared with.
        task = make_task(reference, config, 0, 1, Hardware("threaded"))
        for _ in range(10):
            task.step(task.residual_to_target(torch.zeros(3, 29)))
        return task.robot_state().body_position[0]

    torch.testing.assert_close(run(KINDS), run(("flat",)), atol=1e-6, rtol=0)


def test_the_whole_table_runs(reference):
    task = make_task(reference, replace(TABLE_A2_TASK, num_envs=6), 0, 1)
    for _ in range(25):
        result = task.step(task.residual_to_target(torch.zeros(6, 29)))
        assert torch.isfinite(result.reward).all()
        assert torch.isfinite(task.teacher_observation()).all()
