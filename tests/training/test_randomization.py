"""Every row of Table A2 changes what it should, and nothing else."""

import math
from dataclasses import fields, replace

import mujoco
import numpy as np
import pytest
import torch

from openclone.robot import g1
from openclone.robot.model import (
    SUBSTEPS,
    TIMESTEP,
    SensorLayout,
    build_model,
    standing_qpos,
)
from openclone.training.physics import RobotParameters, ThreadedPhysics, foot_geoms
from openclone.training.randomization import (
    TABLE_A2,
    ActionPath,
    RandomizationConfig,
    draw_parameters,
)
from openclone.training.task import TrackingTask
from openclone.training.task_config import TABLE_A2_TASK, TaskConfig
from openclone.training.terrain import build_training_model

N = 200
DERIVED = {
    "body_invweight0", "dof_invweight0", "dof_M0", "actuator_acc0", "body_subtreemass",
    "dof_length", "cam_poscom0", "light_poscom0",
}  # fmt: skip
"""What MuJoCo computes from masses and places: changes with them."""


@pytest.fixture(scope="module")
def lean():
    return build_training_model()


def built(lean, **ranges):
    """N robots with only the given rows switched on, and what was drawn."""
    physics = ThreadedPhysics(lean, N, threads=1)
    config = RandomizationConfig(**ranges)
    drawn = draw_parameters(config, N, physics.links, np.random.default_rng(0))
    physics.randomize(np.arange(N), drawn)
    return physics, drawn


def changed_fields(model, nominal):
    names = set()
    for name in dir(nominal):
        value = getattr(nominal, name) if not name.startswith("_") else None
        if isinstance(value, np.ndarray) and value.dtype.kind == "f":
            now = getattr(model, name)
            if not np.allclose(now, value, rtol=1e-9, atol=1e-12):
                names.add(name)
    return names


@pytest.mark.parametrize(
    ("row", "value", "expected"),
    [
        ("friction", (0.6, 2.0), {"geom_friction"}),
        ("com_offset", 0.04, {"body_ipos"}),
        ("link_mass", (0.7, 1.25), {"body_mass", "body_inertia"}),
        ("p_gain", (0.85, 1.15), {"actuator_gainprm", "actuator_biasprm"}),
        ("d_gain", (0.85, 1.15), {"actuator_biasprm"}),
    ],
)
def test_a_row_changes_its_fields_only(lean, row, value, expected):
    physics, drawn = built(lean, **{row: value})
    for robot in (0, N - 1):
        changed = changed_fields(physics._models[robot], lean)
        assert expected <= changed
        assert changed <= expected | (
            set() if row in ("friction", "p_gain", "d_gain") else DERIVED
        )
    for field in fields(RobotParameters):
        values = getattr(drawn, field.name)
        low, high = (-value, value) if row == "com_offset" else value
        if field.name == row:
            assert values.min() >= low
            assert values.max() <= high
            # Uniform: mean within five standard errors.
            error = 5 * (high - low) / math.sqrt(12 * values.size)
            assert abs(values.mean() - (low + high) / 2) < error
            assert values.std() == pytest.approx((high - low) / math.sqrt(12), rel=0.1)
        else:
            assert np.ptp(values) == 0


def test_nothing_is_drawn_when_everything_is_off(lean):
    physics, _ = built(lean)
    assert not changed_fields(physics._models[0], lean)
    assert not RandomizationConfig().changes_robots


def stand(model, data, qvel=None):
    mujoco.mj_resetData(model, data)
    data.qpos[:] = standing_qpos()
    data.ctrl[:] = g1.DEFAULT_POSE
    if qvel is not None:
        data.qvel[:] = qvel
    mujoco.mj_forward(model, data)


def test_friction_holds_in_the_contacts(lean):
    physics, drawn = built(lean, friction=(0.6, 2.0))
    data = mujoco.MjData(lean)
    stand(physics._models[3], data)
    assert data.ncon >= 4
    np.testing.assert_allclose(data.contact.friction[:, 0], drawn.friction[3])
    others = [i for i in range(lean.ngeom) if i not in foot_geoms(lean)]
    np.testing.assert_array_equal(
        physics._models[3].geom_friction[others], lean.geom_friction[others]
    )


def test_com_offset_moves_the_whole_robots_com_by_the_bases_share(lean):
    physics, drawn = built(lean, com_offset=0.04)
    data = mujoco.MjData(lean)
    stand(lean, data)
    before = data.subtree_com[0].copy()
    stand(physics._models[5], data)
    share = lean.body("pelvis").mass[0] / lean.body_subtreemass[0]
    np.testing.assert_allclose(
        data.subtree_com[0] - before, share * drawn.com_offset[5], atol=1e-12
    )


