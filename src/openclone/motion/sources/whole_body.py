"""From a plan (feet, zero-moment point, trunk, arms) to whole-body motion of the G1.

The centre of mass is found from the zero-moment point (Vukobratovic). For a body whose
angular momentum hardly changes,

    (g + z'') p = (g + z'') c - z c''

holds for the horizontal zero-moment point p and centre of mass (c, z). With p planned
for all frames, c is the solution of a tridiagonal system with rest at both ends. In
flight g + z'' = 0, and the same line says c'' = 0. What the angular momentum adds is
measured by inverse dynamics and fed back into p (Kajita et al. 2003).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import mujoco
import numpy as np

from openclone.motion.balance import GRAVITY, pendulum_path
from openclone.motion.sources.serial_chain import SerialChain
from openclone.robot import g1
from openclone.robot.model import SOLE_CORNERS, SOLE_Z, build_model
from openclone.spatial import rotations

_PADDING_S = 1.5
"""Seconds of rest added at both ends while solving, so that clips start at rest."""
_CORRECTION_LIMIT = 0.2
"""Metres; the largest change that the feedback of the dynamics makes to p."""
_MAX_ZMP_ERROR = 0.06
"""Metres that the zero-moment point may finally miss the planned one, in x or y."""
_MIN_LOAD_N = 100.0
"""Newtons, a third of the weight; with less the zero-moment point means nothing."""
_COM_GAIN = 1.3
"""Metres of pelvis per metre of centre of mass: the feet stay where they are."""
_ROUNDING = 0.25
"""Radius of the rounding of the sole's edges in the air, per metre of lift."""
_MARGIN = 0.032
"""Radians that every leg joint keeps from its limits."""


@dataclass(frozen=True)
class Plan:
    """What is decided before the inverse kinematics; T frames.

    Attributes:
        fps: frames per second.
        foot_xy: (T, 2, 2), metres, world: ankles of the left and right foot, flat.
        foot_yaw, foot_pitch: (T, 2), radians.
        foot_lift: (T, 2), metres: lowest point of the sole above the ground.
        zmp: (T, 2), metres, world.
        height: (T,), metres: the pelvis, or with ``ballistic`` the centre of mass.
        ballistic: whether ``height`` means the centre of mass (jumps).
        trunk: (T, 3), radians: yaw, pitch, roll of the pelvis (ZYX).
        upper_joints: (T, 17), radians: waist and arms in motor order.
    """

    fps: float
    foot_xy: np.ndarray
    foot_yaw: np.ndarray
    foot_pitch: np.ndarray
    foot_lift: np.ndarray
    zmp: np.ndarray
    height: np.ndarray
    ballistic: bool
    trunk: np.ndarray
    upper_joints: np.ndarray


class Unreachable(Exception):
    """The legs cannot do what the plan asks: a joint would leave its range."""


class TooFar(Unreachable):
    """The legs are too short; a lower pelvis helps."""


class Unbalanced(Unreachable):
    """The body's own swing moves the zero-moment point too far from the plan."""


@cache
def g1_model() -> mujoco.MjModel:
    """The G1 without floor, built once."""
    return build_model(floor=False)


@cache
def _legs() -> tuple[SerialChain, SerialChain]:
    model, tip = g1_model(), (0.0, 0.0, 0.0)
    return (
        SerialChain.of(model, "pelvis", "left_ankle_roll_link", tip),
        SerialChain.of(model, "pelvis", "right_ankle_roll_link", tip),
    )


def com_from_zmp(
    zmp: np.ndarray, com_height: np.ndarray, lift: np.ndarray, fps: float
) -> np.ndarray:
    """Horizontal centre of mass ``(T, 2)`` that has the given zero-moment point.

    Args:
        zmp: (T, 2), metres, world.
        com_height: (T,), metres.
        lift: (T,), g + z'', metres per second squared.
        fps: frames per second.
    """
    pad = int(_PADDING_S * fps)
    zmp = np.pad(zmp, ((pad, pad), (0, 0)), mode="edge")
    height = np.pad(com_height, pad, mode="edge")
    lift = np.pad(lift, pad, constant_values=GRAVITY)
    return pendulum_path(lift[:, None] * zmp, height, lift, fps)[pad:-pad]


