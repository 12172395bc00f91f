"""When an episode ends because the robot is lost."""

from __future__ import annotations

import torch

from openclone.policy.teacher import evenly_spaced
from openclone.robot import g1
from openclone.spatial import rotations
from openclone.training.rewards import TrackingState
from openclone.training.task_config import TerminationLimits

_ENDS = (evenly_spaced(g1.FEET), evenly_spaced(g1.WRISTS))


def lost(
    tracking: TrackingState, limits: TerminationLimits, settling: torch.Tensor
) -> torch.Tensor:
    """(n,) bool: robots beyond ``limits``.

    Args:
        tracking: robots and references after the step.
        limits: see there.
        settling: (n,) bool, robots born away from the reference, which get time to
            come closer: only falls and great distances end their episodes.
    """
    torso = g1.TORSO
    robot, reference = tracking.robot, tracking.reference
    too_high = robot.body_position[..., 2] - reference.body_position[..., 2]
    height = too_high[:, torso]
    trunks = (state.body_quat[:, torso] for state in (robot, reference))
    up, up_wanted = map(rotations.vertical, trunks)
    tilt = torch.arccos((up * up_wanted).sum(-1).clamp(-1, 1))
    angle = tracking.angles[:, torso]
    ends = torch.cat([too_high[:, part] for part in _ENDS], 1).abs().amax(-1)
    distance = tracking.point_offsets.norm(dim=-1).mean(-1)
    strict = (
        (height.abs() > limits.height)
        | (angle > limits.angle)
        | (ends > limits.end_effector)
        | (distance > limits.distance)
    )
    loose = (
        (height < -2 * limits.height)
        | (tilt > 1.2)
        | (distance > limits.distance + 1.5)
    )
    return torch.where(settling, loose, strict)