def test_link_mass_changes_the_weight(lean):
    physics, drawn = built(lean, link_mass=(0.7, 1.25))
    data = mujoco.MjData(lean)
    stand(physics._models[7], data)
    weight = 9.81 * (lean.body_mass[1:] * drawn.link_mass[7]).sum()
    # At rest the bias force on the root's z is the robot's weight.
    assert data.qfrc_bias[2] == pytest.approx(weight, rel=1e-9)


def test_gains_change_the_torque(lean):
    physics, drawn = built(lean, p_gain=(0.85, 1.15), d_gain=(0.85, 1.15))
    layout = SensorLayout.of(lean)
    qpos = np.tile(standing_qpos(), (N, 1))
    qvel = np.zeros((N, lean.nv))
    qvel[:, 6:] = 0.3
    physics.reset(np.arange(N), qpos, qvel)
    target = g1.DEFAULT_POSE + 0.05
    physics.step(torch.from_numpy(np.tile(target, (N, 1, 1))))
    torque = g1.KP * drawn.p_gain * 0.05 - g1.KD * drawn.d_gain * 0.3
    np.testing.assert_allclose(physics.sensordata[:, layout.torque], torque, rtol=1e-9)


def path(count=4, **settings):
    generator = torch.Generator().manual_seed(0)
    return ActionPath(RandomizationConfig(**settings), count, generator)


def test_torque_injection_is_a_uniform_torque_of_five_percent(lean):
    layout = SensorLayout.of(lean)
    physics, drawn = built(lean, p_gain=(0.85, 1.15))
    injection = path(N, torque_injection=0.05)
    injection.set_gains(torch.arange(N), drawn.p_gain)
    targets = torch.tensor(np.tile(g1.DEFAULT_POSE, (N, 1)), dtype=torch.float32)
    qpos = np.tile(standing_qpos(), (N, 1))
    physics.reset(np.arange(N), qpos, np.zeros((N, lean.nv)))
    ctrl = injection(targets)
    physics.step(ctrl[:, :1])
    share = physics.sensordata[:, layout.torque] / g1.MAX_TORQUE
    assert np.abs(share).max() <= 0.05 + 1e-6
    assert np.abs(share).max() > 0.0495
    assert share.std() == pytest.approx(0.05 / math.sqrt(3), rel=0.03)
    assert abs(share.mean()) < 5 * 0.05 / math.sqrt(3 * share.size)
    # A new torque in every physics step.
    assert not torch.equal(ctrl[:, 0], ctrl[:, 1])


def test_control_delay_shifts_within_the_control_step():
    late = path(1, control_delay=0.020)
    late.reset(torch.tensor([0]), torch.zeros(1, 29))
    late.delay[:] = 0.007
    one = late(torch.ones(1, 29))[0, :, 0]
    # Old target for 7 ms: all of the first 5 ms step, two fifths of the second.
    torch.testing.assert_close(one, torch.tensor([0.0, 0.6, 1.0, 1.0]))
    two = late(torch.full((1, 29), 2.0))[0, :, 0]
    torch.testing.assert_close(two, torch.tensor([1.0, 1.6, 2.0, 2.0]))


def test_step_delay_holds_back_whole_control_steps():
    late = path(1, step_delay=0.080)
    late.reset(torch.tensor([0]), torch.zeros(1, 29))
    late.delay[:] = 0.050
    out = [late(torch.full((1, 29), float(k)))[0, :, 0].tolist() for k in range(1, 6)]
    assert out == [[0] * 4, [0] * 4, [0, 0, 1, 1], [1, 1, 2, 2], [2, 2, 3, 3]]


def test_delays_are_uniform_and_drawn_anew_for_the_reset_robots_only():
    late = path(4000, control_delay=0.020)
    late.reset(torch.arange(4000), torch.zeros(4000, 29))
    assert 0.0199 < float(late.delay.max()) <= 0.020
    assert float(late.delay.mean()) == pytest.approx(0.010, abs=5e-4)
    before = late.delay.clone()
    late.reset(torch.arange(2000), torch.zeros(2000, 29))
    assert not torch.equal(late.delay[:2000], before[:2000])
    assert torch.equal(late.delay[2000:], before[2000:])
    both = path(4000, control_delay=0.020, step_delay=0.080)
    both.reset(torch.arange(4000), torch.zeros(4000, 29))
    # The sum of both: means and variances add.
    assert float(both.delay.mean()) == pytest.approx(0.050, abs=2e-3)
    assert float(both.delay.var()) == pytest.approx((0.02**2 + 0.08**2) / 12, rel=0.08)


def test_longest_delay_still_finds_its_target():
    late = path(1, control_delay=0.020, step_delay=0.080)
    late.reset(torch.tensor([0]), torch.zeros(1, 29))
    late.delay[:] = 0.100
    out = [late(torch.full((1, 29), float(k)))[0, :, 0].tolist() for k in range(1, 8)]
    assert out[4] == [0] * SUBSTEPS
    assert out[5] == [1] * SUBSTEPS
    assert out[6] == [2] * SUBSTEPS