def centre_of_mass(qpos: np.ndarray) -> np.ndarray:
    """Centre of mass ``(T, 3)``, metres, world, of positions ``(T, 36)``."""
    model = g1_model()
    data = mujoco.MjData(model)
    result = np.empty((len(qpos), 3))
    for index, row in enumerate(qpos):
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        result[index] = data.subtree_com[1]
    return result


def zero_moment_point(qpos: np.ndarray, fps: float) -> np.ndarray:
    """Zero-moment point ``(T, 2)`` from inverse dynamics; NaN where little pushes."""
    model = g1_model()
    data = mujoco.MjData(model)
    qvel = np.empty((len(qpos) - 1, model.nv))
    for index in range(len(qvel)):
        mujoco.mj_differentiatePos(
            model, qvel[index], 1.0 / fps, qpos[index], qpos[index + 1]
        )
    result = np.full((len(qpos), 2), np.nan)
    for index in range(1, len(qpos) - 1):
        data.qpos[:] = qpos[index]
        data.qvel[:] = 0.5 * (qvel[index - 1] + qvel[index])
        data.qacc[:] = (qvel[index] - qvel[index - 1]) * fps
        mujoco.mj_inverse(model, data)
        force = data.qfrc_inverse[:3]
        if force[2] < _MIN_LOAD_N:
            continue
        moment = data.xmat[1].reshape(3, 3) @ data.qfrc_inverse[3:6]
        x, y, z = qpos[index, :3]
        result[index, 0] = x - (moment[1] + z * force[0]) / force[2]
        result[index, 1] = y + (moment[0] - z * force[1]) / force[2]
    result[0], result[-1] = result[1], result[-2]
    return result


def _foot_targets(plan: Plan, side: int) -> tuple[np.ndarray, np.ndarray]:
    """Ankle positions ``(T, 3)`` and rotations ``(T, 3, 3)``, world.

    A pitched foot pivots about the edge of its sole that is lower, which stays where
    it was on the flat foot: rolling onto the toes or off the heel slides nothing.
    """
    pitch, lift = plan.foot_pitch[:, side], plan.foot_lift[:, side]
    angles = np.stack((plan.foot_yaw[:, side], pitch), 1)
    rotation = rotations.to_matrix(rotations.from_euler(angles, "ZY"))
    toe, heel = SOLE_CORNERS[:, 0].max(), SOLE_CORNERS[:, 0].min()
    sine, cosine = np.sin(pitch), np.cos(pitch)
    # Depth of the lower edge below the ankle. In the air the change from toe to heel
    # is rounded, or the ankle would jerk when the foot passes through the level.
    sway = 0.5 * (toe - heel) * sine
    rounded = np.sqrt(sway**2 + (_ROUNDING * lift) ** 2) - _ROUNDING * lift
    depth = 0.5 * (toe + heel) * sine + rounded - SOLE_Z * cosine
    pivot = np.where(pitch > 0, toe, heel)
    ahead = pivot - (cosine * pivot + sine * SOLE_Z)
    yaw = plan.foot_yaw[:, side]
    forward = np.stack((np.cos(yaw), np.sin(yaw)), 1)
    xy = plan.foot_xy[:, side] + ahead[:, None] * forward
    return np.column_stack((xy, lift + depth)), rotation


