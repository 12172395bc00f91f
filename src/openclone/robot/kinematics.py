"""Forward kinematics of key bodies and key points, by MuJoCo."""

from __future__ import annotations

import mujoco
import numpy as np

from openclone.robot import g1
from openclone.robot.model import build_model
from openclone.robot.state import key_point_poses


class Kinematics:
    """Key bodies and key points for given joint angles and root pose."""

    def __init__(self, model: mujoco.MjModel | None = None) -> None:
        """Use ``model`` (any model with the G1's bodies) or build one."""
        self._model = model or build_model(floor=False)
        self._data = mujoco.MjData(self._model)
        self._bodies = [self._model.body(name).id for name in g1.KEY_BODIES]

    def bodies(self, qpos: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Key-body poses ``(14, 3)`` and ``(14, 4)``, world, for ``qpos (36,)``."""
        self._data.qpos[:] = qpos
        mujoco.mj_kinematics(self._model, self._data)
        return self._data.xpos[self._bodies], self._data.xquat[self._bodies]

    def key_points(self, qpos: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Head and hand poses ``(3, 3)`` and ``(3, 4)``, world, for ``qpos (36,)``."""
        return key_point_poses(*self.bodies(qpos))

    def trajectory(self, qpos: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Key-body poses ``(T, 14, 3)`` and ``(T, 14, 4)`` for ``qpos (T, 36)``."""
        count = len(self._bodies)
        positions = np.empty((len(qpos), count, 3))
        quats = np.empty((len(qpos), count, 4))
        for index, row in enumerate(qpos):
            positions[index], quats[index] = self.bodies(row)
        return positions, quats
