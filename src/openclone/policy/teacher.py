"""What the privileged teacher sees (section 3.1).

Either the whole reference motion, or only what the student is told of it, so that both
have the same task; or that and the reference's legs. Head and hands tell most about
these, but PPO does not find that by itself.
"""

from __future__ import annotations

import torch

from openclone.policy import observation
from openclone.policy.command import Command, KeyPoints
from openclone.policy.constants import Constant
from openclone.policy.observation import TASK_SIZE, gravity_b
from openclone.robot import g1
from openclone.robot.state import RobotState, key_point_poses
from openclone.spatial import rotations

TEACHER_SIZE = 5 * g1.NUM_JOINTS + 9 * len(g1.KEY_BODIES) + 33
"""Values of the observation as the paper lists it."""
COMMAND_SIZE = TASK_SIZE + 3 * g1.NUM_JOINTS + 28
"""Values of the observation without the reference."""
LEGS = slice(0, 15)
"""Legs and waist among the joints."""
LEGS_SIZE = 2 * 15 + 6 * 3 + 3
"""Values of the reference's legs."""
PREVIEW_SIZE = 15
"""Values for every moment of the preview."""
_PLACES = 3
"""The first of its vectors are places, the others are not."""


def teacher_size(moments: int) -> int:
    """Values of an observation whose preview has so many moments."""
    return TEACHER_SIZE + PREVIEW_SIZE * moments


def evenly_spaced(bodies: tuple[int, ...]) -> slice:
    """``bodies`` as a slice: picking by a list takes ten times as long.

    Raises:
        ValueError: they do not lie at even distances.
    """
    first, step = bodies[0], bodies[1] - bodies[0]
    chosen = slice(first, bodies[-1] + 1, step)
    if tuple(range(len(g1.KEY_BODIES)))[chosen] != tuple(bodies):
        raise ValueError(f"bodies at uneven distances: {bodies}")
    return chosen


_FEET = evenly_spaced(g1.FEET)
_KNEES = evenly_spaced(tuple(foot - 1 for foot in g1.FEET))
_DEFAULT_POSE = Constant(g1.DEFAULT_POSE)


def teacher_observation(
    robot: RobotState, reference: RobotState, action: torch.Tensor
) -> torch.Tensor:
    """The observation o^tea, ``(n, d)``.

    All body quantities stand in the torso frame, so that neither place nor heading
    matters. Contents: reference joint angles and velocities at t + 1; orientation
    difference and velocities of the reference torso; the robot's own joints,
    velocities, gravity and foot loads; the previous action; key bodies of robot and
    reference; differences of their velocities.

    Args:
        robot: current states.
        reference: reference states at t + 1.
        action: (n, 29), previous action, residual units.
    """
    torso = g1.TORSO
    anchor = robot.body_position[:, torso : torso + 1]
    turn = robot.body_quat[:, torso]
    default = _DEFAULT_POSE.like(turn)
    bodies, here = len(g1.KEY_BODIES), slice(torso, torso + 1)
    # All vectors are turned at once: many small operations take longer.
    vectors = (
        reference.body_velocity[:, here],
        reference.body_angular_velocity[:, here],
        robot.body_velocity[:, here],
        robot.body_angular_velocity[:, here],
        robot.body_position - anchor,
        reference.body_position - anchor,
        reference.body_velocity - robot.body_velocity,
    )
    turned = _turned_back(turn, torch.cat(vectors, 1))
    sizes = (1, 1, 1, 1, bodies, bodies, bodies)
    wanted_velocity, wanted_spin, velocity, spin, robot_at, wanted_at, lag = (
        part.flatten(1) for part in turned.split(sizes, 1)
    )

    relative = rotations.multiply(
        rotations.conjugate(turn), reference.body_quat[:, torso]
    )
    parts = (
        reference.joint_angles - default,
        reference.joint_velocities * 0.05,
        rotations.to_6d(relative),
        wanted_velocity,
        wanted_spin * 0.25,
        robot.joint_angles - default,
        robot.joint_velocities * 0.05,
        velocity,
        spin * 0.25,
        gravity_b(robot.body_quat[:, g1.ROOT]),
        robot.foot_force.flatten(1).clamp(-1000, 1000) / 300.0,
        robot.body_velocity[:, _FEET].flatten(1),
        action * 0.5,
        robot_at,
        wanted_at,
        lag * 0.5,
    )
    return torch.cat(parts, -1)