def test_no_rows_no_change_of_the_targets():
    targets = torch.randn(4, 29)
    ctrl = path(4)(targets)
    assert torch.equal(ctrl, targets[:, None].expand(-1, SUBSTEPS, -1))


class Recorder(ThreadedPhysics):
    """Physics that notes pushes and births."""

    def __init__(self, *args, **settings):
        super().__init__(*args, **settings)
        self.pushes, self.births = [], []

    def push(self, ids, velocity):
        self.pushes.append(velocity)
        super().push(ids, velocity)

    def reset(self, ids, qpos, qvel):
        self.births.append(qpos.copy())
        super().reset(ids, qpos, qvel)


def task_with(lean, reference, config):
    physics = Recorder(lean, config.num_envs, threads=1)
    return TrackingTask(reference, physics, SensorLayout.of(lean), config, 0), physics


def test_push_row(lean, reference):
    config = replace(TABLE_A2_TASK, num_envs=500, randomization=RandomizationConfig())
    task, physics = task_with(lean, reference, config)
    for _ in range(200):
        task._push()
    pushes = np.concatenate(physics.pushes)
    expected = 500 * 200 * TIMESTEP * SUBSTEPS / 5.0
    assert len(pushes) == pytest.approx(expected, abs=5 * math.sqrt(expected))
    assert np.abs(pushes[:, :2]).max() <= 1.5
    assert np.abs(pushes[:, :2]).max() > 1.4
    assert not pushes[:, 2].any()


def test_born_rows(lean, reference):
    config = replace(TABLE_A2_TASK, num_envs=600, randomization=RandomizationConfig())
    displaced, physics = task_with(lean, reference, config)
    start = reference.qpos[displaced.frame.numpy()]
    moved = physics.births[0][:, :2] - start[:, :2]
    distance = np.hypot(*moved.T)
    assert distance.max() <= 2.0
    assert distance.mean() == pytest.approx(1.0, abs=0.12)
    assert distance.std() == pytest.approx(2.0 / math.sqrt(12), rel=0.1)
    bearing = np.arctan2(moved[:, 1], moved[:, 0])
    assert abs(np.exp(1j * bearing).mean()) < 0.15
    w, z = physics.births[0][:, 3], physics.births[0][:, 6]
    turn = np.rad2deg(2 * np.arctan2(z, w))
    assert np.abs(turn).max() <= 20.0
    assert np.abs(turn).max() > 19.0
    # Nothing else: height and joints are drawn as without displacement.
    plain, other = task_with(
        lean, reference, replace(config, born_distance=0.0, born_heading=0.0)
    )
    assert torch.equal(plain.frame, displaced.frame)
    np.testing.assert_array_equal(physics.births[0][:, 2], other.births[0][:, 2])
    np.testing.assert_array_equal(physics.births[0][:, 7:], other.births[0][:, 7:])


def test_printed_values():
    assert TABLE_A2.friction == (0.6, 2.0)
    assert TABLE_A2.com_offset == 0.04
    assert TABLE_A2.link_mass == (0.7, 1.25)
    assert TABLE_A2.p_gain == TABLE_A2.d_gain == (0.85, 1.15)
    assert TABLE_A2.torque_injection == 0.05
    assert TABLE_A2.control_delay == 0.020
    assert TABLE_A2.step_delay == 0.080
    assert TABLE_A2.terrain == ("flat", "rough", "obstacles")
    assert TABLE_A2_TASK.born_distance == 2.0
    assert math.degrees(TABLE_A2_TASK.born_heading) == pytest.approx(20.0)
    assert (TABLE_A2_TASK.push_interval, TABLE_A2_TASK.push_speed) == (5.0, 1.5)
    assert TaskConfig().randomization == RandomizationConfig()


def test_lean_model_moves_like_the_full_one(lean):
    full = build_model()
    rng = np.random.default_rng(0)
    states = []
    for model in (full, lean):
        physics = ThreadedPhysics(model, 1, threads=1)
        physics.reset(np.array([0]), standing_qpos()[None], np.zeros((1, model.nv)))
        rng = np.random.default_rng(0)
        for _ in range(20):
            target = g1.DEFAULT_POSE + 0.1 * rng.standard_normal((1, SUBSTEPS, 29))
            physics.step(torch.from_numpy(target))
        states.append((physics.qpos.copy(), physics.sensordata.copy()))
    np.testing.assert_allclose(states[1][0], states[0][0], atol=1e-9)
    np.testing.assert_allclose(states[1][1], states[0][1], rtol=1e-6, atol=1e-5)
    assert SensorLayout.of(lean) == SensorLayout.of(full)
