"""Robots in lanes beside MuJoCo's threads: the same motion, forces and sensors."""

import copy
from dataclasses import replace

import mujoco
import numpy as np
import pytest
import torch
from beside_mujoco import (
    check_copies_do_alike,
    check_reset_leaves_others_alone,
    check_row_acts_alike,
    check_same_task,
    check_same_trajectory,
    converging_model,
    run,
)

from openclone.errors import InputError
from openclone.robot import g1
from openclone.robot.model import SUBSTEPS, SensorLayout, standing_qpos
from openclone.training import lane_physics, native
from openclone.training.hardware import Hardware
from openclone.training.lane_physics import LanePhysics
from openclone.training.physics import ThreadedPhysics
from openclone.training.randomization import TABLE_A2
from openclone.training.terrain import build_terrain, build_training_model

needs_compiler = pytest.mark.skipif(
    native.compiler() is None, reason="no C compiler on this machine"
)
N = 19
"""Fills one block of sixteen and begins another."""


@pytest.fixture(scope="module")
def lean():
    return converging_model()


@pytest.fixture(scope="module")
def pair(lean):
    """Both with contacts solved to the end."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(lane_physics, "_SWEEPS", 1000)
        patch.setattr(lane_physics, "_ENOUGH", 0.0)
        lanes = LanePhysics(lean, N, threads=2)
    return ThreadedPhysics(lean, N, threads=1), lanes


@needs_compiler
def test_same_trajectory_for_fifty_steps(pair, lean):
    check_same_trajectory(*pair, SensorLayout.of(lean))


@needs_compiler
def test_training_solves_contacts_as_well_as_with_mujoco(lean):
    """As MuJoCo with the 5 iterations that training gives it, beside its solution."""
    hasty = copy.copy(lean)
    hasty.opt.iterations, hasty.opt.ls_iterations = 5, 10
    exact = run(ThreadedPhysics(lean, N, 1), 20)[0]
    lanes = run(LanePhysics(lean, N, 1), 20)[0]
    mujoco_ = run(ThreadedPhysics(hasty, N, 1), 20)[0]
    off = [np.abs(found - exact).max((1, 2)).mean() for found in (lanes, mujoco_)]
    assert off[0] < 1.5 * off[1] + 1e-4
    assert off[0] < 2e-3


@needs_compiler
def test_copies_do_alike(pair):
    check_copies_do_alike(pair[1])


@needs_compiler
def test_a_reset_leaves_the_other_robots_alone(pair):
    check_reset_leaves_others_alone(pair[1])


@needs_compiler
@pytest.mark.parametrize(
    "row", ["friction", "com_offset", "link_mass", "p_gain", "d_gain"]
)
def test_each_row_acts_alike_on_both(pair, row):
    check_row_acts_alike(*pair, row)


@needs_compiler
def test_the_same_task_code_runs_in_lanes(pair, lean, reference):
    flat = replace(TABLE_A2, terrain=("flat",))
    check_same_task(*pair, SensorLayout.of(lean), reference, flat)


@needs_compiler
def test_threads_do_not_change_the_result(lean):
    one, three = (run(LanePhysics(lean, 40, threads), 5) for threads in (1, 3))
    for left, right in zip(one, three, strict=True):
        np.testing.assert_array_equal(left, right)


def beside(lean, qpos, ctrl, steps):
    """Final qpos of both back-ends from ``qpos (n, 36)`` with held targets."""
    found = []
    for make in (ThreadedPhysics, LanePhysics):
        physics = make(lean, len(qpos), 1)
        physics.reset(np.arange(len(qpos)), qpos, np.zeros((len(qpos), 35)))
        for _ in range(steps):
            physics.step(torch.from_numpy(np.repeat(ctrl[:, None], SUBSTEPS, 1)))
        found.append(physics.read()[0].numpy())
    return found


@needs_compiler
def test_motors_at_their_limit_do_not_damp(lean):
    """In the air, targets far away: the torques are cut off, on both alike."""
    rng = np.random.default_rng(0)
    qpos = np.tile(standing_qpos(), (N, 1))
    qpos[:, 2] = 3.0
    ctrl = g1.DEFAULT_POSE + rng.uniform(-0.6, 0.6, (N, 29))
    wrists = [g1.joint_index(f"{side}_wrist_yaw_joint") for side in ("left", "right")]
    ctrl[:, wrists] = 1.4  # 5 N m are not enough for this
    threaded, lanes = beside(lean, qpos, ctrl, 2)
    np.testing.assert_allclose(lanes, threaded, atol=1e-4)


@needs_compiler
def test_joints_stop_at_their_limits(lean):
    qpos = np.tile(standing_qpos(), (2, 1))
    qpos[:, 2] = 3.0
    ctrl = np.tile(g1.JOINT_UPPER + 0.4, (2, 1))
    threaded, lanes = beside(lean, qpos, ctrl, 25)
    for end in (threaded, lanes):
        assert np.all(end[:, 7:] < g1.JOINT_UPPER + 0.2)
    np.testing.assert_allclose(lanes[:, 7:], threaded[:, 7:], atol=0.05)


@needs_compiler
def test_a_fallen_robot_lies_on_the_ground(lean):
    """Parts that are not feet carry it, too: 0.1 m, the pelvis' size, stays free."""
    qpos = np.tile(standing_qpos(), (2, 1))
    qpos[:, 2] = 0.3
    qpos[0, 3:7] = [np.cos(np.pi / 4), 0, np.sin(np.pi / 4), 0]
    qpos[1, 3:7] = [np.cos(np.pi / 4), np.sin(np.pi / 4), 0, 0]
    threaded, lanes = beside(lean, qpos, np.tile(g1.DEFAULT_POSE, (2, 1)), 100)
    for end in (threaded, lanes):
        assert np.all((end[:, 2] > 0.03) & (end[:, 2] < 0.3))
    np.testing.assert_allclose(lanes[:, 2], threaded[:, 2], atol=0.06)