def command_observation(
    robot: RobotState, command: Command, action: torch.Tensor
) -> torch.Tensor:
    """The student's task part and the robot's true state, ``(n, COMMAND_SIZE)``.

    Contents: `observation.task`; velocity and height of the root; gravity and angular
    velocity; joints and their velocities; the previous action; loads, places and
    velocities of the feet. Vectors stand in the robot's heading frame.

    Args:
        robot: current states.
        command: targets for t + 1.
        action: (n, 29), previous action, student units.
    """
    root = robot.body_quat[:, g1.ROOT]
    heading = rotations.heading(root)
    measured = KeyPoints(*key_point_poses(robot.body_position, robot.body_quat))
    pelvis = robot.body_position[:, g1.ROOT : g1.ROOT + 1]
    vectors = (
        robot.body_velocity[:, g1.ROOT : g1.ROOT + 1],
        robot.body_position[:, _FEET] - pelvis,
        robot.body_velocity[:, _FEET],
        robot.foot_force.clamp(-1000, 1000) / 300.0,
    )
    spin = robot.body_angular_velocity[:, g1.ROOT]
    parts = (
        observation.task(command, measured, heading),
        _turned_back(heading, torch.cat(vectors, 1)).flatten(1),
        pelvis[:, 0, 2:],
        gravity_b(root),
        rotations.rotate_inverse(root, spin) * 0.25,
        robot.joint_angles - _DEFAULT_POSE.like(root),
        robot.joint_velocities * 0.05,
        action * 0.5,
    )
    return torch.cat(parts, -1)


def legs_observation(robot: RobotState, reference: RobotState) -> torch.Tensor:
    """What the legs of the reference do, ``(n, LEGS_SIZE)``.

    Contents: angles (rad, from the default pose) and velocities (x 0.05 rad/s) of legs
    and waist; knees and feet (m) and the feet's velocities (x 0.5 m/s) relative to the
    pelvis, and its heading, in the robot's heading frame; its height (m).

    Args:
        robot: current states.
        reference: reference states at t + 1.
    """
    heading = rotations.heading(robot.body_quat[:, g1.ROOT])
    wanted = rotations.heading(reference.body_quat[:, g1.ROOT])
    pelvis = reference.body_position[:, g1.ROOT : g1.ROOT + 1]
    moves = reference.body_velocity[:, g1.ROOT : g1.ROOT + 1]
    vectors = (
        reference.body_position[:, _KNEES] - pelvis,
        reference.body_position[:, _FEET] - pelvis,
        0.5 * (reference.body_velocity[:, _FEET] - moves),
        _forward(wanted)[:, None],
    )
    turned = _turned_back(heading, torch.cat(vectors, 1)).flatten(1)
    parts = (
        reference.joint_angles[:, LEGS] - _DEFAULT_POSE.like(heading)[LEGS],
        reference.joint_velocities[:, LEGS] * 0.05,
        turned[:, :-1],
        pelvis[:, 0, 2:],
    )
    return torch.cat(parts, -1)


def landmarks(state: RobotState) -> torch.Tensor:
    """What a preview shows of ``state``, ``(n, 5, 3)``, world.

    Places of torso and feet, metres; velocity and forward direction of the torso.
    """
    torso = g1.TORSO
    parts = (
        state.body_position[:, torso],
        *state.body_position[:, _FEET].unbind(1),
        state.body_velocity[:, torso],
        _forward(state.body_quat[:, torso]),
    )
    return torch.stack(parts, 1)


def preview(robot: RobotState, later: torch.Tensor) -> torch.Tensor:
    """What the reference will do, ``(n, 15 k)``: to step, one shifts weight before.

    Args:
        robot: current states of n robots; all is seen from their torsos.
        later: (n, k, 5, 3), `landmarks` of the reference at k later moments.
    """
    seen = later.clone()
    seen[:, :, :_PLACES] -= robot.body_position[:, None, None, g1.TORSO]
    turn = robot.body_quat[:, g1.TORSO]
    return _turned_back(turn, seen.flatten(1, 2)).flatten(1)


def _turned_back(quat: torch.Tensor, vectors: torch.Tensor) -> torch.Tensor:
    """``vectors (n, k, 3)``, world, in the frames ``quat (n, 4)``.

    For many vectors each, twice as quick as `rotations.rotate_inverse` of all of them.
    """
    axes = torch.eye(3, dtype=quat.dtype, device=quat.device)
    return torch.bmm(vectors, rotations.rotate_inverse(quat[:, None], axes))


def _forward(quat: torch.Tensor) -> torch.Tensor:
    """World coordinates of the x axes of bodies, ``(..., 4) -> (..., 3)``."""
    w, x, y, z = quat.unbind(-1)
    return torch.stack(
        (1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y)), -1
    )