def _solve_legs(plan: Plan, root: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Leg angles ``(T, 12)`` for pelvis positions ``root (T, 3)``."""
    pelvis = rotations.to_matrix(rotations.from_euler(plan.trunk, "ZYX"))
    pelvis_from_world = pelvis.swapaxes(1, 2)
    angles = start.copy()
    for side, leg in enumerate(_legs()):
        position, rotation = _foot_targets(plan, side)
        local = (pelvis_from_world @ (position - root)[..., None])[..., 0]
        columns = slice(6 * side, 6 * side + 6)
        angles[:, columns], error = leg.reach_pose(
            local, pelvis_from_world @ rotation, start[:, columns]
        )
        if error.max() > 5e-4:
            raise TooFar
    return angles


def _first_guess(plan: Plan) -> np.ndarray:
    """Leg angles ``(T, 12)`` whose knees bend as much as the height asks."""
    drop = np.clip(0.8 - plan.height + plan.foot_lift.max(axis=1), 0.02, 0.5)
    knee = 2.0 * np.arccos(np.clip(1.0 - drop / 0.62, -1.0, 1.0))
    guess = np.zeros((len(knee), 12))
    for side in range(2):
        guess[:, 6 * side] = -0.5 * knee - plan.trunk[:, 1]
        guess[:, 6 * side + 3] = knee
        guess[:, 6 * side + 4] = np.maximum(-0.5 * knee, -0.8)
    return guess


def _lift_force(com_height: np.ndarray, fps: float) -> np.ndarray:
    """Vertical specific force g + z'', never negative, ``(T,)``."""
    acceleration = np.zeros_like(com_height)
    acceleration[1:-1] = np.diff(com_height, 2) * fps**2
    return np.maximum(GRAVITY + acceleration, 0.0)


def _follow_com(
    plan: Plan, com_xy: np.ndarray, qpos: np.ndarray, iterations: int
) -> np.ndarray:
    """Shift the pelvis until the centre of mass is where it should be."""
    qpos = qpos.copy()
    for _ in range(iterations):
        com = centre_of_mass(qpos)
        qpos[:, :2] += _COM_GAIN * (com_xy - com[:, :2])
        if plan.ballistic:
            qpos[:, 2] += _COM_GAIN * (plan.height - com[:, 2])
        qpos[:, 7:19] = _solve_legs(plan, qpos[:, :3], qpos[:, 7:19])
    return qpos


def _check_legs(qpos: np.ndarray, margin: float) -> None:
    """Raise `Unreachable` if a leg joint comes within ``margin`` of its limits."""
    legs = qpos[:, 7:19]
    if legs[:, [3, 9]].min() < margin:
        raise TooFar
    lower, upper = g1.JOINT_LOWER[:12] + margin, g1.JOINT_UPPER[:12] - margin
    if np.any(legs < lower) or np.any(legs > upper):
        raise Unreachable


def _solve(plan: Plan) -> np.ndarray:
    offset = 0.09 if plan.ballistic else 0.0
    qpos = np.empty((len(plan.zmp), 36))
    com_xy = com_from_zmp(
        plan.zmp, plan.height - 0.09 + offset, _lift_force(plan.height, plan.fps),
        plan.fps,
    )  # fmt: skip
    qpos[:, :2] = com_xy
    qpos[:, 2] = plan.height + offset
    qpos[:, 3:7] = rotations.from_euler(plan.trunk, "ZYX")
    qpos[:, 19:] = plan.upper_joints
    qpos[:, 7:19] = _solve_legs(plan, qpos[:, :3], _first_guess(plan))
    qpos = _follow_com(plan, com_xy, qpos, 1)
    _check_legs(qpos, 0.0)
    qpos = _follow_com(plan, com_xy, qpos, 1)
    reference = plan.zmp.copy()
    for _ in range(4):
        error = np.nan_to_num(plan.zmp - zero_moment_point(qpos, plan.fps))
        reference += np.clip(error, -_CORRECTION_LIMIT, _CORRECTION_LIMIT)
        height = centre_of_mass(qpos)[:, 2]
        force = _lift_force(height, plan.fps)
        com_xy = com_from_zmp(reference, height, force, plan.fps)
        qpos = _follow_com(plan, com_xy, qpos, 2)
    _check_legs(qpos, _MARGIN)
    error = np.nan_to_num(plan.zmp - zero_moment_point(qpos, plan.fps))
    if np.abs(error).max() > _MAX_ZMP_ERROR:
        raise Unbalanced
    return qpos


def solve(plan: Plan) -> np.ndarray:
    """Positions ``(T, 36)`` of the G1 that carry out ``plan``.

    Raises:
        Unreachable: the feet are out of reach even with the pelvis 6 cm lower.
    """
    for lowered in (0.0, 0.01, 0.02, 0.035):
        try:
            return _solve(replace(plan, height=plan.height - lowered))
        except TooFar:
            continue
    return _solve(replace(plan, height=plan.height - 0.06))
