"""World model and value gradients, beside MuJoCo and worked values."""

import math
from dataclasses import replace
from types import SimpleNamespace

import mujoco
import numpy as np
import pytest
import torch
from tensordict import TensorDict

from openclone.errors import InputError
from openclone.odometry.noise import OdometryNoiseConfig
from openclone.policy.moe import MoeConfig
from openclone.policy.student import StudentModel
from openclone.policy.teacher import COMMAND_SIZE
from openclone.robot import g1
from openclone.robot.model import SUBSTEPS, SensorLayout
from openclone.robot.state import read_state
from openclone.training.body_tree import BodyTree, as_sensed, soles
from openclone.training.checkpoint import load_checkpoint
from openclone.training.muon import Muon, orthogonalized
from openclone.training.pilots import StudentPilot, TeacherPilot
from openclone.training.ppo import PpoConfig, mlp_model
from openclone.training.presets import TEACHERS
from openclone.training.progress import Budget, Progress
from openclone.training.randomization import RandomizationConfig
from openclone.training.student_view import StudentView
from openclone.training.tally import Tally
from openclone.training.teacher import load_teacher, train_teacher
from openclone.training.teacher_view import TeacherEnvironment
from openclone.training.terrain import build_training_model
from openclone.training.value_gradient import Repetition, Tuner, ValueGradientConfig
from openclone.training.windows import roll_out
from openclone.training.world_model import (
    WorldLearner,
    WorldModel,
    _advance,
    _change,
)

CONFIG = ValueGradientConfig(
    steps=6, warm_up=2, warm_up_updates=2, width=32, world_batch=64, kept=500
)


@pytest.fixture(scope="module")
def tree(model):
    return BodyTree(model, torch.device("cpu"))


