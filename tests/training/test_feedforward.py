import mujoco
import numpy as np
import pytest
import torch

from openclone.motion.sources.synthetic import generate
from openclone.policy.teacher import LEGS
from openclone.robot import g1
from openclone.robot.model import standing_qpos
from openclone.training.data import load_reference
from openclone.training.data import make_task as build_task
from openclone.training.feedforward import feedforward
from openclone.training.reference import build_reference, generalized_velocities
from openclone.training.task_config import TaskConfig


def still(frames: int, height: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    qpos = np.tile(standing_qpos(), (frames, 1))
    qpos[:, 2] += height
    return qpos, np.zeros((frames, 35))


def test_nothing_is_added_in_free_fall(model):
    """A body that falls freely at rest needs no torque."""
    qpos, qvel = still(50, height=2.0)
    qvel[:, 2] = -9.81 * np.arange(50) / 50
    np.testing.assert_allclose(feedforward(model, qpos, qvel), 0.0, atol=1e-3)


def test_a_standing_robot_does_not_sink(model):
    """Simulated with contacts: the spring is bent beforehand by what it will carry."""
    qpos, qvel = still(5)
    offsets = feedforward(model, qpos, qvel)[2]
    data = mujoco.MjData(model)

    def sunk(gain: float) -> float:
        data.qpos[:], data.qvel[:] = qpos[0], 0.0
        data.ctrl[:] = qpos[0, 7:] + gain * offsets
        mujoco.mj_step(model, data, 60)
        return float(np.abs(data.qpos[7:19] - qpos[0, 7:19]).max())

    assert sunk(0.0) > 0.03
    assert sunk(1.0) < 0.3 * sunk(0.0)


def test_targets_alone_follow_a_walk_more_closely(model):
    """Open loop, without any policy: a fair test of the physics."""
    clip = generate("forward", np.random.default_rng(0))
    reference = build_reference([clip], model)
    data = mujoco.MjData(model)

    def error(gain: float) -> float:
        errors = []
        for first in range(50, 250, 40):
            data.qpos[:], data.qvel[:] = reference.qpos[first], reference.qvel[first]
            for frame in range(first + 1, first + 11):
                ahead = gain * reference.feedforward[frame].numpy()
                data.ctrl[:] = reference.qpos[frame, 7:] + ahead
                mujoco.mj_step(model, data, 4)
            legs = slice(7, 19)
            errors.append(data.qpos[legs] - reference.qpos[first + 10, legs])
        return float(np.sqrt(np.mean(np.square(errors))))

    assert error(1.0) < 0.6 * error(0.0)


def test_the_teachers_zero_is_the_feedforward(make_task, reference):
    plain, ahead = (make_task(2, guidance=kind) for kind in ("angles", "feedforward"))
    for task in (plain, ahead):
        task.jump_to(torch.tensor([3, 7]))
    nothing = torch.zeros(2, 29)
    wanted = reference.feedforward[[4, 8]]
    got = ahead.residual_to_target(nothing) - plain.residual_to_target(nothing)
    torch.testing.assert_close(got, wanted)
    assert float(reference.feedforward[[4, 8]].abs().max()) > 0.05
    ahead.step(ahead.residual_to_target(torch.full((2, 29), 0.5)))
    torch.testing.assert_close(ahead.action, torch.full((2, 29), 0.5))


def test_with_guided_arms_the_legs_keep_to_the_default_pose(make_task):
    kinds = ("pose", "arms", "feedforward")
    tasks = [make_task(2, guidance=kind) for kind in kinds]
    for task in tasks:
        task.jump_to(torch.tensor([3, 7]))
    pose, arms, ahead = (task.residual_to_target(torch.zeros(2, 29)) for task in tasks)
    torch.testing.assert_close(arms[:, LEGS], pose[:, LEGS])
    torch.testing.assert_close(arms[:, LEGS.stop :], ahead[:, LEGS.stop :])
    for other in (pose, ahead):
        assert not torch.allclose(arms, other)


def test_arms_and_waist_need_no_ground(model):
    qpos, qvel = still(5)
    qvel[:, 6:] = 0.3
    both = (feedforward(model, qpos, qvel, ground) for ground in (True, False))
    standing, flying = both
    np.testing.assert_array_equal(standing[:, 12:], flying[:, 12:])
    assert np.abs(standing - flying)[:, :12].max() > 0.01


def test_guidance_of_the_legs_needs_the_ground():
    clip = generate("forward", np.random.default_rng(0))
    flying = load_reference([clip], ground=False)
    build_task(flying, TaskConfig(num_envs=2, guidance="arms"), 0, 1)
    with pytest.raises(ValueError, match="needs a reference with `ground`"):
        build_task(flying, TaskConfig(num_envs=2, guidance="feedforward"), 0, 1)
    assert load_reference([clip]).grounded


def test_every_frame_has_finite_targets_within_the_motors_reach(model):
    qpos, _ = still(30)
    qpos[15:, 7 + g1.joint_index("left_knee_joint")] += 1.0  # a jump in the data
    offsets = feedforward(model, qpos, generalized_velocities(model, qpos))
    assert np.isfinite(offsets).all()
    assert (np.abs(offsets) <= g1.MAX_TORQUE / g1.KP + 1e-9).all()
