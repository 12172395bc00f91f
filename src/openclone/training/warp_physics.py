"""Physics by MuJoCo Warp: every robot a world on the GPU, or a few on the CPU.

On CUDA a control step is one graph of all its physics steps, and states and controls
are PyTorch views of Warp's arrays: nothing leaves the GPU. Only births and new bodies
come from the host. On the CPU device the same code runs slowly, for tests.
"""

from __future__ import annotations

import copy
from collections.abc import Callable

import mujoco
import mujoco_warp as mjw
import numpy as np
import torch
import warp as wp

from openclone.training.physics import RobotParameters, apply_parameters

_PER_ROBOT: tuple[str, ...] = (
    "geom_friction",
    "body_ipos",
    "body_mass",
    "body_subtreemass",
    "body_inertia",
    "body_invweight0",
    "dof_invweight0",
    "actuator_gainprm",
    "actuator_biasprm",
    "actuator_acc0",
)
"""Model fields that `apply_parameters` changes and Warp's physics reads."""


class WarpPhysics:
    """MuJoCo Warp behind the seam of `training.physics`.

    Attributes:
        num_envs: number of robots n.
        links: bodies of each robot.
        device: PyTorch's name of the device.
        qpos, qvel, sensordata: (n, 36), (n, 35), (n, s), float32, views of the
            simulation's own arrays.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        num_envs: int,
        device: str | None = None,
        contacts: int = 96,
        constraint_rows: int = 320,
    ) -> None:
        """Create ``num_envs`` robots.

        Args:
            model: the robot and its world.
            num_envs: number of robots.
            device: "cuda", "cuda:1" or "cpu"; the first GPU if there is one.
            contacts: per robot; more are dropped.
            constraint_rows: per robot; more are dropped.
        """
        # Warp otherwise reports every kernel that it loads.
        wp.config.log_level = wp.LOG_ERROR
        self._device = wp.get_device(device)
        self.device = torch.device(wp.device_to_torch(self._device))
        self.num_envs = num_envs
        self.links = model.nbody - 1
        self._nominal, self._robot = model, copy.copy(model)
        self._scratch = mujoco.MjData(model)
        with wp.ScopedDevice(self._device):
            sizes = dict.fromkeys(_PER_ROBOT, num_envs)
            self._model = mjw.put_model(model, batch_sizes=sizes)
            self._data = mjw.make_data(
                model, nworld=num_envs, nconmax=contacts, njmax=constraint_rows
            )
        self.qpos = wp.to_torch(self._data.qpos)
        self.qvel = wp.to_torch(self._data.qvel)
        self.sensordata = wp.to_torch(self._data.sensordata)
        self._warmstart = wp.to_torch(self._data.qacc_warmstart)
        self._fields = {
            name: wp.to_torch(getattr(self._model, name)) for name in _PER_ROBOT
        }
        self._ctrl: list[wp.array] = []
        self._graph: wp.Graph | None = None
        self._forward_graph: wp.Graph | None = None

    def reset(self, ids: np.ndarray, qpos: np.ndarray, qvel: np.ndarray) -> None:
        """Put the robots ``ids`` into the given states and refresh their sensors."""
        index = self._index(ids)
        self.qpos[index] = torch.from_numpy(qpos).to(self.qpos)
        self.qvel[index] = torch.from_numpy(qvel).to(self.qvel)
        self._warmstart[index] = 0.0
        # Forward dynamics runs for all worlds; the others keep their sensors.
        kept = self.sensordata.clone()
        with wp.ScopedDevice(self._device):
            if self._forward_graph is not None:
                wp.capture_launch(self._forward_graph)
            else:
                self._run_forward()
                self._forward_graph = self._capture(self._run_forward)
        fresh = self.sensordata[index]
        self.sensordata.copy_(kept)
        self.sensordata[index] = fresh

    def push(self, ids: np.ndarray, velocity: np.ndarray) -> None:
        """Add ``velocity (len(ids), 3)``, m/s, world, to the roots (Table A2)."""
        self.qvel[self._index(ids), :3] += torch.from_numpy(velocity).to(self.qvel)

    def randomize(self, ids: np.ndarray, parameters: RobotParameters) -> None:
        """Give the robots ``ids`` the parameters in rows 0 to len(ids) - 1."""
        rows: dict[str, list[np.ndarray]] = {name: [] for name in _PER_ROBOT}
        for row in range(len(ids)):
            apply_parameters(self._robot, self._nominal, self._scratch, parameters, row)
            for name, values in rows.items():
                values.append(np.array(getattr(self._robot, name)))
        index = self._index(ids)
        for name, values in rows.items():
            field = self._fields[name]
            field[index] = torch.from_numpy(np.stack(values)).to(field)

    def copy(self, sources: np.ndarray) -> None:
        """Give every robot parameters, state and sensors of ``sources[robot]``."""
        index = self._index(sources)
        state = (self.qpos, self.qvel, self._warmstart, self.sensordata)
        for part in (*state, *self._fields.values()):
            part.copy_(part[index])

    def step(self, ctrl: torch.Tensor) -> None:
        """Advance all robots by ``ctrl (n, substeps, nu)``, joint targets."""
        substeps = ctrl.shape[1]
        if ctrl.shape != (self.num_envs, substeps, self._nominal.nu):
            raise ValueError(f"controls for {self.num_envs} robots, not {ctrl.shape}")
        with wp.ScopedDevice(self._device):
            first = len(self._ctrl) != substeps
            if first:
                shape = (self.num_envs, self._nominal.nu)
                self._ctrl = [wp.zeros(shape, dtype=float) for _ in range(substeps)]
                self._graph = None
            for index, target in enumerate(self._ctrl):
                wp.to_torch(target).copy_(ctrl[:, index])
            if self._graph is not None:
                wp.capture_launch(self._graph)
                return
            # The first step compiles; capturing records without running.
            self._run_substeps()
            self._graph = self._capture(self._run_substeps)

    def read(self) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Copies of qpos, qvel, sensordata: (n, 36), (n, 35), (n, s), float32."""
        return self.qpos.clone(), self.qvel.clone(), self.sensordata.clone()

    def _run_substeps(self) -> None:
        for target in self._ctrl:
            wp.copy(self._data.ctrl, target)
            mjw.step(self._model, self._data)

    def _run_forward(self) -> None:
        mjw.forward(self._model, self._data)

    def _capture(self, work: Callable[[], None]) -> wp.Graph | None:
        """Record ``work`` as a CUDA graph; None on the CPU, which has none."""
        if not self._device.is_cuda:
            return None
        with wp.ScopedCapture() as capture:
            work()
        return capture.graph

    def _index(self, ids: np.ndarray) -> torch.Tensor:
        return torch.from_numpy(np.asarray(ids, dtype=np.int64)).to(self.device)
