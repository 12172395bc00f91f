"""The student's observation: hand-worked values, invariances, NumPy against torch."""

from __future__ import annotations

import math
from dataclasses import fields, replace

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from openclone.policy import observation
from openclone.policy.command import Command, KeyPoints
from openclone.policy.observation import History, Proprioception
from openclone.robot import g1
from openclone.spatial import rotations

# Where the groups of the task part begin (module docstring of `observation`).
DIFFERENCE, POSITION, VELOCITY, WRISTS, TARGET_WRISTS, HEAD = 0, 9, 18, 27, 39, 51


def quats(rng: np.random.Generator, *shape: int) -> np.ndarray:
    return rotations.normalize(rng.standard_normal((*shape, 4)))


def scene(rng: np.random.Generator, *batch: int) -> tuple[Command, KeyPoints]:
    """A random command and measurement less than a metre apart."""
    position = rng.uniform(-3, 3, (*batch, 3, 3))
    measured = KeyPoints(position, quats(rng, *batch, 3))
    target = position + rng.uniform(-0.5, 0.5, (*batch, 3, 3))
    velocity = rng.standard_normal((*batch, 3, 3))
    command = Command(KeyPoints(target, quats(rng, *batch, 3)), velocity)
    return command, measured


def sensors(rng: np.random.Generator, *batch: int) -> Proprioception:
    return Proprioception(
        joint_angles=rng.standard_normal((*batch, 29)),
        joint_velocities=rng.standard_normal((*batch, 29)),
        angular_velocity_b=rng.standard_normal((*batch, 3)),
        base_quat=quats(rng, *batch),
    )


def to_torch(item):
    """The same dataclass with torch tensors instead of arrays."""
    if isinstance(item, np.ndarray):
        return torch.from_numpy(item)
    if isinstance(item, float):
        return item
    return type(item)(
        **{field.name: to_torch(getattr(item, field.name)) for field in fields(item)}
    )


def test_sizes_are_those_of_the_paper_and_the_head() -> None:
    # q, dq, previous action: 29 each; angular velocity and gravity: 3 each.
    assert observation.FRAME_SIZE == 29 * 3 + 6
    # Per point: difference, target, velocity (3 each) and two 6D rotations, of which
    # the paper has those of the wrists alone.
    assert observation.TASK_SIZE == 3 * 9 + 2 * 12 + 12
    assert observation.HISTORY == 25
    assert observation.student_size() == 63 + 25 * 93


def test_task_part_by_hand() -> None:
    """A robot facing +Y (yaw 90 degrees): ahead is world Y, its left is world -X."""
    heading = rotations.from_yaw(np.array(math.pi / 2))
    upright = np.tile(rotations.IDENTITY, (3, 1))
    measured = KeyPoints(
        np.array([[10.0, 20.0, 1.2], [9.8, 20.3, 0.9], [10.2, 20.3, 0.9]]), upright
    )
    target = KeyPoints(
        np.array([[10.0, 20.1, 1.3], [9.8, 20.3, 0.9], [10.2, 20.8, 0.9]]),
        np.stack((upright[0], heading, upright[0])),
    )
    velocity = np.array([[0.0, 1.0, 0.0], [-0.4, 0.0, 0.0], [0.0, 0.0, 0.2]])
    part = observation.task(Command(target, velocity), measured, heading)
    assert part.shape == (63,)
    difference = part[DIFFERENCE:POSITION].reshape(3, 3)
    # The head goes 0.1 m ahead and 0.1 m up, the right hand half a metre ahead.
    assert np.allclose(difference, [[0.1, 0, 0.1], [0, 0, 0], [0.5, 0, 0]])
    position = part[POSITION:VELOCITY].reshape(3, 3)
    # Below the target head is (10, 20.1, 0); the left hand is 0.2 m to the left.
    assert np.allclose(position, [[0, 0, 1.3], [0.2, 0.2, 0.9], [0.7, -0.2, 0.9]])
    speeds = part[VELOCITY:WRISTS].reshape(3, 3) / observation._VELOCITY_SCALE
    assert np.allclose(speeds, [[1, 0, 0], [0, 0.4, 0], [0, 0, 0.2]])
    # Seen from the heading frame an upright wrist is turned by -90 degrees: its x axis
    # points right (-y), its y axis ahead (x).
    right_turned = [0, -1, 0, 1, 0, 0]
    assert np.allclose(part[WRISTS:TARGET_WRISTS], right_turned * 2)
    straight = [1, 0, 0, 0, 1, 0]
    assert np.allclose(part[TARGET_WRISTS:HEAD], straight + right_turned)
    assert np.allclose(part[HEAD:], right_turned * 2)