def random_states(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    qpos = rng.normal(size=(count, 36)) * 0.4
    qpos[:, 3] += 1.0
    qpos[:, 3:7] /= np.linalg.norm(qpos[:, 3:7], axis=1, keepdims=True)
    return qpos, rng.normal(size=(count, 35))


def tensors(*arrays):
    return tuple(torch.tensor(array, dtype=torch.float32) for array in arrays)


def student_pilot(task):
    noise, rng = OdometryNoiseConfig(), np.random.default_rng(0)
    view = StudentView(task, 5, noise, rng)
    return StudentPilot(view, StudentModel(MoeConfig(width=16), 5))


def network(seen, outputs):
    example = TensorDict({"seen": seen}, batch_size=[len(seen)])
    return mlp_model(example, "seen", outputs, PpoConfig(hidden=(16,)))


def teacher_pilot(task):
    guesses = 0.0 if task.config.view == "reference" else 1.0
    actor = network(task.teacher_observation(), 29)
    return TeacherPilot(TeacherEnvironment(task, guesses, 0), actor)


def make_tuner(
    make_task, folder, config=CONFIG, num_envs=4, pilot=student_pilot, **settings
):
    settings = {"view": "command", "guidance": "arms", **settings}
    task = make_task(num_envs, **settings)
    torch.manual_seed(0)
    seen = task.reference_observation()
    return Tuner(pilot(task), network(seen, 1), config, 0, folder)


def rolled(tuner, steps=None):
    random = torch.Generator().manual_seed(0)
    count, tally = steps or tuner.config.steps, Tally(tuner.pilot.task)
    return roll_out(tuner.pilot, count, 0.1, random, tally)


# Kinematics --------------------------------------------------------------------------


def test_the_tree_places_bodies_where_mujoco_does(model, tree):
    qpos, qvel = random_states(3)
    layout, data = SensorLayout.of(model), mujoco.MjData(model)
    found = tree(*tensors(qpos, qvel))
    for row in range(3):
        data.qpos[:], data.qvel[:] = qpos[row], qvel[row]
        mujoco.mj_forward(model, data)
        wanted = read_state(layout, *tensors(qpos[row], qvel[row], data.sensordata))
        for name in ("body_position", "body_velocity", "body_angular_velocity"):
            torch.testing.assert_close(
                getattr(found, name)[row], getattr(wanted, name), atol=2e-5, rtol=1e-5
            )
        same = (found.body_quat[row] * wanted.body_quat).sum(-1).abs()
        torch.testing.assert_close(same, torch.ones(14), atol=1e-5, rtol=0)


def test_soles_move_as_their_places_change(tree):
    qpos, qvel = random_states(1)
    model, later = build_training_model(), qpos[0].copy()
    mujoco.mj_integratePos(model, later, qvel[0], 1e-3)
    (before, speed), (after, _) = (
        soles(tree(*tensors(place[None], qvel))) for place in (qpos[0], later)
    )
    torch.testing.assert_close((after - before) / 1e-3, speed, atol=0.02, rtol=0.01)


def test_sensed_values_with_the_gradients_of_moving_bodies(tree):
    (qpos, qvel), (other, _) = (tensors(*random_states(2, seed)) for seed in (0, 1))
    qpos.requires_grad_()
    sensed = tree(other, qvel)
    sensed = replace(sensed, body_quat=-sensed.body_quat)
    joined = as_sensed(tree(qpos, qvel), sensed)
    torch.testing.assert_close(joined.body_position, sensed.body_position)
    torch.testing.assert_close(joined.body_quat, sensed.body_quat)
    joined.body_position[:, 0].sum().backward()
    torch.testing.assert_close(qpos.grad[:, :3], torch.ones(2, 3))


# World model -------------------------------------------------------------------------


def test_a_step_is_undone_by_its_change():
    model = build_training_model()
    data, (qpos, qvel) = mujoco.MjData(model), random_states(1)
    qpos[0, 2] = 2.0
    data.qpos[:], data.qvel[:] = qpos[0], qvel[0]
    for _ in range(SUBSTEPS):
        mujoco.mj_step(model, data)
    before = tensors(qpos, qvel)
    after = tensors(data.qpos[None], data.qvel[None])
    change = _change(*before, *after)
    # Gravity, seen from the root: nothing else acts on the centre of mass.
    assert change.abs().max() > 0.1
    for found, wanted in zip(_advance(*before, change), after, strict=True):
        torch.testing.assert_close(found, wanted, atol=1e-4, rtol=1e-4)


def falling(model, count: int) -> torch.Tensor:
    """Transitions of robots in the air that hold their pose."""
    rows, data = [], mujoco.MjData(model)
    qpos, qvel = random_states(count)
    qpos[:, 2], qpos[:, 7:] = 2.0, 0.2 * qpos[:, 7:]
    for place, speed in zip(qpos, 0.3 * qvel, strict=True):
        data.qpos[:], data.qvel[:], data.ctrl[:] = place, speed, place[7:]
        for _ in range(SUBSTEPS):
            mujoco.mj_step(model, data)
        rows.append(np.concatenate((place, speed, place[7:], data.qpos, data.qvel)))
    return tensors(np.stack(rows))[0]


def test_a_world_model_learns_what_mujoco_does(tree):
    torch.manual_seed(0)
    known = falling(build_training_model(), 300)
    learner = WorldLearner(WorldModel(tree, 64), 250, 64, 0)
    learner.add(known[:250])
    first = learner.learn(1, 3e-3)
    learner.learn(200, 3e-3)
    assert learner.learn(1, 3e-3) < 0.3 * first
    unseen = learner.model.errors(known[250:]).square().mean()
    assert unseen < 0.5
    height = known[250:, 2:3]
    qpos, _ = learner.model(*known[250:].split((36, 35, 29, 36, 35), 1)[:3])
    # They fall.
    assert (qpos[:, 2:3] - height).mean() < 0.0


def test_the_oldest_transitions_go(tree):
    learner = WorldLearner(WorldModel(tree, 8), 10, 4, 0)
    rows = falling(build_training_model(), 14)
    for part in rows.split((4, 4, 6)):
        learner.add(part)
    assert len(learner._buffer) == 10
    kept = {float(row[7]) for row in learner._buffer}
    assert kept == {float(row[7]) for row in rows[4:]}


# Steps -------------------------------------------------------------------------------


def test_orthogonal_steps_move_all_directions_alike():
    torch.manual_seed(0)
    matrix = torch.randn(8, 20) @ torch.diag(torch.logspace(0, -2, 20))
    sizes = torch.linalg.svdvals(orthogonalized(matrix))
    assert 0.6 < sizes.min() < sizes.max() < 1.3
    weight = torch.nn.Parameter(torch.zeros(8, 20))
    optimizer = Muon([weight], lr=0.01, momentum=0.9)
    weight.grad = matrix
    optimizer.step()
    assert weight.detach().square().mean().sqrt() == pytest.approx(0.01, rel=0.2)
    assert (weight.detach() * matrix).sum() < 0


# Repetition --------------------------------------------------------------------------


SEEN = {
    "student": (student_pilot, {}),
    "teacher": (teacher_pilot, {}),
    "teacher, legs": (teacher_pilot, {"view": "legs", "guidance": "springs"}),
    "teacher, reference": (teacher_pilot, {"view": "reference"}),
}


@pytest.mark.parametrize(("pilot", "kind"), SEEN.values(), ids=SEEN)
def test_a_repetition_sees_and_earns_what_the_robots_did(
    make_task, tmp_path, pilot, kind
):
    tuner = make_tuner(
        make_task, tmp_path, pilot=pilot, push_interval=0.2, episode_steps=5, **kind
    )
    if pilot is student_pilot:
        tuner.pilot.view.error[:] = 0.05
    seen = []
    tuner.pilot.network.register_forward_pre_hook(lambda _, args: seen.append(args[0]))
    window = rolled(tuner)
    assert window.cut.any()
    assert not window.cut.all()
    repetition = Repetition(tuner, window)
    rewards = torch.stack([repetition._step(step) for step in range(CONFIG.steps)])
    there, again = seen[: CONFIG.steps], seen[CONFIG.steps :]
    for wanted, found in zip(there, again, strict=True):
        torch.testing.assert_close(found, wanted, atol=2e-5, rtol=1e-5)
    straight = ~window.cut
    torch.testing.assert_close(
        rewards[straight], window.reward[straight], atol=1e-4, rtol=1e-4
    )


def test_guesses_of_a_teacher_are_wrong_and_told(make_task, tmp_path):
    tuner = make_tuner(make_task, tmp_path, pilot=teacher_pilot)
    error = rolled(tuner).error
    assert error.shape == (6, 4, COMMAND_SIZE)
    wrong = error.abs().amax((0, 1)) > 1e-4
    assert 6 <= wrong.sum() <= 9


def test_the_gain_is_the_discounted_return(make_task, tmp_path):
    tuner = make_tuner(make_task, tmp_path, push_speed=0.0)
    window = rolled(tuner)
    window.cut[:] = False
    window.cut[2, 1] = True
    values = tuner.value(window.privileged.flatten(0, 1)).view(7, 4).detach()
    expected = 0.0
    for robot in range(4):
        weight = 1.0
        for step in range(6):
            if window.cut[step, robot]:
                expected += weight * values[step, robot]
                weight = 1.0
                continue
            expected += weight * window.reward[step, robot]
            weight *= 0.99
        expected += weight * values[6, robot]
    gain = Repetition(tuner, window).gain()
    torch.testing.assert_close(gain.detach(), expected / 4, atol=2e-3, rtol=1e-3)


def test_returns_stop_at_falls_and_bootstrap_elsewhere(make_task, tmp_path):
    tuner = make_tuner(make_task, tmp_path, push_speed=0.0)
    window = rolled(tuner)
    tuner.value = lambda seen: torch.full((len(seen),), 10.0)
    window.reward[:] = 1.0
    for flags in (window.cut, window.ended, window.terminated):
        flags[:] = False
    window.cut[5, :2] = True
    window.terminated[5, 0] = True
    returns = tuner._returns(window)
    assert returns[5].tolist() == pytest.approx([1.0, 10.9, 10.9, 10.9])
    # TD(λ): 1 + 0.99 (0.05 x 10 + 0.95 x the return that follows).
    assert returns[4, 0].item() == pytest.approx(1 + 0.99 * (0.5 + 0.95 * 1.0))


def test_nothing_flows_back_through_a_cut(make_task, tmp_path):
    tuner = make_tuner(make_task, tmp_path, push_speed=0.0)
    tuner.learn_physics(rolled(tuner))
    window = rolled(tuner)
    window.cut[:] = False
    window.cut[3] = True
    repetition = Repetition(tuner, window)
    for step in range(3):
        repetition._step(step)
    assert repetition._qpos.requires_grad
    early = repetition._qpos
    repetition._step(3)
    leak = torch.autograd.grad(
        repetition._robot.body_position.sum(), early, allow_unused=True
    )[0]
    assert leak is None or not leak.any()


def test_gradients_are_bounded_robot_by_robot(make_task, tmp_path):
    config = replace(CONFIG, bound=1e-3)
    tuner = make_tuner(make_task, tmp_path, config, push_speed=0.0)
    window = rolled(tuner)
    repetition = Repetition(tuner, window)
    foreseen = torch.zeros(4, 36, requires_grad=True)
    went = repetition._went(window.qpos[0], foreseen, torch.ones(4, 1))
    torch.testing.assert_close(went, window.qpos[0])
    slope = torch.zeros(4, 36)
    slope[0, 0], slope[1, 0], slope[2, 0] = 5.0, 1e-5, torch.nan
    (went * slope).sum().backward()
    assert foreseen.grad[:, 0].tolist() == pytest.approx([2.5e-4, 1e-5, 0.0, 0.0])


@pytest.mark.parametrize("pilot", [student_pilot, teacher_pilot])
def test_the_gradient_lowers_arms_that_are_held_too_high(make_task, tmp_path, pilot):
    config = replace(CONFIG, warm_up_updates=10, std=0.1, world_rate=1e-3)
    tuner = make_tuner(
        make_task, tmp_path, config, num_envs=16, pilot=pilot, push_speed=0.0
    )
    names = ("left_shoulder_pitch_joint", "right_shoulder_pitch_joint")
    shoulders = [g1.joint_index(name) for name in names]
    (bias,) = (p for p in tuner.pilot.network.parameters() if p.shape == (29,))
    for side in (1.5, -1.5):
        with torch.no_grad():
            bias[shoulders] = side
        for _ in range(12):
            tuner.learn_physics(rolled(tuner))
        bias.grad = None
        Repetition(tuner, rolled(tuner)).gain().backward()
        assert (
            torch.sign(bias.grad[shoulders]) == -torch.sign(torch.tensor(side))
        ).all()


def test_a_round_moves_policy_and_average(make_task, tmp_path):
    tuner = make_tuner(make_task, tmp_path, push_speed=0.0)
    progress = Progress(tmp_path, Budget(1.0, 2))
    before = tuner.pilot.network.head.weight.clone()
    for _ in range(CONFIG.warm_up):
        tuner.round(progress)
    assert torch.equal(tuner.pilot.network.head.weight, before)
    tuner.round(progress)
    progress.close()
    assert progress.iterations == 1
    assert progress.steps == 3 * 6 * 4
    step = tuner.pilot.network.head.weight - before
    # Directions of which the gradient knows nothing do not move.
    assert 0.1 * CONFIG.rate < step.square().mean().sqrt() < 1.2 * CONFIG.rate
    averaged = tuner.average.head.weight - before
    torch.testing.assert_close(averaged, 0.03 * step, atol=1e-7, rtol=1e-2)


def test_uneven_ground_is_refused(make_task, tmp_path):
    uneven = RandomizationConfig(terrain=("flat", "rough"))
    task = SimpleNamespace(config=SimpleNamespace(randomization=uneven))
    with pytest.raises(InputError, match="need flat ground"):
        Tuner(SimpleNamespace(task=task), None, CONFIG, 0, tmp_path)


def test_a_teacher_goes_on_by_value_gradients(trained, make_clip, tmp_path):
    path, clips, smoke = tmp_path / "teacher.pt", [make_clip()], TEACHERS["smoke"]
    before = load_checkpoint(trained[1])

    def tuned(iterations, **settings):
        preset = replace(smoke, tuning_iterations=iterations)
        train_teacher(
            clips, preset, tmp_path, tuning_minutes=math.inf, threads=1, **settings
        )
        content, state = load_checkpoint(path), load_checkpoint(tmp_path / "tuning.pt")
        return content, state["newest"], state["tuner"]

    content, newest, state = tuned(1, minutes=0, start=trained[1])
    # A roll-out for the world model alone, then one after which the weights move.
    assert (content["iterations"], content["steps"]) == (1, before["steps"] + 2 * 64)
    assert content["phase"] == "tuning"
    actor, first = (
        part["ppo"]["actor_state_dict"]["mlp.0.weight"] for part in (content, before)
    )
    average = state["average"]["0.weight"]
    assert torch.equal(actor, average)
    step = newest["0.weight"] - first
    assert step.abs().max() > 0
    torch.testing.assert_close(average - first, 0.03 * step, atol=1e-7, rtol=1e-2)
    load_teacher(path, smoke.tuning_task)
    again, last, state = tuned(2, resume=True)
    assert (again["iterations"], again["phase"]) == (2, "tuning")
    assert state["world"]["optimizer"]["state"][0]["step"] == 2 + 1 + 2 + 1
    assert 0 < (last["0.weight"] - newest["0.weight"]).abs().max() < 1e-3
