"""The seam between the task and the physics.

A backend steps a batch of robots and returns the same three arrays everywhere:
generalized positions, velocities and the sensor vector declared in `robot.model`.
"""

from __future__ import annotations

import copy
import os
from dataclasses import dataclass
from typing import Protocol

import mujoco
import numpy as np
import torch
from mujoco import rollout

from openclone.robot import g1

BASE = g1.KEY_BODIES[g1.ROOT]
"""Body whose centre of mass is moved (Table A2, base CoM offset)."""


@dataclass(frozen=True)
class RobotParameters:
    """What distinguishes n robots physically (Table A2); L links, 29 joints.

    Attributes:
        friction: (n,), sliding friction of the feet on the ground.
        com_offset: (n, 3), metres, shift of the base's centre of mass, base frame.
        link_mass: (n, L), factors on mass and inertia of each link.
        p_gain, d_gain: (n, 29), factors on the motors' gains.
    """

    friction: np.ndarray
    com_offset: np.ndarray
    link_mass: np.ndarray
    p_gain: np.ndarray
    d_gain: np.ndarray


def apply_parameters(
    model: mujoco.MjModel,
    nominal: mujoco.MjModel,
    scratch: mujoco.MjData,
    parameters: RobotParameters,
    row: int,
) -> None:
    """Make ``model`` the robot ``row`` of ``parameters``.

    Args:
        model: changed; a copy of ``nominal``.
        nominal: the unchanged robot, which all factors refer to.
        scratch: work space of the same sizes.
        parameters: of n robots.
        row: which of them.
    """
    feet = foot_geoms(nominal)
    model.geom_friction[feet, 0] = parameters.friction[row]
    model.body_ipos[:] = nominal.body_ipos
    model.body_ipos[nominal.body(BASE).id] += parameters.com_offset[row]
    factor = parameters.link_mass[row]
    model.body_mass[1:] = nominal.body_mass[1:] * factor
    model.body_inertia[1:] = nominal.body_inertia[1:] * factor[:, None]
    model.actuator_gainprm[:, 0] = nominal.actuator_gainprm[:, 0]
    model.actuator_gainprm[:, 0] *= parameters.p_gain[row]
    model.actuator_biasprm[:, 1] = -model.actuator_gainprm[:, 0]
    model.actuator_biasprm[:, 2] = nominal.actuator_biasprm[:, 2]
    model.actuator_biasprm[:, 2] *= parameters.d_gain[row]
    # Inverse weights and subtree masses, which the solver scales constraints with.
    mujoco.mj_setConst(model, scratch)


def foot_geoms(model: mujoco.MjModel) -> list[int]:
    """Geoms that carry the robot; their friction counts, as they have priority."""
    return [index for index in range(model.ngeom) if "_foot" in model.geom(index).name]


class Physics(Protocol):
    """A batch of simulated robots.

    Attributes:
        num_envs: number of robots n.
        links: bodies of each robot, L.
        device: where the state lives and controls are wanted.
    """

    num_envs: int
    links: int
    device: torch.device

    def reset(self, ids: np.ndarray, qpos: np.ndarray, qvel: np.ndarray) -> None:
        """Put the robots ``ids`` into the given states and refresh their sensors."""
        ...

    def push(self, ids: np.ndarray, velocity: np.ndarray) -> None:
        """Add ``velocity (len(ids), 3)``, m/s, world, to the roots (Table A2)."""
        ...

    def randomize(self, ids: np.ndarray, parameters: RobotParameters) -> None:
        """Give the robots ``ids`` the parameters in rows 0 to len(ids) - 1."""
        ...

    def copy(self, sources: np.ndarray) -> None:
        """Give every robot parameters, state and sensors of ``sources[robot]``."""
        ...

    def step(self, ctrl: torch.Tensor) -> None:
        """Advance all robots by ``ctrl (n, substeps, nu)``, joint targets."""
        ...

    def read(self) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Copies of qpos, qvel, sensordata: (n, 36), (n, 35), (n, s), float32."""
        ...


class ThreadedPhysics:
    """`mujoco.rollout`: MuJoCo's C++ threads, one `MjModel` per robot if wanted.

    Attributes:
        qpos, qvel, sensordata: (n, 36), (n, 35), (n, s), current, float64.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        num_envs: int,
        threads: int | None = None,
        models: list[mujoco.MjModel] | None = None,
        device: torch.device | None = None,
    ) -> None:
        """Create ``num_envs`` robots.

        Args:
            model: defines sizes; used for every robot unless ``models`` is given.
            num_envs: number of robots.
            threads: worker threads; all cores by default.
            models: one model per robot, for randomized parameters.
            device: where states are wanted; the CPU by default. Another one costs two
                copies per control step.
        """
        threads = threads or os.cpu_count() or 1
        self.num_envs = num_envs
        self.links = model.nbody - 1
        self.device = device or torch.device("cpu")
        self._nominal = model
        self._models = list(models) if models else [model] * num_envs
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

    def randomize(self, ids: np.ndarray, parameters: RobotParameters) -> None:
        """Give the robots ``ids`` the parameters in rows 0 to len(ids) - 1."""
        for row, robot in enumerate(ids):
            # A new one: another robot may have been given the same.
            model = self._models[robot] = copy.copy(self._nominal)
            apply_parameters(model, self._nominal, self._forward, parameters, row)

    def copy(self, sources: np.ndarray) -> None:
        """Give every robot parameters, state and sensors of ``sources[robot]``."""
        self._models = [self._models[source] for source in sources]
        self._state[:] = self._state[sources]
        self.sensordata = self.sensordata[sources]

    def step(self, ctrl: torch.Tensor) -> None:
        """Advance all robots by ``ctrl (n, substeps, nu)``, joint targets."""
        substeps = ctrl.shape[1]
        if ctrl.shape != (self.num_envs, substeps, self._nominal.nu):
            raise ValueError(f"controls for {self.num_envs} robots, not {ctrl.shape}")
        if substeps not in self._buffers:
            shape = (self.num_envs, substeps)
            self._buffers[substeps] = (
                np.empty((*shape, self._state.shape[1])),
                np.empty((*shape, self.sensordata.shape[1])),
            )
        states, sensors = self._buffers[substeps]
        # The wrapper's own checks would take as long as the rewards do.
        self._pool.rollout(
            self._models,
            self._datas,
            self._state,
            np.ascontiguousarray(ctrl.cpu(), dtype=np.float64),
            skip_checks=True,
            nstep=substeps,
            state=states,
            sensordata=sensors,
        )
        self._state[:] = states[:, -1]
        self.sensordata = sensors[:, -1]

    def read(self) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Copies of qpos, qvel, sensordata: (n, 36), (n, 35), (n, s), float32."""
        arrays = (self.qpos, self.qvel, self.sensordata)
        qpos, qvel, sensors = (
            torch.from_numpy(array.astype(np.float32)).to(self.device)
            for array in arrays
        )
        return qpos, qvel, sensors
