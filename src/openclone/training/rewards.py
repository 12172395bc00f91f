"""Rewards, each a pure function of a `TrackingState`: Table A1, then our own terms.

Closeness terms are ``exp(-mean squared error / width)``. A row that the paper prints as
``exp(-c ‖error‖²)`` takes its width from the weight table (`reward_table`), where the
two readings of c are explained. ``[condition]₁`` in Table A1 counts how often the
condition holds, joint by joint or foot by foot.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import torch

from openclone.policy.constants import Constant
from openclone.policy.observation import gravity_b
from openclone.policy.teacher import LEGS, evenly_spaced
from openclone.robot import g1
from openclone.robot.model import SOLE_CORNERS
from openclone.robot.state import RobotState, key_point_poses
from openclone.spatial import rotations

_FEET = evenly_spaced(g1.FEET)
_KNEES = evenly_spaced(tuple(foot - 1 for foot in g1.FEET))
_WRISTS = evenly_spaced(g1.WRISTS)
_CONTACT_N = 1.0
_NEAR, _FAR = 0.02, 0.6
"""Metres; a distance hardly counts below the one, and no more above the other."""
_SLOW = 0.05
"""m/s; differences in velocity hardly count below."""
_AIR_SECONDS = 0.3
_SATURATED = 0.999
"""MuJoCo clips torques at the limit, so a motor at its limit reads just that."""
_TORQUE_LIMIT = Constant(_SATURATED * g1.MAX_TORQUE)
_LOWER, _UPPER = Constant(g1.JOINT_LOWER), Constant(g1.JOINT_UPPER)
_MARGIN = 0.025 * (g1.JOINT_UPPER - g1.JOINT_LOWER)
_INNER_LOWER = Constant(g1.JOINT_LOWER + _MARGIN)
_INNER_UPPER = Constant(g1.JOINT_UPPER - _MARGIN)
_MAX_SPEED = Constant(g1.MAX_SPEED)
_ACTION_SCALE = Constant(g1.ACTION_SCALE)
_SOLE_CORNERS = Constant(SOLE_CORNERS)


@dataclass(frozen=True)
class TrackingState:
    """Everything a reward may look at, for n robots.

    Attributes:
        robot, reference: states after the step; reference in the same world frame.
        action, previous_action: (n, 29), in units of action.
        previous_velocities: (n, 29), joint velocities before the step, rad/s.
        terminated: (n,) bool, the step ended the episode by failure.
        air_time: (n, 2), seconds each foot had been off the ground before the step.
        style: (n,), AMP reward -log(1 - D) of the step; 0 without AMP.
        period: seconds per control step.
    """

    robot: RobotState
    reference: RobotState
    action: torch.Tensor
    previous_action: torch.Tensor
    previous_velocities: torch.Tensor
    terminated: torch.Tensor
    air_time: torch.Tensor
    style: torch.Tensor
    period: float

    @cached_property
    def point_offsets(self) -> torch.Tensor:
        """(n, 3, 3), metres, world: head and hands minus their commands."""
        points, _ = key_point_poses(self.robot.body_position, self.robot.body_quat)
        wanted, _ = key_point_poses(
            self.reference.body_position, self.reference.body_quat
        )
        return points - wanted

    @cached_property
    def angles(self) -> torch.Tensor:
        """(n, 14), radians between each key body and its reference."""
        return rotations.angle_between(self.robot.body_quat, self.reference.body_quat)

    @cached_property
    def wanted_soles(self) -> torch.Tensor:
        """(n, 2), metres: height of the lowest corner of each of the reference's soles.

        A foot that rolls over its toes lifts its ankle and still stands.
        """
        down = gravity_b(self.reference.body_quat[:, _FEET])
        corners = (down @ _SOLE_CORNERS.like(down).T).amax(-1)
        return self.reference.body_position[:, _FEET, 2] - corners


def _closeness(squared_error: torch.Tensor, width: float) -> torch.Tensor:
    return torch.exp(-squared_error / width)


def _squared(difference: torch.Tensor) -> torch.Tensor:
    return (difference * difference).sum(-1)


def _distance(difference: torch.Tensor, near: float) -> torch.Tensor:
    """Lengths, ``(..., 3) -> (...)``, rounded off at zero over about ``near``."""
    return (_squared(difference) + near**2).sqrt() - near


def _mean_square(difference: torch.Tensor) -> torch.Tensor:
    """Mean over bodies of the squared length, ``(n, bodies, 3) -> (n,)``.

    All at once: sums over the three coordinates alone take longer.
    """
    return 3.0 * (difference * difference).flatten(1).mean(-1)


def _tilt(quat: torch.Tensor) -> torch.Tensor:
    """Sine of the angle between a body's z axis and the vertical, (...)."""
    return gravity_b(quat)[..., :2].norm(dim=-1)


