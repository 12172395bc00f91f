"""The sensor head of the simulated G1: what its LiDAR and IMU deliver while it moves.

One `HeadSensors` watches one robot. The physics tells it every step; it answers with
IMU readings at once and, ten times a second, with the motion that a LiDAR frame is
traced from. Tracing is left to the caller, who may do it in another thread.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import mujoco
import numpy as np

from openclone.robot.model import TIMESTEP, SensorLayout
from openclone.simulation.imu import (
    IMU_IN_LIDAR,
    ImuConfig,
    ImuSample,
    SimulatedImu,
)
from openclone.simulation.lidar import Mid360Config, Motion, SimulatedLidar
from openclone.simulation.robot import SimulatedRobot
from openclone.simulation.worlds import World
from openclone.spatial.poses import Pose

_STEP_NS = round(TIMESTEP * 1e9)
_IMU_IN_LIDAR = np.array(IMU_IN_LIDAR)


@dataclass(frozen=True)
class SensorConfig:
    """Settings of both sensors."""

    lidar: Mid360Config = field(default_factory=Mid360Config)
    imu: ImuConfig = field(default_factory=ImuConfig)


class HeadSensors:
    """LiDAR and IMU of one simulated robot, on a clock that starts at zero."""

    def __init__(
        self,
        robot: SimulatedRobot,
        world: World,
        seed: int = 0,
        config: SensorConfig | None = None,
    ) -> None:
        """Watch ``robot``, which lives in ``world``; equal seeds give equal errors."""
        self._robot, self._world = robot, world
        self._config = config or SensorConfig()
        lidar_rng, imu_rng = np.random.default_rng(seed).spawn(2)
        self.lidar = SimulatedLidar(world, self._config.lidar, lidar_rng)
        self.imu = SimulatedImu(self._config.imu, TIMESTEP, imu_rng)
        self._layout = SensorLayout.of(world.model)
        self._data = mujoco.MjData(world.model)
        self._frame_steps = round(self._config.lidar.frame_s / TIMESTEP)
        self.now_ns = 0
        self._poses: list[tuple[int, Pose, np.ndarray]] = []
        self._motions: list[Motion] = []
        self._complete: list[Motion] = []
        self._stamps: list[int] = []
        self._qpos: list[np.ndarray] = []
        self._observe()
        robot.watch(self._step)

    def hold_still(self, seconds: float) -> None:
        """Let time pass for the sensors alone, while something holds the robot.

        A real G1 hangs in its gantry while its odometry starts.
        """
        for _ in range(round(seconds / TIMESTEP)):
            self._step()

    def take_imu(self) -> list[ImuSample]:
        """Readings since the last call, oldest first."""
        taken, self._poses = self._poses, []
        if not taken:
            return []
        return self.imu.update(
            np.array([stamp for stamp, _, _ in taken]),
            np.array([pose.position for _, pose, _ in taken]),
            np.array([pose.quat for _, pose, _ in taken]),
            np.array([force for _, _, force in taken]),
        )

    def take_motions(self) -> list[Motion]:
        """Motions of the frames completed since the last call, for `lidar.trace`."""
        taken, self._motions = self._motions, []
        return taken

    def _step(self) -> None:
        """The physics has advanced by one step."""
        self.now_ns += _STEP_NS
        self._observe()

    def _observe(self) -> None:
        """Note where everything is now."""
        robot, data = self._robot, self._data
        self._world.move_people(robot.data, self.now_ns * 1e-9)
        data.qpos[:] = robot.data.qpos
        mujoco.mj_kinematics(self._world.model, data)
        force = robot.data.sensordata[self._layout.foot_force].reshape(2, 3)[:, 2]
        self._poses.append((self.now_ns, imu_pose(data), np.abs(force)))
        # The reading at a frame's end comes one step later, and the frame after it.
        self._motions += self._complete
        self._complete = []
        self._stamps.append(self.now_ns)
        self._qpos.append(data.qpos.copy())
        if len(self._stamps) > self._frame_steps:
            motion = Motion(np.array(self._stamps), np.array(self._qpos))
            self._complete.append(motion)
            # A frame begins where the one before it ended.
            del self._stamps[:-1], self._qpos[:-1]


def imu_pose(data: mujoco.MjData) -> Pose:
    """World from IMU, after `mj_kinematics` of any model with the site ``lidar``."""
    site = data.site("lidar")
    quat = np.empty(4)
    mujoco.mju_mat2Quat(quat, site.xmat)
    return Pose(site.xpos + site.xmat.reshape(3, 3) @ _IMU_IN_LIDAR, quat)
