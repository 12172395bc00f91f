"""The command: what the operator asks of the robot, three 6D targets (section 3.1)."""

from __future__ import annotations

from dataclasses import dataclass

from openclone.robot.state import RobotState, key_point_poses, key_point_velocities
from openclone.spatial.rotations import Array

POINTS = ("head", "left_hand", "right_hand")
"""The tracked points; index 0 is the head, 1 and 2 are the wrists."""
NUM_POINTS = len(POINTS)
HEAD = 0
HANDS = slice(1, 3)


@dataclass(frozen=True)
class KeyPoints:
    """Poses of head and hands, commanded or measured.

    Attributes:
        position: (..., 3, 3), metres, world; points in the order of `POINTS`.
        quat: (..., 3, 4), wxyz, world from point.
    """

    position: Array
    quat: Array


@dataclass(frozen=True)
class Command:
    """Targets for the next control step, p̂ and ĥ of section 3.1.

    Attributes:
        target: poses that head and hands should have at t + 1, world.
        velocity: (..., 3, 3), metres per second, world, of the three targets.
        look: (...,), 1 where the robot shall turn its head (and with it the trunk) as
            the target's is, 0 where the operator looks around freely: then the head's
            orientation is not told to the policy, as in section 3.1.
    """

    target: KeyPoints
    velocity: Array
    look: Array | float = 1.0


def command_of(reference: RobotState, look: Array | float = 1.0) -> Command:
    """What an operator who moves like ``reference (...)`` commands: head and hands."""
    poses = key_point_poses(reference.body_position, reference.body_quat)
    return Command(KeyPoints(*poses), key_point_velocities(reference), look)