# Table A1: penalties ----------------------------------------------------------------


def torque(s: TrackingState) -> torch.Tensor:
    """Torque: ‖τ‖², (N m)²."""
    return _squared(s.robot.torque)


def torque_limits(s: TrackingState) -> torch.Tensor:
    """Torque limits: how many motors are at their limit."""
    torque = s.robot.torque
    return (torque.abs() >= _TORQUE_LIMIT.like(torque)).float().sum(-1)


def dof_position_limits(s: TrackingState) -> torch.Tensor:
    """DoF position limits: how many joints are beyond their range."""
    angles = s.robot.joint_angles
    outside = (angles < _LOWER.like(angles)) | (angles > _UPPER.like(angles))
    return outside.float().sum(-1)


def dof_velocity_limits(s: TrackingState) -> torch.Tensor:
    """DoF velocity limits: how many joints turn faster than their motor may."""
    speed = s.robot.joint_velocities.abs()
    return (speed > _MAX_SPEED.like(speed)).float().sum(-1)


def termination(s: TrackingState) -> torch.Tensor:
    """Termination: 1 where the step ended the episode by failure."""
    return s.terminated.float()


def dof_acceleration(s: TrackingState) -> torch.Tensor:
    """DoF acceleration: ‖q̈‖², (rad/s²)²."""
    change = s.robot.joint_velocities - s.previous_velocities
    return _squared(change / s.period)


def dof_velocity(s: TrackingState) -> torch.Tensor:
    """DoF velocity (penalty): ‖q̇‖², (rad/s)²."""
    return _squared(s.robot.joint_velocities)


def lower_action_rate(s: TrackingState) -> torch.Tensor:
    """Lower-body action rate: ‖a_t - a_(t-1)‖² over the legs."""
    legs = g1.LOWER_BODY
    return _squared(s.action[:, legs] - s.previous_action[:, legs])


def upper_action_rate(s: TrackingState) -> torch.Tensor:
    """Upper-body action rate: ‖a_t - a_(t-1)‖² over waist and arms."""
    start = g1.LOWER_BODY.stop
    return _squared(s.action[:, start:] - s.previous_action[:, start:])


# Table A1: feet and balance ----------------------------------------------------------


def _loaded(s: TrackingState) -> torch.Tensor:
    """(n, 2) bool: the foot presses on the ground."""
    return s.robot.foot_force.norm(dim=-1) >= _CONTACT_N


def feet_air_time(s: TrackingState) -> torch.Tensor:
    """Feet air time: T_air - 0.3 s, summed over the feet that land in this step."""
    landed = _loaded(s) & (s.air_time > 0)
    return ((s.air_time - _AIR_SECONDS) * landed).sum(-1)


def stumble(s: TrackingState) -> torch.Tensor:
    """Stumble: feet pushed sideways more than five times harder than upwards."""
    sideways = s.robot.foot_force[..., :2].norm(dim=-1)
    upwards = s.robot.foot_force[..., 2].abs()
    return (sideways > 5 * upwards).float().sum(-1)


def slippage(s: TrackingState) -> torch.Tensor:
    """Slippage: squared horizontal speed of the feet that carry load, (m/s)²."""
    velocity = s.robot.body_velocity[:, _FEET, :2]
    return (_squared(velocity) * _loaded(s)).sum(-1)


