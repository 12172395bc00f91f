"""Joint targets that alone would give the reference's torques: inverse dynamics.

A PD controller whose target is the reference angle lags behind fast motions and sinks
under load. Newton's laws say which torques a motion takes; the controller gives them
if its target lies ahead by ``(τ + k_d q̇) / k_p``. The teacher then only learns what
they leave: balance.
"""

from __future__ import annotations

import mujoco
import numpy as np
from scipy.ndimage import gaussian_filter1d
from scipy.optimize import nnls

from openclone.robot import g1
from openclone.robot.model import CONTROL_PERIOD, SOLE_CORNERS

_FEET = ("left_ankle_roll_link", "right_ankle_roll_link")
_NEAR = 0.02
"""Metres above the lowest corner of both soles; what is nearer can carry load."""
_FLIGHT = 0.04
"""Metres; higher soles carry nothing."""
_FRICTION = 0.6
_CONE = np.array(
    [[_FRICTION, 0, 1], [-_FRICTION, 0, 1], [0, _FRICTION, 1], [0, -_FRICTION, 1]]
)
"""(4, 3): edges of a friction cone; a force is a sum of them."""
_WRENCH = np.array([1.0, 1.0, 1.0, 5.0, 5.0, 5.0])
"""A newton metre that is not accounted for weighs as much as five newtons."""
_EVENLY = 1e-2
"""Weight of the forces themselves, which spreads them over the corners."""
_SMOOTHING_FRAMES = 1.0
_LARGEST = g1.MAX_TORQUE / g1.KP


def feedforward(
    model: mujoco.MjModel, qpos: np.ndarray, qvel: np.ndarray, ground: bool = True
) -> np.ndarray:
    """Offsets of the joint targets to the joint angles, ``(T, 29)``, radians.

    Forces on the soles are the least ones, inside friction cones, that explain the
    acceleration of the whole body; what they cannot explain is left to the policy.

    Args:
        model: the robot.
        qpos: (T, 36), one motion at 50 Hz.
        qvel: (T, 35), its smoothed velocities.
        ground: with the forces on the soles, which take most of the time and change
            the legs alone; without them the legs' offsets are those of free flight.
    """
    data = mujoco.MjData(model)
    acceleration = np.gradient(qvel, CONTROL_PERIOD, axis=0) if len(qvel) > 1 else qvel
    offsets = np.empty((len(qpos), g1.NUM_JOINTS))
    feet = [model.body(name).id for name in _FEET]
    disabled = model.opt.disableflags
    # Forces of constraints are what is sought here; MuJoCo must not add its own.
    model.opt.disableflags = disabled | mujoco.mjtDisableBit.mjDSBL_CONSTRAINT
    try:
        for index in range(len(qpos)):
            data.qpos[:], data.qvel[:] = qpos[index], qvel[index]
            data.qacc[:] = acceleration[index]
            mujoco.mj_inverse(model, data)
            torque = data.qfrc_inverse
            if ground:
                torque = torque - _contact_torque(model, data, feet)
            offsets[index] = (torque[6:] + g1.KD * qvel[index, 6:]) / g1.KP
    finally:
        model.opt.disableflags = disabled
    offsets = np.clip(offsets, -_LARGEST, _LARGEST)
    return gaussian_filter1d(offsets, _SMOOTHING_FRAMES, axis=0, mode="nearest")


def _contact_torque(
    model: mujoco.MjModel, data: mujoco.MjData, feet: list[int]
) -> np.ndarray:
    """(35,): generalized force of the ground on the soles."""
    corners = [
        (foot, data.xpos[foot] + data.xmat[foot].reshape(3, 3) @ corner)
        for foot in feet
        for corner in SOLE_CORNERS
    ]
    lowest = min(float(point[2]) for _, point in corners)
    if lowest > _FLIGHT:
        return np.zeros(model.nv)
    jacobian = np.empty((3, model.nv))
    columns = []
    for foot, point in corners:
        if point[2] < lowest + _NEAR:
            mujoco.mj_jac(model, data, jacobian, None, point, foot)
            columns.append(jacobian.T @ _CONE.T)
    forces = np.concatenate(columns, 1)
    count = forces.shape[1]
    shares, _ = nnls(
        np.vstack((forces[:6] * _WRENCH[:, None], _EVENLY * np.eye(count))),
        np.concatenate((data.qfrc_inverse[:6] * _WRENCH, np.zeros(count))),
    )
    return forces @ shares
