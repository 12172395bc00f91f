"""What the student policy sees (section 3.1), defined once.

The training task (torch, batched) and the 50 Hz loop (NumPy, single) call these same
functions. The student's input is the task part followed by the history, newest frame
first:

    task (63)    position differences p̂ - p      3 x 3, robot's heading frame, metres
                 target positions p̂              3 x 3, heading frame, relative to the
                                                 target head's ground point
                 target velocities               3 x 3, heading frame
                 current wrist orientations h    2 x 6, heading frame
                 target wrist orientations ĥ     2 x 6, heading frame
                 current head orientation        6, heading frame
                 target head orientation         6, heading frame; these two only where
                                                 `Command.look` is 1, else zeros
    frame (93)   joint positions, joint velocities, root angular velocity, gravity
                 vector, previous action; 25 of them
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from openclone.policy.command import HANDS, HEAD, NUM_POINTS, Command, KeyPoints
from openclone.robot import g1
from openclone.spatial import rotations
from openclone.spatial.rotations import Array

LAYOUT = "openclone-student-2"
"""Name of the layout above; a bundle made for another one is refused."""
HISTORY = 25
"""Frames of history H (Appendix C)."""
FRAME_SIZE = 3 * g1.NUM_JOINTS + 6
TASK_SIZE = (9 + 12) * NUM_POINTS
MAX_DIFFERENCE = 1.0
"""Metres; horizontal position differences are clipped to this, per axis."""

_JOINT_VELOCITY_SCALE = 0.05
_ANGULAR_VELOCITY_SCALE = 0.25
_VELOCITY_SCALE = 0.5
_ACTION_SCALE = 0.5


@dataclass(frozen=True)
class Proprioception:
    """What the robot's own sensors tell, at one instant.

    Attributes:
        joint_angles: (..., 29), radians.
        joint_velocities: (..., 29), radians per second.
        angular_velocity_b: (..., 3), radians per second, root frame (gyroscope).
        base_quat: (..., 4), wxyz, world from root; only roll and pitch enter a frame.
    """

    joint_angles: Array
    joint_velocities: Array
    angular_velocity_b: Array
    base_quat: Array


def gravity_b(base_quat: Array) -> Array:
    """Unit gravity direction in the root frame, ``(..., 4) -> (..., 3)``."""
    xp = rotations.namespace(base_quat)
    w, x, y, z = (base_quat[..., k] for k in range(4))
    # Third row of the rotation matrix, negated.
    parts = (2 * (w * y - x * z), -2 * (w * x + y * z), 2 * (x * x + y * y) - 1)
    return xp.stack(parts, -1)


def frame(now: Proprioception, previous_action: Array, default_pose: Array) -> Array:
    """One frame of history, ``(..., 93)``.

    Args:
        now: the robot's sensors.
        previous_action: (..., 29), the policy's last output.
        default_pose: (29,), radians, `g1.DEFAULT_POSE` as the caller's kind of array.
    """
    xp = rotations.namespace(now.joint_angles)
    parts = (
        now.joint_angles - default_pose,
        now.joint_velocities * _JOINT_VELOCITY_SCALE,
        now.angular_velocity_b * _ANGULAR_VELOCITY_SCALE,
        gravity_b(now.base_quat),
        previous_action * _ACTION_SCALE,
    )
    return xp.concatenate(parts, -1)


def task(command: Command, measured: KeyPoints, heading: Array) -> Array:
    """The task part, ``(..., 63)``.

    Args:
        command: targets for t + 1, world.
        measured: head and hands from odometry and kinematics, world.
        heading: (..., 4), yaw-only quaternion of the robot's root.
    """
    xp = rotations.namespace(heading)
    batch = heading.shape[:-1]
    turn = xp.ones_like(command.target.quat) * heading[..., None, :]
    target = command.target.position
    difference = rotations.rotate_inverse(turn, target - measured.position)
    horizontal = difference[..., :2].clip(-MAX_DIFFERENCE, MAX_DIFFERENCE)
    difference = xp.concatenate((horizontal, difference[..., 2:]), -1)
    ground = xp.concatenate((target[..., :1, :2], 0 * target[..., :1, 2:]), -1)
    parts = (
        difference,
        rotations.rotate_inverse(turn, target - ground),
        rotations.rotate_inverse(turn, command.velocity) * _VELOCITY_SCALE,
    )
    back = rotations.conjugate(turn)
    current, wanted = (
        rotations.to_6d(rotations.multiply(back, points.quat))
        for points in (measured, command.target)
    )
    look = xp.ones_like(heading[..., :1]) * _column(command.look)
    wrists = (current[..., HANDS, :], wanted[..., HANDS, :])
    head = (look * current[..., HEAD, :], look * wanted[..., HEAD, :])
    flat = [part.reshape((*batch, -1)) for part in (*parts, *wrists, *head)]
    return xp.concatenate(flat, -1)


def _column(values: Array | float) -> Array | float:
    return values if isinstance(values, (int, float)) else values[..., None]


class History:
    """The last 25 frames of a batch of robots, newest first.

    The buffer takes its kind (NumPy or torch) and batch shape from the first frame.
    """

    def __init__(self, first: Array, length: int = HISTORY) -> None:
        """Fill all ``length`` frames with ``first (..., 93)``."""
        xp = rotations.namespace(first)
        self.frames = xp.stack([first] * length, -2)

    def push(self, newest: Array) -> None:
        """Put ``newest (..., 93)`` in front and drop the oldest frame."""
        xp = rotations.namespace(newest)
        kept = self.frames[..., :-1, :]
        self.frames = xp.concatenate((newest[..., None, :], kept), -2)

    def refill(self, ids: Array, first: Array) -> None:
        """Start afresh where an episode was reset: ``first (len(ids), 93)``."""
        self.frames[ids] = first[:, None, :]

    def flat(self) -> Array:
        """``(..., 25 * 93)``."""
        return self.frames.reshape((*self.frames.shape[:-2], -1))


def student_size(history: int = HISTORY) -> int:
    """Length of the student's input vector."""
    return TASK_SIZE + history * FRAME_SIZE


def student(task_part: Array, history: History) -> Array:
    """The whole input, ``(..., 63 + 25 * 93)``."""
    xp = rotations.namespace(task_part)
    return xp.concatenate((task_part, history.flat()), -1)


def default_pose() -> np.ndarray:
    """`g1.DEFAULT_POSE` as float32, for `frame`."""
    return np.asarray(g1.DEFAULT_POSE, dtype=np.float32)