def feet_orientation(s: TrackingState) -> torch.Tensor:
    """Feet orientation: sine of each sole's tilt, summed."""
    return _tilt(s.robot.body_quat[:, _FEET]).sum(-1)


def in_the_air(s: TrackingState) -> torch.Tensor:
    """In the air: 1 where neither foot is loaded."""
    return (~_loaded(s)).all(-1).float()


def orientation(s: TrackingState) -> torch.Tensor:
    """Orientation: sine of the root's tilt."""
    return _tilt(s.robot.body_quat[:, g1.ROOT])


# Table A1: tracking ------------------------------------------------------------------


def dof_position_tracking(s: TrackingState, width: float) -> torch.Tensor:
    """DoF position: joint angles against the reference; width in rad²."""
    difference = s.robot.joint_angles - s.reference.joint_angles
    return _closeness((difference * difference).mean(-1), width)


def dof_velocity_tracking(s: TrackingState, width: float) -> torch.Tensor:
    """DoF velocity: joint velocities against the reference; width in (rad/s)²."""
    difference = s.robot.joint_velocities - s.reference.joint_velocities
    return _closeness((difference * difference).mean(-1), width)


def extend_body_position(s: TrackingState, width: float) -> torch.Tensor:
    """Extend body position: key bodies, head and hands in the world; width in m²."""
    bodies = s.robot.body_position - s.reference.body_position
    return _closeness(_mean_square(torch.cat((bodies, s.point_offsets), 1)), width)


def vr_position(s: TrackingState, width: float) -> torch.Tensor:
    """Body position (VR): head and hands against the command, world; width in m²."""
    return _closeness(_mean_square(s.point_offsets), width)


def body_rotation(s: TrackingState, width: float) -> torch.Tensor:
    """Body rotation of all key bodies; width in rad²."""
    return _closeness((s.angles**2).mean(-1), width)


def body_velocity(s: TrackingState, width: float) -> torch.Tensor:
    """Body velocity of all key bodies; width in (m/s)²."""
    difference = s.robot.body_velocity - s.reference.body_velocity
    return _closeness(_mean_square(difference), width)


def body_angular_velocity(s: TrackingState, width: float) -> torch.Tensor:
    """Body angular velocity of all key bodies; width in (rad/s)²."""
    difference = s.robot.body_angular_velocity - s.reference.body_angular_velocity
    return _closeness(_mean_square(difference), width)


def body_hand_rotation(s: TrackingState) -> torch.Tensor:
    """Body hand rotation: squared angle of each hand's error, mean, rad²."""
    return (s.angles[:, _WRISTS] ** 2).mean(-1)


def amp(s: TrackingState) -> torch.Tensor:
    """AMP: -log(1 - D) of the lower body's transition (section 3.3)."""
    return s.style


# Our own terms -----------------------------------------------------------------------


def body_position(s: TrackingState, width: float) -> torch.Tensor:
    """Key bodies relative to the torso's place and heading; width in m²."""
    torso = g1.TORSO
    robot, wanted = s.robot, s.reference
    turn = rotations.yaw(
        rotations.multiply(
            robot.body_quat[:, torso],
            rotations.conjugate(wanted.body_quat[:, torso]),
        )
    )[:, None]
    cosine, sine = turn.cos(), turn.sin()
    x, y, _ = (wanted.body_position - wanted.body_position[:, torso, None]).unbind(-1)
    error = robot.body_position - robot.body_position[:, torso, None]
    error[..., 0] -= cosine * x - sine * y
    error[..., 1] -= sine * x + cosine * y
    error[..., 2] = robot.body_position[..., 2] - wanted.body_position[..., 2]
    return _closeness(_mean_square(error), width)


def hand_position(s: TrackingState, width: float) -> torch.Tensor:
    """Hands against the command, both relative to the head, world; width in m²."""
    offsets = s.point_offsets
    return _closeness(_mean_square(offsets[:, 1:] - offsets[:, :1]), width)


