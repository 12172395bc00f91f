"""Arms make way: spread the shoulders where an arm would pass through the body.

Gestures and squats are composed from parts that know nothing of each other, so a hand
may end up inside a thigh. Here the finished motion is checked with MuJoCo's collision
geometry and the shoulder of the arm concerned rolls outwards, smoothly, in time.
"""

from __future__ import annotations

from functools import cache

import mujoco
import numpy as np
from scipy.ndimage import gaussian_filter1d, maximum_filter1d

from openclone.robot.model import build_model

_TOUCH = 0.002
"""Metres of overlap that count as touching."""
_SPREAD = 0.12
"""Radians that one pass adds to the shoulder roll."""
_PASSES = 8
_SMOOTHING = 9.0
"""Frames; standard deviation of the filter that makes the spreading smooth."""
_ARM_PARTS = ("shoulder", "elbow", "wrist")
LEFT_ROLL, RIGHT_ROLL = 23, 30
"""Columns of the shoulder rolls in qpos; outwards is positive left, negative right."""


@cache
def _model() -> tuple[mujoco.MjModel, np.ndarray]:
    """The G1 that collides with itself, and each geometry's arm (-1: none)."""
    model = build_model(floor=False, self_collision=True)
    arm = np.full(model.ngeom, -1)
    for geom in range(model.ngeom):
        name = model.body(model.geom_bodyid[geom]).name
        if any(part in name for part in _ARM_PARTS):
            arm[geom] = int(name.startswith("right"))
    return model, arm


def touching(qpos: np.ndarray) -> np.ndarray:
    """(T, 2) whether the left and the right arm overlap with another body part."""
    model, arm = _model()
    data = mujoco.MjData(model)
    result = np.zeros((len(qpos), 2), dtype=bool)
    for index, row in enumerate(qpos):
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        for geom in data.contact.geom[data.contact.dist < -_TOUCH]:
            for side in arm[geom]:
                if side >= 0:
                    result[index, side] = True
    return result


def deepest_overlap(qpos: np.ndarray) -> float:
    """Metres by which two body parts overlap at worst in ``qpos (T, 36)``."""
    model, _ = _model()
    data = mujoco.MjData(model)
    deepest = 0.0
    for row in qpos:
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        if data.ncon:
            deepest = max(deepest, -float(data.contact.dist.min()))
    return deepest


def spread(qpos: np.ndarray) -> np.ndarray:
    """Outward shoulder rolls ``(T, 2)``, radians, that keep the arms clear.

    Args:
        qpos: (T, 36) positions at 50 frames per second.
    """
    qpos = qpos.copy()
    need = np.zeros((len(qpos), 2))
    offset = need
    for _ in range(_PASSES):
        hit = np.repeat(touching(qpos[::2]), 2, axis=0)[: len(qpos)]
        if not hit.any():
            break
        need = need + _SPREAD * hit
        wide = maximum_filter1d(need, round(5 * _SMOOTHING), axis=0)
        before = offset
        offset = gaussian_filter1d(wide, _SMOOTHING, axis=0, mode="nearest")
        qpos[:, LEFT_ROLL] += offset[:, 0] - before[:, 0]
        qpos[:, RIGHT_ROLL] -= offset[:, 1] - before[:, 1]
    return offset
