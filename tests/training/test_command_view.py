"""Teachers that see of the motion what students see: head and hands, nothing else."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from openclone.errors import InputError
from openclone.odometry.noise import OdometryNoiseConfig
from openclone.policy.command import command_of
from openclone.policy.observation import HISTORY, TASK_SIZE
from openclone.policy.teacher import (
    COMMAND_SIZE,
    LEGS_SIZE,
    command_observation,
    legs_observation,
)
from openclone.robot import g1
from openclone.spatial import rotations
from openclone.training import student as student_module
from openclone.training.presets import STUDENTS, TEACHERS
from openclone.training.student import train_student
from openclone.training.student_view import StudentView
from openclone.training.teacher import load_teacher, train_teacher
from openclone.training.teacher_view import CRITIC, GROUP, TeacherEnvironment

VIEW = {"view": "command", "guidance": "pose"}
CALM = {"push_speed": 0.0, "displaced_share": 0.0, "failure_share": 0.0, **VIEW}


def test_teacher_and_student_have_the_same_task(make_task):
    task = make_task(4, **CALM)
    perfect = OdometryNoiseConfig(c_vel=np.inf, c_min=0.0)
    view = StudentView(task, HISTORY, perfect, np.random.default_rng(0))
    seen = task.teacher_observation()
    assert seen.shape == (4, COMMAND_SIZE)
    torch.testing.assert_close(seen[:, :TASK_SIZE], view.observe()[:, :TASK_SIZE])
    action = 0.3 * torch.randn(4, 29, generator=torch.Generator().manual_seed(0))
    torch.testing.assert_close(task.residual_to_target(action), view.to_target(action))
    task.step(task.residual_to_target(action))
    torch.testing.assert_close(task.action, action, atol=1e-5, rtol=0)


def test_some_operators_look_around_freely(make_task):
    """Their robots' students and teachers are not told where; all else is the same."""
    tasks = {share: make_task(64, look_share=share, **CALM) for share in (0.0, 0.5, 1)}
    seen = {share: task.teacher_observation() for share, task in tasks.items()}
    head = slice(TASK_SIZE - 12, TASK_SIZE)
    assert not seen[0.0][:, head].any()
    assert (seen[1][:, head].norm(dim=1) > 1.9).all()  # two rotations of length √2
    told = tasks[0.5].command().look == 1.0
    assert 16 < int(told.sum()) < 48
    torch.testing.assert_close(seen[0.5][told], seen[1][told])
    torch.testing.assert_close(seen[0.5][~told], seen[0.0][~told])
    for values in seen.values():
        values[:, head] = 0.0
    torch.testing.assert_close(seen[1], seen[0.0])


def test_the_head_s_orientation_is_the_reference_s(make_task):
    task = make_task(4, look_share=1.0, **CALM)
    robot, wanted = task.robot_state(), task.next_reference()
    back = rotations.conjugate(rotations.heading(robot.body_quat[:, g1.ROOT]))
    expected = [
        rotations.to_6d(rotations.multiply(back, state.body_quat[:, g1.TORSO]))
        for state in (robot, wanted)
    ]
    seen = task.teacher_observation()[:, TASK_SIZE - 12 : TASK_SIZE]
    torch.testing.assert_close(seen, torch.cat(expected, 1), atol=1e-5, rtol=0)


def test_the_reference_s_legs_are_not_seen(make_task):
    task = make_task(4, **CALM)
    robot, reference = task.robot_state(), task.next_reference()
    before = command_observation(robot, command_of(reference), task.action)
    legs = list(range(1, g1.TORSO))
    moved = reference.body_position.clone()
    moved[:, legs] += 0.3
    other = replace(
        reference,
        body_position=moved,
        joint_angles=reference.joint_angles + 0.5,
        joint_velocities=reference.joint_velocities + 1.0,
    )
    after = command_observation(robot, command_of(other), task.action)
    torch.testing.assert_close(after, before)
    moved[:, g1.TORSO] += 0.1
    assert not torch.allclose(
        command_observation(robot, command_of(other), task.action), before
    )


