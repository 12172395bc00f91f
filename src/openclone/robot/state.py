"""The robot's state as plain arrays, read from what the physics delivers."""

from __future__ import annotations

from dataclasses import dataclass

from openclone.robot import g1
from openclone.robot.model import SensorLayout
from openclone.spatial import rotations
from openclone.spatial.rotations import Array

_POINTS = slice(g1.TORSO, None, g1.WRISTS[0] - g1.TORSO)
"""Torso and wrists among the key bodies: picking by a list takes ten times as long."""


@dataclass(frozen=True)
class RobotState:
    """Full state of a batch of simulated robots (privileged: a real one knows less).

    Bodies are `g1.KEY_BODIES`; all body quantities are in the world frame.

    Attributes:
        joint_angles, joint_velocities: (..., 29), radians, radians per second.
        body_position: (..., 14, 3), metres.
        body_quat: (..., 14, 4), wxyz, world from body.
        body_velocity, body_angular_velocity: (..., 14, 3), m/s and rad/s.
        torque: (..., 29), N m, applied by the motors.
        foot_force: (..., 2, 3), N, of the ground on the left and the right foot.
    """

    joint_angles: Array
    joint_velocities: Array
    body_position: Array
    body_quat: Array
    body_velocity: Array
    body_angular_velocity: Array
    torque: Array
    foot_force: Array


def read_state(
    layout: SensorLayout, qpos: Array, qvel: Array, sensordata: Array
) -> RobotState:
    """Slice ``qpos (..., 36)``, ``qvel (..., 35)`` and ``sensordata`` by name."""
    batch = qpos.shape[:-1]
    bodies = len(g1.KEY_BODIES)

    def group(part: slice, width: int) -> Array:
        return sensordata[..., part].reshape((*batch, -1, width))

    return RobotState(
        joint_angles=qpos[..., 7:],
        joint_velocities=qvel[..., 6:],
        body_position=group(layout.position, 3)[..., :bodies, :],
        body_quat=group(layout.quat, 4),
        body_velocity=group(layout.velocity, 3),
        body_angular_velocity=group(layout.angular_velocity, 3),
        torque=sensordata[..., layout.torque],
        # The sensor reports the force of the foot on the ground.
        foot_force=-group(layout.foot_force, 3),
    )


def key_point_poses(body_position: Array, body_quat: Array) -> tuple[Array, Array]:
    """Head and hands from key-body poses: ``(..., 3, 3)`` and ``(..., 3, 4)``, world.

    Order head, left hand, right hand; `g1.HEAD_OFFSET` and `g1.HAND_OFFSET` are
    fixed in the torso and the wrists.
    """
    xp = rotations.namespace(body_position)
    position, quat = body_position[..., _POINTS, :], body_quat[..., _POINTS, :]
    offset = xp.zeros_like(position)
    offset[..., 0, 2] = g1.HEAD_OFFSET[2]
    offset[..., 1:, 0] = g1.HAND_OFFSET[0]
    return position + rotations.rotate(quat, offset), quat


def key_point_velocities(state: RobotState) -> Array:
    """Linear velocities of head and hands, ``(..., 3, 3)``, m/s, world."""
    points, _ = key_point_poses(state.body_position, state.body_quat)
    arm = points - state.body_position[..., _POINTS, :]
    spin = state.body_angular_velocity[..., _POINTS, :]
    return state.body_velocity[..., _POINTS, :] + rotations.cross(spin, arm)