@needs_compiler
def test_loading_the_library_leaves_the_process_s_arithmetic_alone(lean):
    LanePhysics(lean, 1)
    assert np.float32(1e-40) * np.float32(0.5) > 0  # smaller than any normal number
    assert np.float64(1e-310) * 0.5 > 0


def test_a_model_with_more_than_lanes_know_is_refused(model):
    damped = copy.copy(model)
    damped.dof_damping[10] = 1.0
    with pytest.raises(InputError, match="neither damping nor dry friction"):
        LanePhysics(damped, 1)


def test_rough_ground_is_left_to_mujoco(capsys):
    terrain = build_terrain(("flat", "rough"), np.random.default_rng(0))
    model = build_training_model(terrain)
    physics = Hardware().make_physics(model, 1, 1)
    assert isinstance(physics, ThreadedPhysics)
    assert "flat ground" in capsys.readouterr().out
    with pytest.raises(InputError, match="flat ground"):
        Hardware("lanes").make_physics(model, 1, 1)


def test_without_a_compiler_mujoco_steps_the_robots(model, monkeypatch, capsys):
    monkeypatch.setenv("PATH", "")
    monkeypatch.delenv("CC", raising=False)
    assert isinstance(Hardware().make_physics(model, 1, 1), ThreadedPhysics)
    assert "no C compiler" in capsys.readouterr().out
    with pytest.raises(InputError, match="no C compiler"):
        Hardware("lanes").make_physics(model, 1, 1)
    with pytest.raises(InputError, match="no C compiler"):
        native.load(native.Path(native.__file__))


def test_what_does_not_compile_names_the_file(tmp_path, monkeypatch):
    if native.compiler() is None:
        pytest.skip("no C compiler on this machine")
    monkeypatch.setattr(native, "default_cache", lambda: tmp_path / "cache" / "clips")
    broken = tmp_path / "broken.c"
    broken.write_text("int f(void) { return x; }")
    with pytest.raises(InputError, match="does not compile") as caught:
        native.load(broken)
    assert "broken.c" in str(caught.value)


def test_flat_ground_is_stepped_in_lanes(model):
    if native.compiler() is None:
        pytest.skip("no C compiler on this machine")
    assert isinstance(Hardware().make_physics(model, 1, 1), LanePhysics)
    assert isinstance(Hardware("threaded").make_physics(model, 1, 1), ThreadedPhysics)
    assert mujoco.mjtGeom.mjGEOM_HFIELD not in model.geom_type
