"""Linear feedback: joint targets answer to the robot's deviation from the reference.

Without any training this keeps a robot on its feet through most motions, see
`training.regulator`; the teacher learns what a linear law cannot do: to step elsewhere,
and to recover from afar.
"""

from __future__ import annotations

import numpy as np
import torch

from openclone.motion.edit import MIRROR_INDEX, MIRROR_SIGN
from openclone.policy.constants import Constant
from openclone.robot import g1
from openclone.robot.state import RobotState
from openclone.spatial import rotations
from openclone.training.regulator import BOUNDS, DEVIATION_SIZE, LARGEST

_BOUNDS = Constant(BOUNDS)
_FLIP = np.array([1.0, -1.0, 1.0])
_SIGNS = np.concatenate((_FLIP, -_FLIP, MIRROR_SIGN))
_ORDER = np.concatenate((np.arange(6), 6 + MIRROR_INDEX))


def mirrored_feedback(gains: np.ndarray) -> np.ndarray:
    """The gains of the mirrored motion, see `motion.edit.mirror`."""
    order = np.concatenate((_ORDER, 35 + _ORDER, [DEVIATION_SIZE]))
    signs = np.concatenate((_SIGNS, _SIGNS, [1.0])).astype(gains.dtype)
    turned = gains[:, MIRROR_INDEX][:, :, order]
    return turned * signs * MIRROR_SIGN.astype(gains.dtype)[:, None]


def deviation(robot: RobotState, reference: RobotState) -> torch.Tensor:
    """How far robots are from a reference, ``(n, 70)``.

    Root position (world), its rotation (root frame), joint angles; then the velocities
    in the same order: MuJoCo's tangent space.
    """
    root = g1.ROOT
    quat, wanted = robot.body_quat[:, root], reference.body_quat[:, root]
    turned = rotations.multiply(rotations.conjugate(wanted), quat)
    spin = rotations.rotate_inverse(quat, robot.body_angular_velocity[:, root])
    spin = spin - rotations.rotate_inverse(
        wanted, reference.body_angular_velocity[:, root]
    )
    parts = (
        robot.body_position[:, root] - reference.body_position[:, root],
        rotations.to_rotation_vector(turned),
        robot.joint_angles - reference.joint_angles,
        robot.body_velocity[:, root] - reference.body_velocity[:, root],
        spin,
        robot.joint_velocities - reference.joint_velocities,
    )
    return torch.cat(parts, -1)


def corrections(gains: torch.Tensor, away: torch.Tensor) -> torch.Tensor:
    """Radians to add to joint targets, ``(n, 29)``.

    Args:
        gains: (n, 29, 71), of the frame that each robot is in.
        away: (n, 70), its `deviation` from that frame.
    """
    bounds = _BOUNDS.like(away)
    bounded = torch.minimum(torch.maximum(away, -bounds), bounds)
    known = torch.cat((bounded, torch.ones_like(bounded[:, :1])), 1)
    wanted = torch.bmm(gains.to(away.dtype), known[..., None])[..., 0]
    return wanted.clamp(-LARGEST, LARGEST)
