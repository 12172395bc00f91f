"""Rewards of Table A1, each a pure function of a `TrackingState`, and their weights.

Exponential terms use ``exp(-mean squared error / σ²)``. The printed coefficients of
Table A1 suit Isaac Gym's joint and body conventions; `FAST` holds what the shipped
weights were trained with (see ``docs/differences.md``).
"""

from __future__ import annotations

from dataclasses import dataclass

import torch

from openclone.robot import g1
from openclone.robot.state import RobotState, key_point_poses
from openclone.spatial import rotations

_FEET = list(g1.FEET)
_WRISTS = list(g1.WRISTS)


@dataclass(frozen=True)
class TrackingState:
    """Everything a reward may look at, for n robots.

    Attributes:
        robot, reference: states after the step; reference in the same world frame.
        action, previous_action: (n, 29), in units of action.
        previous_velocities: (n, 29), joint velocities before the step, rad/s.
        period: seconds per control step.
    """

    robot: RobotState
    reference: RobotState
    action: torch.Tensor
    previous_action: torch.Tensor
    previous_velocities: torch.Tensor
    period: float


def _closeness(squared_error: torch.Tensor, sigma: float) -> torch.Tensor:
    return torch.exp(-squared_error / sigma**2)


def _squared(difference: torch.Tensor) -> torch.Tensor:
    return (difference * difference).sum(-1)


def vr_position(s: TrackingState) -> torch.Tensor:
    """Body position (VR): head and hands against the command, world. σ 0.25 m."""
    points, _ = key_point_poses(s.robot.body_position, s.robot.body_quat)
    wanted, _ = key_point_poses(s.reference.body_position, s.reference.body_quat)
    return _closeness(_squared(points - wanted).mean(-1), 0.25)


def body_position(s: TrackingState) -> torch.Tensor:
    """Extend body position: key bodies relative to the torso's heading. σ 0.25 m."""
    torso = g1.TORSO
    robot, wanted = s.robot, s.reference
    turn = rotations.heading(
        rotations.multiply(
            robot.body_quat[:, torso],
            rotations.conjugate(wanted.body_quat[:, torso]),
        )
    )
    anchor = robot.body_position[:, torso].clone()
    anchor[:, 2] = wanted.body_position[:, torso, 2]
    arm = wanted.body_position - wanted.body_position[:, torso : torso + 1]
    target = anchor[:, None] + rotations.rotate(turn[:, None], arm)
    return _closeness(_squared(robot.body_position - target).mean(-1), 0.25)


def root_position(s: TrackingState) -> torch.Tensor:
    """Torso position in the world; closes the loop. σ 0.3 m."""
    error = s.robot.body_position[:, g1.TORSO] - s.reference.body_position[:, g1.TORSO]
    return _closeness(_squared(error), 0.3)


def root_rotation(s: TrackingState) -> torch.Tensor:
    """Torso orientation in the world. σ 0.4 rad."""
    angle = rotations.angle_between(
        s.robot.body_quat[:, g1.TORSO], s.reference.body_quat[:, g1.TORSO]
    )
    return _closeness(angle**2, 0.4)


def body_rotation(s: TrackingState) -> torch.Tensor:
    """Body rotation of all key bodies. σ 0.4 rad."""
    angle = rotations.angle_between(s.robot.body_quat, s.reference.body_quat)
    return _closeness((angle**2).mean(-1), 0.4)


def body_velocity(s: TrackingState) -> torch.Tensor:
    """Body velocity of all key bodies. σ 1 m/s."""
    error = _squared(s.robot.body_velocity - s.reference.body_velocity)
    return _closeness(error.mean(-1), 1.0)


def body_angular_velocity(s: TrackingState) -> torch.Tensor:
    """Body angular velocity of all key bodies. σ π rad/s."""
    difference = s.robot.body_angular_velocity - s.reference.body_angular_velocity
    return _closeness(_squared(difference).mean(-1), 3.14)


def hand_rotation(s: TrackingState) -> torch.Tensor:
    """Body hand rotation: 1 - <q̂, q>², the error the paper reports; negative weight."""
    product = s.robot.body_quat[:, _WRISTS] * s.reference.body_quat[:, _WRISTS]
    return (1.0 - product.sum(-1) ** 2).mean(-1)


