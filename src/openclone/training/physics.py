"""The seam between the task and the physics.

A backend steps a batch of robots and returns the same three arrays everywhere:
generalized positions, velocities and the sensor vector declared in `robot.model`.
"""

from __future__ import annotations

import os
from typing import Protocol

import mujoco
import numpy as np
from mujoco import rollout


class Physics(Protocol):
    """A batch of simulated robots.

    Attributes:
        num_envs: number of robots n.
        qpos, qvel, sensordata: (n, 36), (n, 35), (n, s), current.
    """

    num_envs: int
    qpos: np.ndarray
    qvel: np.ndarray
    sensordata: np.ndarray

    def reset(self, ids: np.ndarray, qpos: np.ndarray, qvel: np.ndarray) -> None:
        """Put the robots ``ids`` into the given states."""
        ...

    def step(self, ctrl: np.ndarray) -> None:
        """Advance all robots by ``ctrl (n, substeps, nu)``, joint targets."""
        ...


class ThreadedPhysics:
    """`mujoco.rollout`: MuJoCo's C++ threads, one `MjModel` per robot if wanted."""

    def __init__(
        self,
        model: mujoco.MjModel,
        num_envs: int,
        threads: int | None = None,
        models: list[mujoco.MjModel] | None = None,
    ) -> None:
        """Create ``num_envs`` robots.

        Args:
            model: defines sizes; used for every robot unless ``models`` is given.
            num_envs: number of robots.
            threads: worker threads; all cores by default.
            models: one model per robot, for randomized parameters.
        """
        threads = threads or os.cpu_count() or 1
        self.num_envs = num_envs
        self._models = models or [model] * num_envs
        self._datas = [mujoco.MjData(model) for _ in range(threads)]
        self._pool = rollout.Rollout(nthread=threads)
        self._forward = mujoco.MjData(model)
        size = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        self._state = np.zeros((num_envs, size))
        self._nq, self._nv = model.nq, model.nv
        self.qpos = self._state[:, 1 : 1 + model.nq]
        self.qvel = self._state[:, 1 + model.nq : 1 + model.nq + model.nv]
        self.sensordata = np.zeros((num_envs, model.nsensordata))
        self._buffers: dict[int, tuple[np.ndarray, np.ndarray]] = {}

    def reset(self, ids: np.ndarray, qpos: np.ndarray, qvel: np.ndarray) -> None:
        """Put the robots ``ids`` into the given states and refresh their sensors."""
        self._state[ids] = 0.0
        self.qpos[ids] = qpos
        self.qvel[ids] = qvel
        data = self._forward
        for index, robot in enumerate(ids):
            mujoco.mj_resetData(self._models[robot], data)
            data.qpos[:] = qpos[index]
            data.qvel[:] = qvel[index]
            mujoco.mj_forward(self._models[robot], data)
            self.sensordata[robot] = data.sensordata

    def push(self, ids: np.ndarray, velocity: np.ndarray) -> None:
        """Add ``velocity (len(ids), 3)``, m/s, world, to the roots (Table A2)."""
        self.qvel[ids, :3] += velocity

    def step(self, ctrl: np.ndarray) -> None:
        """Advance all robots by ``ctrl (n, substeps, nu)``, joint targets."""
        substeps = ctrl.shape[1]
        if substeps not in self._buffers:
            shape = (self.num_envs, substeps)
            self._buffers[substeps] = (
                np.empty((*shape, self._state.shape[1])),
                np.empty((*shape, self.sensordata.shape[1])),
            )
        states, sensors = self._buffers[substeps]
        self._pool.rollout(
            self._models,
            self._datas,
            self._state,
            ctrl,
            state=states,
            sensordata=sensors,
        )
        self._state[:] = states[:, -1]
        self.sensordata[:] = sensors[:, -1]