def test_a_free_look_is_not_told_and_changes_nothing_else() -> None:
    rng = np.random.default_rng(3)
    command, measured = scene(rng, 4)
    ahead = rotations.heading(quats(rng, 4))
    told = observation.task(command, measured, ahead)
    look = np.array([1.0, 0.0, 1.0, 0.0])
    part = observation.task(replace(command, look=look), measured, ahead)
    assert np.array_equal(part[[0, 2]], told[[0, 2]])
    assert np.array_equal(part[[1, 3], :HEAD], told[[1, 3], :HEAD])
    assert not part[[1, 3], HEAD:].any()
    elsewhere = quats(rng, 4, 3)
    elsewhere[:, 1:] = command.target.quat[:, 1:]
    turned = replace(command, target=replace(command.target, quat=elsewhere))
    other = observation.task(replace(turned, look=look), measured, ahead)
    assert np.array_equal(other[[1, 3]], part[[1, 3]])
    assert np.abs(other - part)[[0, 2], HEAD + 6 :].min(axis=1).max() > 0.0


def test_horizontal_differences_end_at_a_metre() -> None:
    rng = np.random.default_rng(0)
    command, measured = scene(rng)
    far = measured.position + np.array([[3.0, -4.0, 2.0], [0.5, 0, 0], [0, 0, -3.0]])
    far_command = Command(KeyPoints(far, measured.quat), command.velocity)
    ahead = np.array(rotations.IDENTITY)
    part = observation.task(far_command, measured, ahead)
    difference = part[:POSITION].reshape(3, 3)
    assert np.allclose(difference, [[1, -1, 2], [0.5, 0, 0], [0, 0, -3]])


@given(
    st.integers(0, 10_000),
    st.floats(-3.1, 3.1),
    st.floats(-50, 50),
    st.floats(-50, 50),
)
def test_task_ignores_where_the_world_begins(seed, turn, x, y) -> None:
    """Turning and moving robot, operator and goal together changes nothing."""
    rng = np.random.default_rng(seed)
    command, measured = scene(rng)
    heading = rotations.from_yaw(np.array(rng.uniform(-3, 3)))
    before = observation.task(command, measured, heading)
    q_new_from_old = rotations.from_yaw(np.array(turn))
    rotation = Rotation.from_euler("z", turn)

    def moved(points: KeyPoints) -> KeyPoints:
        position = rotation.apply(points.position) + np.array([x, y, 0])
        every = np.tile(q_new_from_old, (3, 1))
        return KeyPoints(position, rotations.multiply(every, points.quat))

    after = observation.task(
        Command(moved(command.target), rotation.apply(command.velocity)),
        moved(measured),
        rotations.multiply(q_new_from_old, heading),
    )
    assert np.allclose(before, after, atol=1e-6)


@given(st.integers(0, 10_000), st.floats(0.05, 1.0))
def test_task_does_not_ignore_height(seed, rise) -> None:
    """Heights are absolute: the floor is where the robot's feet are."""
    command, measured = scene(np.random.default_rng(seed))
    ahead = np.array(rotations.IDENTITY)
    low = observation.task(command, measured, ahead)
    up = np.array([0, 0, rise])
    target = KeyPoints(command.target.position + up, command.target.quat)
    raised = KeyPoints(measured.position + up, measured.quat)
    high = observation.task(Command(target, command.velocity), raised, ahead)
    heights = (high - low)[POSITION:VELOCITY].reshape(3, 3)
    assert np.allclose(heights, up)
    assert np.allclose(np.delete(high - low, [11, 14, 17]), 0, atol=1e-12)


