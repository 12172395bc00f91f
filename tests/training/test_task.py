import numpy as np
import torch
from scipy.spatial.transform import Rotation

from openclone.policy.teacher import TEACHER_SIZE, teacher_size
from openclone.robot import g1
from openclone.training.reward_table import RewardWeights
from openclone.training.task import TerminationLimits

CALM = {"push_speed": 0.0, "displaced_share": 0.0, "failure_share": 0.0}


def test_robots_start_on_the_reference(make_task, reference):
    task = make_task(8, **CALM)
    wanted = reference.at(task.frame)
    error = (task.robot_state().body_position - wanted.body_position).norm(dim=-1)
    assert float(error.max()) < 0.12
    heading = task.robot_state().body_quat[:, g1.ROOT]
    assert float((heading[:, 0].abs()).min()) > 0.999


def test_zero_residual_stands_for_a_while(make_task):
    task = make_task(4, **CALM)
    failures = 0
    for _ in range(10):
        result = task.step(task.residual_to_target(torch.zeros(4, 29)))
        failures += int(result.terminated.sum())
    assert failures == 0
    assert result.reward.min() > 0.05
    assert result.error < 0.1


def test_limp_robots_fail_and_are_reset(make_task):
    task = make_task(4, **CALM)
    fallen = torch.zeros(4, dtype=torch.bool)
    folded = torch.tensor(g1.DEFAULT_POSE, dtype=torch.float32).repeat(4, 1)
    folded[:, g1.joint_index("left_knee_joint")] = 2.5
    folded[:, g1.joint_index("right_knee_joint")] = 2.5
    for _ in range(100):
        result = task.step(folded)
        fallen |= result.terminated
        assert not (result.terminated & result.timed_out).any()
        ids = result.done
        height = task.robot_state().body_position[ids, g1.TORSO, 2]
        assert (height > 0.7).all()
    assert fallen.all()


def test_clip_end_is_a_time_out_not_a_failure(make_task, reference):
    task = make_task(4, limits=TerminationLimits(9, 9, 9, 9), **CALM)
    task.jump_to(reference.last[task.frame] - 1)
    task.age[:] = 0
    result = task.step(task.residual_to_target(torch.zeros(4, 29)))
    assert result.timed_out.all()
    assert not result.terminated.any()


def test_failing_bins_are_drawn_more_often(make_task):
    task = make_task(4, **{**CALM, "failure_share": 1.0})
    task.starts.failures[:] = 0.0
    task.starts.failures[6] = 50.0
    frames = task.starts.draw(2000)
    near = ((frames // 25) >= 5) & ((frames // 25) <= 7)
    assert float(near.float().mean()) > 0.6


def test_what_always_fails_does_not_take_all_the_time(make_task):
    task = make_task(4, **{**CALM, "failure_share": 1.0})
    starts = task.starts
    starts.failures[:], starts._visits[:] = 0.0, 1000.0
    starts.failures[1], starts.failures[5] = 900.0, 100.0
    bins = starts.draw(4000) // 25
    hopeless, hard = (int(((bins - at).abs() <= 1).sum()) for at in (1, 5))
    assert 0.7 < hard / hopeless < 1.4


def test_a_run_up_leads_to_the_hard_place(make_task, reference):
    task = make_task(4, run_up=75, **{**CALM, "failure_share": 1.0})
    task.starts.failures[:] = 0.0
    task.starts.failures[5] = 50.0
    frames = task.starts.draw(3000)
    before = 5 * 25 - frames
    assert float((before > 25).float().mean()) > 0.3
    task = make_task(4, run_up=25, **{**CALM, "failure_share": 1.0})
    task.starts.failures[:] = 0.0
    task.starts.failures[5] = 50.0
    assert float((5 * 25 - task.starts.draw(3000) > 25).float().mean()) < 0.3


def test_displaced_and_standing_starts(make_task, reference):
    task = make_task(
        32,
        push_speed=0.0,
        displaced_share=1.0,
        born_distance=0.5,
        born_heading=0.3,
    )
    wanted = reference.at(task.frame).body_position[:, g1.ROOT]
    offset = (task.robot_state().body_position[:, g1.ROOT] - wanted)[:, :2].norm(dim=-1)
    assert 0.2 < float(offset.mean()) < 0.5
    assert float(offset.max()) <= 0.51
    assert not task.step(task.residual_to_target(torch.zeros(32, 29))).terminated.any()


def test_same_seed_same_episodes(make_task):
    runs = []
    for _ in range(2):
        task = make_task(4)
        for _ in range(5):
            task.step(task.residual_to_target(torch.full((4, 29), 0.1)))
        runs.append(task.robot_state().joint_angles.numpy())
    np.testing.assert_array_equal(runs[0], runs[1])


def test_previous_action_is_in_units_of_the_residual(make_task):
    task = make_task(4, weights=RewardWeights(root_position=1.0), **CALM)
    task.age[:] = 0
    task.jump_to(torch.full((4,), 20))
    action = torch.full((4, 29), 0.25)
    task.step(task.residual_to_target(action))
    torch.testing.assert_close(task.action, action, atol=1e-5, rtol=0)


def test_the_teacher_previews_where_the_reference_will_be(make_task, reference):
    task = make_task(4, preview=(5, 400), **CALM)
    task.jump_to(torch.tensor([10, 20, 30, 40]))
    got = task.teacher_observation()
    assert got.shape == (4, teacher_size(2))
    for robot, frame in enumerate((10, 20, 30, 40)):
        state = task.robot_state()
        anchor = state.body_position[robot, g1.TORSO].numpy()
        w, x, y, z = state.body_quat[robot, g1.TORSO].tolist()
        turn = Rotation.from_quat([x, y, z, w]).as_matrix()
        # The second moment lies behind the end of the clip, where the clip holds.
        for moment, seen in enumerate((frame + 1 + 5, int(reference.last[frame]))):
            later = reference.at(torch.tensor([seen]))
            w, x, y, z = later.body_quat[0, g1.TORSO].tolist()
            bodies = [g1.TORSO, *g1.FEET]
            wanted = [
                *(later.body_position[0, bodies].numpy() - anchor),
                later.body_velocity[0, g1.TORSO].numpy(),
                Rotation.from_quat([x, y, z, w]).apply([1.0, 0.0, 0.0]),
            ]
            at = TEACHER_SIZE + 15 * moment
            np.testing.assert_allclose(
                got[robot, at : at + 15].numpy().reshape(5, 3) @ turn.T,
                wanted,
                atol=1e-5,
            )
    assert make_task(4, preview=(), **CALM).teacher_observation().shape[1] == (
        TEACHER_SIZE
    )
