import copy

import mujoco
import numpy as np
import torch
from beside_mujoco import check_copies_do_alike

from openclone.robot import g1
from openclone.robot.model import SUBSTEPS, standing_qpos
from openclone.training.physics import ThreadedPhysics


def test_steps_like_mujoco(model):
    physics = ThreadedPhysics(model, 2, threads=1)
    qpos = np.tile(standing_qpos(), (2, 1))
    qpos[1, 0] = 3.0
    qvel = np.zeros((2, model.nv))
    qvel[1, 0] = 0.2
    physics.reset(np.arange(2), qpos, qvel)
    ctrl = torch.from_numpy(np.tile(g1.DEFAULT_POSE, (2, SUBSTEPS, 1)))
    for _ in range(10):
        physics.step(ctrl)
    data = mujoco.MjData(model)
    data.qpos[:], data.qvel[:] = qpos[1], qvel[1]
    for _ in range(10):
        # mujoco.rollout starts every call without the last solution of the solver.
        data.qacc_warmstart[:] = 0
        data.ctrl[:] = g1.DEFAULT_POSE
        for _ in range(SUBSTEPS):
            mujoco.mj_step(model, data)
    np.testing.assert_allclose(physics.qpos[1], data.qpos, atol=1e-9)
    np.testing.assert_allclose(physics.qvel[1], data.qvel, atol=1e-7)


def test_reset_refreshes_sensors_of_the_chosen_robots_only(model):
    physics = ThreadedPhysics(model, 3, threads=1)
    before = physics.sensordata.copy()
    physics.reset(np.array([1]), standing_qpos()[None], np.zeros((1, model.nv)))
    head = model.sensor("position/torso_link").adr[0]
    data = mujoco.MjData(model)
    data.qpos[:] = standing_qpos()
    mujoco.mj_forward(model, data)
    np.testing.assert_allclose(
        physics.sensordata[1, head : head + 3], data.body("torso_link").xpos
    )
    np.testing.assert_array_equal(physics.sensordata[[0, 2]], before[[0, 2]])


def test_each_robot_may_have_its_own_model(model):
    heavy = copy.copy(model)
    heavy.body_mass[:] *= 2
    physics = ThreadedPhysics(model, 2, threads=1, models=[model, heavy])
    qpos = np.tile(standing_qpos(), (2, 1))
    physics.reset(np.arange(2), qpos, np.zeros((2, model.nv)))
    physics.step(torch.from_numpy(np.tile(g1.DEFAULT_POSE, (2, SUBSTEPS, 1))))
    assert physics.qpos[0, 2] - physics.qpos[1, 2] > 1e-5


def test_push_adds_root_velocity(model):
    physics = ThreadedPhysics(model, 2, threads=1)
    physics.push(np.array([1]), np.array([[0.3, -0.2, 0.0]]))
    np.testing.assert_array_equal(physics.qvel[0, :3], 0)
    np.testing.assert_array_equal(physics.qvel[1, :3], [0.3, -0.2, 0])


def test_copies_do_alike(model):
    check_copies_do_alike(ThreadedPhysics(model, 4, threads=1))