@given(st.integers(0, 10_000), st.floats(-3.1, 3.1))
def test_gravity_is_down_and_blind_to_heading(seed, turn) -> None:
    quat = quats(np.random.default_rng(seed))
    down = Rotation.from_quat(np.roll(quat, -1)).inv().apply([0, 0, -1])
    assert np.allclose(observation.gravity_b(quat), down, atol=1e-9)
    turned = rotations.multiply(rotations.from_yaw(np.array(turn)), quat)
    assert np.allclose(observation.gravity_b(turned), down, atol=1e-9)


def test_frame_by_hand() -> None:
    now = Proprioception(
        joint_angles=g1.DEFAULT_POSE + np.arange(29) / 100,
        joint_velocities=np.full(29, 2.0),
        angular_velocity_b=np.array([0.0, 0.0, 4.0]),
        base_quat=np.array(rotations.IDENTITY),
    )
    frame = observation.frame(now, np.full(29, 0.6), g1.DEFAULT_POSE)
    assert frame.shape == (observation.FRAME_SIZE,)
    assert np.allclose(frame[:29], np.arange(29) / 100)
    assert np.allclose(frame[29:58], 0.1)
    assert np.allclose(frame[58:64], [0, 0, 1, 0, 0, -1])
    assert np.allclose(frame[64:], 0.3)


def test_history_keeps_the_newest_first() -> None:
    history = History(np.full(93, 0.0))
    assert np.array_equal(history.flat(), np.zeros(25 * 93))
    for number in range(1, 31):
        history.push(np.full(93, float(number)))
    # 30 frames were pushed into room for 25: 30, 29, ... 6 remain.
    assert np.array_equal(history.frames[:, 0], np.arange(30, 5, -1))
    assert np.array_equal(history.flat()[:93], np.full(93, 30.0))
    whole = observation.student(np.full(63, -1.0), history)
    assert whole.shape == (observation.student_size(),)
    assert np.array_equal(whole[:64], [*[-1.0] * 63, 30.0])


def test_history_restarts_only_where_an_episode_ended() -> None:
    history = History(np.zeros((4, 93)))
    history.push(np.ones((4, 93)))
    history.refill(np.array([1, 3]), np.full((2, 93), 7.0))
    assert np.array_equal(history.frames[[1, 3]], np.full((2, 25, 93), 7.0))
    assert np.array_equal(history.frames[0, :2, 0], [1, 0])


def test_numpy_and_torch_see_the_same() -> None:
    """The training task's batch and the loop's single robot share one definition."""
    rng = np.random.default_rng(5)
    batch = 6
    heading = rotations.heading(quats(rng, batch))
    history = twin_history = None
    for _ in range(30):
        command, measured = scene(rng, batch)
        now, action = sensors(rng, batch), rng.standard_normal((batch, 29))
        frame = observation.frame(now, action, g1.DEFAULT_POSE)
        twin = observation.frame(
            to_torch(now), to_torch(action), to_torch(g1.DEFAULT_POSE)
        )
        if history is None or twin_history is None:
            history, twin_history = History(frame), History(twin)
        history.push(frame)
        twin_history.push(twin)
    task = observation.task(command, measured, heading)
    whole = observation.student(task, history)
    twin_task = observation.task(
        to_torch(command), to_torch(measured), to_torch(heading)
    )
    twin_whole = observation.student(twin_task, twin_history)
    assert whole.shape == (batch, observation.student_size())
    assert np.allclose(twin_whole.numpy(), whole, atol=1e-12)
    for index in range(batch):
        single = observation.task(
            Command(
                KeyPoints(command.target.position[index], command.target.quat[index]),
                command.velocity[index],
            ),
            KeyPoints(measured.position[index], measured.quat[index]),
            heading[index],
        )
        assert np.allclose(single, task[index], atol=1e-12)


def test_default_pose_is_float32() -> None:
    pose = observation.default_pose()
    assert pose.dtype == np.float32
    assert pose == pytest.approx(g1.DEFAULT_POSE)
