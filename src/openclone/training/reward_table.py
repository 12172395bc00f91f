"""The weights of the rewards: Table A1 as printed, and what is trained here.

Table A1 prints tracking rows as ``exp(-c ‖error‖)``. OmniH2O, whose rewards the paper
builds on, computes ``exp(-mean squared error / σ)``, and CLONE's 0.5, 0.1 and 10 equal
OmniH2O's σ of the same rows. So `PAPER` reads every printed c as that σ, the ``width``
here. Neither reading makes sense of all rows: as printed, the velocity row (c = 10) has
nothing left at 0.5 m/s; as σ, the angular velocity row (c = 0.01) has nothing left at
1 rad/s. The latter weighs 8 of about 1000, the former 80.
``docs/differences.md`` compares them row by row.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch

from openclone.training import rewards
from openclone.training.rewards import TrackingState


@dataclass(frozen=True)
class RewardWidths:
    """Widths of the closeness terms, in squared units of their errors."""

    dof_position_tracking: float = 0.25
    dof_velocity_tracking: float = 0.25
    extend_body_position: float = 0.5
    vr_position: float = 0.2**2
    body_rotation: float = 0.4**2
    body_velocity: float = 1.0**2
    body_angular_velocity: float = 3.14**2
    body_position: float = 0.25**2
    hand_position: float = 0.06**2
    root_position: float = 0.2**2
    root_rotation: float = 0.4**2


@dataclass(frozen=True)
class RewardWeights:
    """One weight per reward function, per second of tracking; Table A1 comes first.

    Attributes:
        widths: of the closeness terms.
        limit: bound on the magnitude of the sum, per second.
        (all others): the weight of the function of that name.
    """

    torque: float = 0.0
    torque_limits: float = 0.0
    dof_position_limits: float = 0.0
    dof_velocity_limits: float = 0.0
    termination: float = 0.0
    dof_acceleration: float = 0.0
    dof_velocity: float = 0.0
    lower_action_rate: float = 0.0
    upper_action_rate: float = 0.0
    feet_air_time: float = 0.0
    stumble: float = 0.0
    slippage: float = 0.0
    feet_orientation: float = 0.0
    in_the_air: float = 0.0
    orientation: float = 0.0
    dof_position_tracking: float = 0.0
    dof_velocity_tracking: float = 0.0
    extend_body_position: float = 0.0
    vr_position: float = 0.0
    body_rotation: float = 0.0
    body_velocity: float = 0.0
    body_angular_velocity: float = 0.0
    body_hand_rotation: float = 0.0
    amp: float = 0.0
    body_position: float = 0.0
    hand_position: float = 0.0
    root_position: float = 0.0
    root_rotation: float = 0.0
    hand_rotation: float = 0.0
    dof_margin: float = 0.0
    feet_still: float = 0.0
    contact_mismatch: float = 0.0
    airborne: float = 0.0
    leg_distance: float = 0.0
    correction_rate: float = 0.0
    velocity_distance: float = 0.0
    body_distance: float = 0.0
    widths: RewardWidths = RewardWidths()
    limit: float = 10.0


PAPER = RewardWeights(
    torque=-0.0001,
    torque_limits=-2.0,
    dof_position_limits=-625.0,
    dof_velocity_limits=-50.0,
    termination=-1e4,
    dof_acceleration=-1.1e-5,
    dof_velocity=-0.004,
    lower_action_rate=-1.0,
    upper_action_rate=-0.3,
    feet_air_time=2500.0,
    stumble=-1.25e4,
    slippage=-80.0,
    feet_orientation=-62.5,
    in_the_air=-750.0,
    orientation=-50.0,
    dof_position_tracking=100.0,
    dof_velocity_tracking=10.0,
    extend_body_position=250.0,
    vr_position=150.0,
    body_rotation=400.0,
    body_velocity=80.0,
    body_angular_velocity=8.0,
    body_hand_rotation=-500.0,
    amp=500.0,
    widths=RewardWidths(
        dof_position_tracking=0.25,
        dof_velocity_tracking=0.25,
        extend_body_position=0.5,
        vr_position=0.5,
        body_rotation=0.1,
        body_velocity=10.0,
        body_angular_velocity=0.01,
    ),
    limit=math.inf,
)
"""Table A1 as printed. "-e^4" and "-1.1e^-5" are read as powers of ten. The hands' row
is printed with +500 on an error, which would reward wrong hands: it is negative here.
"""

FAST = RewardWeights(
    vr_position=4.0,
    extend_body_position=2.0,
    body_position=6.0,
    hand_position=2.0,
    root_position=2.0,
    root_rotation=1.0,
    body_rotation=2.0,
    body_velocity=3.0,
    body_angular_velocity=1.0,
    dof_position_tracking=1.0,
    hand_rotation=-24.0,
    termination=-150.0,
    lower_action_rate=-0.03,
    upper_action_rate=-0.03,
    dof_acceleration=-1e-7,
    dof_margin=-10.0,
    torque=-1e-6,
    slippage=-0.1,
    feet_still=-0.5,
    contact_mismatch=-0.5,
    airborne=-2.0,
    leg_distance=-12.0,
    correction_rate=-0.1,
    velocity_distance=-4.0,
    body_distance=-12.0,
    widths=RewardWidths(
        vr_position=0.1**2,
        extend_body_position=0.13**2,
        body_position=0.1**2,
        hand_position=0.06**2,
        body_velocity=0.7**2,
        dof_position_tracking=0.3**2,
    ),
    limit=400.0,
)
"""What the shipped teacher was trained with."""

_PLAIN: tuple[Callable[[TrackingState], torch.Tensor], ...] = (
    rewards.torque,
    rewards.torque_limits,
    rewards.dof_position_limits,
    rewards.dof_velocity_limits,
    rewards.termination,
    rewards.dof_acceleration,
    rewards.dof_velocity,
    rewards.lower_action_rate,
    rewards.upper_action_rate,
    rewards.feet_air_time,
    rewards.stumble,
    rewards.slippage,
    rewards.feet_orientation,
    rewards.in_the_air,
    rewards.orientation,
    rewards.body_hand_rotation,
    rewards.amp,
    rewards.hand_rotation,
    rewards.dof_margin,
    rewards.feet_still,
    rewards.contact_mismatch,
    rewards.airborne,
    rewards.leg_distance,
    rewards.correction_rate,
    rewards.velocity_distance,
    rewards.body_distance,
)
_CLOSENESS: tuple[Callable[[TrackingState, float], torch.Tensor], ...] = (
    rewards.vr_position,
    rewards.body_position,
    rewards.hand_position,
    rewards.root_position,
    rewards.root_rotation,
    rewards.body_rotation,
    rewards.body_velocity,
    rewards.body_angular_velocity,
    rewards.dof_position_tracking,
    rewards.dof_velocity_tracking,
    rewards.extend_body_position,
)


def total_reward(
    state: TrackingState, weights: RewardWeights
) -> tuple[torch.Tensor, dict[str, torch.Tensor]]:
    """Weighted sum ``(n,)`` per second, and each weighted term for the log."""
    terms: dict[str, torch.Tensor] = {}
    for term in _CLOSENESS:
        weight = getattr(weights, term.__name__)
        if weight != 0.0:
            width = getattr(weights.widths, term.__name__)
            terms[term.__name__] = weight * term(state, width)
    for plain in _PLAIN:
        weight = getattr(weights, plain.__name__)
        if weight != 0.0:
            terms[plain.__name__] = weight * plain(state)
    return torch.stack(tuple(terms.values())).sum(0), terms