def root_position(s: TrackingState, width: float) -> torch.Tensor:
    """Torso position in the world; closes the loop; width in m²."""
    error = s.robot.body_position[:, g1.TORSO] - s.reference.body_position[:, g1.TORSO]
    return _closeness(_squared(error), width)


def root_rotation(s: TrackingState, width: float) -> torch.Tensor:
    """Torso orientation in the world; width in rad²."""
    return _closeness(s.angles[:, g1.TORSO] ** 2, width)


def hand_rotation(s: TrackingState) -> torch.Tensor:
    """1 - <q̂, q>² of the hands, the error the paper reports; negative weight."""
    product = s.robot.body_quat[:, _WRISTS] * s.reference.body_quat[:, _WRISTS]
    return (1.0 - product.sum(-1) ** 2).mean(-1)


def dof_margin(s: TrackingState) -> torch.Tensor:
    """Radians by which joints leave the inner 95 % of their range."""
    angles = s.robot.joint_angles
    below = (_INNER_LOWER.like(angles) - angles).clamp(min=0)
    return (below + (angles - _INNER_UPPER.like(angles)).clamp(min=0)).sum(-1)


def feet_still(s: TrackingState) -> torch.Tensor:
    """Feet that move or unload although the commanded points rest: stand quietly."""
    wanted = s.reference.body_velocity
    rest = torch.exp(-_mean_square(wanted) / 0.1**2)
    speed = _squared(s.robot.body_velocity[:, _FEET]).clamp(max=1.0).sum(-1)
    lifted = (s.robot.foot_force[..., 2] < _CONTACT_N).float().sum(-1)
    return rest * (speed + 0.5 * lifted)


def contact_mismatch(s: TrackingState) -> torch.Tensor:
    """Feet that bear load where the reference clearly swings them, or the reverse."""
    height = s.wanted_soles
    speed = s.reference.body_velocity[:, _FEET].norm(dim=-1)
    stands, swings = (height < 0.015) & (speed < 0.3), height > 0.03
    loaded = _loaded(s)
    return ((stands & ~loaded) | (swings & loaded)).float().sum(-1)


def airborne(s: TrackingState) -> torch.Tensor:
    """In the air although the reference has a foot on the ground: no hopping gaits."""
    low = s.wanted_soles.amin(-1) < 0.02
    return (~_loaded(s).any(-1) & low).float()


def leg_distance(s: TrackingState) -> torch.Tensor:
    """Metres between feet and the reference's, and half of that between knees.

    Seen from the pelvis; means of left and right. Unlike closeness it also tells legs
    that are out of step which way to go.
    """
    robot, reference = s.robot.body_position, s.reference.body_position
    moved = (robot - reference)[:, g1.ROOT, None]

    def away(part: slice) -> torch.Tensor:
        error = robot[:, part] - reference[:, part] - moved
        return _distance(error, _NEAR).clamp(max=_FAR).mean(1)

    return away(_FEET) + 0.5 * away(_KNEES)


def correction_rate(s: TrackingState) -> torch.Tensor:
    """Squared change of the action beyond what the reference asks for, action units².

    A robot that trembles pays for it, one that steps with the reference, however
    quickly, does not. It holds where actions are offsets to the default pose for legs
    and waist and to the reference for arms: with the guidance "arms" or "springs".
    """
    asked = s.period * s.reference.joint_velocities[:, LEGS]
    asked = asked / _ACTION_SCALE.like(asked)[LEGS]
    change = s.action - s.previous_action
    return _squared(change[:, LEGS] - asked) + _squared(change[:, LEGS.stop :])


def velocity_distance(s: TrackingState) -> torch.Tensor:
    """Metres per second between key bodies and the reference's, mean: E_vel."""
    away = s.robot.body_velocity - s.reference.body_velocity
    return _distance(away, _SLOW).mean(-1)


def body_distance(s: TrackingState) -> torch.Tensor:
    """Metres between key bodies and the reference's in the world, mean: MPKPE.

    Unlike closeness it still has a slope far away.
    """
    away = s.robot.body_position - s.reference.body_position
    return _distance(away, _NEAR).clamp(max=_FAR).mean(-1)