def test_with_the_legs_in_view_they_are_seen_and_nothing_else_changes(make_task):
    task = make_task(4, **{**CALM, "view": "legs"})
    robot, reference = task.robot_state(), task.next_reference()
    seen = task.teacher_observation()
    assert seen.shape == (4, COMMAND_SIZE + LEGS_SIZE)
    told = command_observation(robot, task.command(), task.action)
    torch.testing.assert_close(seen[:, :COMMAND_SIZE], told)
    legs = seen[:, COMMAND_SIZE:]
    default = torch.tensor(g1.DEFAULT_POSE[:15], dtype=legs.dtype)
    torch.testing.assert_close(legs[:, :15], reference.joint_angles[:, :15] - default)
    left, pelvis = (reference.body_position[:, k] for k in (g1.FEET[0], g1.ROOT))
    heading = rotations.heading(robot.body_quat[:, g1.ROOT])
    foot = rotations.rotate_inverse(heading, left - pelvis)
    torch.testing.assert_close(legs[:, 36:39], foot)
    torch.testing.assert_close(legs[:, -1], pelvis[:, 2])


@pytest.mark.parametrize("view", ["command", "legs"])
def test_neither_place_nor_heading_matters(make_task, view):
    task = make_task(4, **CALM)
    turn = rotations.from_yaw(torch.tensor(1.1))
    shift = torch.tensor([3.0, -2.0, 0.0])

    def moved(state):
        quat = turn.expand_as(state.body_quat)
        whole = turn.expand(4, 2, 4)
        return replace(
            state,
            body_position=rotations.rotate(quat, state.body_position) + shift,
            body_quat=rotations.multiply(quat, state.body_quat),
            body_velocity=rotations.rotate(quat, state.body_velocity),
            body_angular_velocity=rotations.rotate(quat, state.body_angular_velocity),
            foot_force=rotations.rotate(whole, state.foot_force),
        )

    def look(change):
        robot, reference = change(task.robot_state()), change(task.next_reference())
        if view == "legs":
            return legs_observation(robot, reference)
        return command_observation(robot, command_of(reference), task.action)

    torch.testing.assert_close(
        look(moved), look(lambda state: state), atol=1e-5, rtol=1e-5
    )


def test_the_critic_sees_the_whole_reference(make_task):
    task = make_task(4, **CALM)
    groups = TeacherEnvironment(task).observe()
    assert groups[GROUP].shape[1] == COMMAND_SIZE
    torch.testing.assert_close(groups[CRITIC], task.reference_observation())
    assert groups[CRITIC].shape[1] != COMMAND_SIZE
    assert CRITIC not in TeacherEnvironment(make_task(4)).observe()


def test_training_end_to_end_and_other_views_are_refused(
    make_clip, tmp_path, monkeypatch
):
    monkeypatch.setattr(student_module, "export_bundle", lambda *_: None)
    clips, smoke = [make_clip()], TEACHERS["smoke"]
    preset = replace(smoke, task=replace(smoke.task, **VIEW))
    path = train_teacher(clips, preset, tmp_path, threads=1)
    assert load_teacher(path, preset.task).obs_dim == COMMAND_SIZE
    train_teacher(clips, preset, tmp_path / "on", start=path, threads=1)
    legs = replace(preset, task=replace(preset.task, view="legs"))
    wider = train_teacher(clips, legs, tmp_path / "legs", threads=1)
    assert load_teacher(wider, legs.task).obs_dim == COMMAND_SIZE + LEGS_SIZE
    with pytest.raises(InputError, match="view is 'command', the task's 'reference'"):
        train_teacher(clips, smoke, tmp_path / "other", start=path, threads=1)
    student = STUDENTS["smoke"]
    alike = replace(
        student,
        task=replace(student.task, **VIEW),
        tuning_task=replace(student.tuning_task, **VIEW),
    )
    train_student(clips, path, alike, tmp_path, threads=1)
    with pytest.raises(InputError, match="view is 'command', the task's 'reference'"):
        train_student(clips, path, student, tmp_path / "other", threads=1)


@pytest.mark.parametrize("name", list(STUDENTS))
def test_students_look_as_their_teachers_do(name):
    """Labels and the critic come from the teacher: its view and guidance are theirs."""
    student = STUDENTS[name]
    teachers = TEACHERS[student.teacher or (name if name in TEACHERS else "fast")]
    for task in (student.task, student.tuning_task):
        if name == "paper" and task is student.tuning_task:
            continue  # the paper has no such phase
        assert (task.view, task.guidance) == (
            teachers.task.view,
            teachers.task.guidance,
        )