def lower_action_rate(s: TrackingState) -> torch.Tensor:
    """Lower-body action rate, squared."""
    legs = g1.LOWER_BODY
    return _squared(s.action[:, legs] - s.previous_action[:, legs])


def upper_action_rate(s: TrackingState) -> torch.Tensor:
    """Upper-body action rate, squared."""
    start = g1.LOWER_BODY.stop
    return _squared(s.action[:, start:] - s.previous_action[:, start:])


def dof_acceleration(s: TrackingState) -> torch.Tensor:
    """DoF acceleration, squared, (rad/s²)²."""
    change = s.robot.joint_velocities - s.previous_velocities
    return _squared(change / s.period)


def dof_position_limits(s: TrackingState) -> torch.Tensor:
    """Radians by which joints leave the inner 95 % of their range."""
    margin = 0.025 * (g1.JOINT_UPPER - g1.JOINT_LOWER)
    angles = s.robot.joint_angles
    low = torch.as_tensor(g1.JOINT_LOWER + margin, dtype=angles.dtype)
    high = torch.as_tensor(g1.JOINT_UPPER - margin, dtype=angles.dtype)
    return (low - angles).clamp(min=0).sum(-1) + (angles - high).clamp(min=0).sum(-1)


def torque(s: TrackingState) -> torch.Tensor:
    """Torque, squared, (N m)²."""
    return _squared(s.robot.torque)


def slippage(s: TrackingState) -> torch.Tensor:
    """Slippage: squared speed of a foot that carries load."""
    loaded = s.robot.foot_force.norm(dim=-1) >= 1.0
    velocity = s.robot.body_velocity[:, _FEET, :2]
    return (_squared(velocity) * loaded).sum(-1)


def feet_still(s: TrackingState) -> torch.Tensor:
    """Feet that move or unload although the commanded points rest: stand quietly."""
    wanted = s.reference.body_velocity
    rest = torch.exp(-_squared(wanted).mean(-1) / 0.1**2)
    speed = _squared(s.robot.body_velocity[:, _FEET]).clamp(max=1.0).sum(-1)
    lifted = (s.robot.foot_force[..., 2] < 1.0).float().sum(-1)
    return rest * (speed + 0.5 * lifted)


@dataclass(frozen=True)
class RewardWeights:
    """One weight per reward function of this file, per second of tracking."""

    vr_position: float = 0.0
    body_position: float = 0.0
    root_position: float = 0.0
    root_rotation: float = 0.0
    body_rotation: float = 0.0
    body_velocity: float = 0.0
    body_angular_velocity: float = 0.0
    hand_rotation: float = 0.0
    lower_action_rate: float = 0.0
    upper_action_rate: float = 0.0
    dof_acceleration: float = 0.0
    dof_position_limits: float = 0.0
    torque: float = 0.0
    slippage: float = 0.0
    feet_still: float = 0.0


FAST = RewardWeights(
    vr_position=1.5,
    body_position=1.0,
    root_position=1.0,
    root_rotation=0.5,
    body_rotation=1.0,
    body_velocity=1.0,
    body_angular_velocity=1.0,
    hand_rotation=-0.5,
    lower_action_rate=-0.05,
    upper_action_rate=-0.05,
    dof_acceleration=-1e-7,
    dof_position_limits=-10.0,
    torque=-1e-6,
    slippage=-0.1,
    feet_still=-0.5,
)
"""What the shipped teacher was trained with."""

_TERMS = (
    vr_position,
    body_position,
    root_position,
    root_rotation,
    body_rotation,
    body_velocity,
    body_angular_velocity,
    hand_rotation,
    lower_action_rate,
    upper_action_rate,
    dof_acceleration,
    dof_position_limits,
    torque,
    slippage,
    feet_still,
)


def total_reward(
    state: TrackingState, weights: RewardWeights
) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
    """Weighted sum ``(n,)`` per second, and each weighted term for the log."""
    terms = {
        term.__name__: weight * term(state)
        for term in _TERMS
        if (weight := getattr(weights, term.__name__)) != 0.0
    }
    return torch.stack(tuple(terms.values())).sum(0), terms
