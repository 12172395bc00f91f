"""The simulated G1: joint targets in, the readings of a real robot out."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import mujoco
import numpy as np

from openclone.robot import g1
from openclone.robot.model import (
    SUBSTEPS,
    SensorLayout,
    build_model,
    standing_qpos,
)
from openclone.robot.state import RobotState, read_state


@dataclass(frozen=True)
class RobotReading:
    """What a G1 reports about itself at one instant; the real one speaks the same.

    What comes from the IMU is one physics step (5 ms) older than the rest.

    Attributes:
        joint_angles: (29,), radians.
        joint_velocities: (29,), radians per second.
        torque: (29,), N m, estimated from the motors.
        base_quat: (4,), wxyz, world from pelvis; a real IMU's heading drifts.
        angular_velocity_b: (3,), radians per second, pelvis frame (gyroscope).
    """

    joint_angles: np.ndarray
    joint_velocities: np.ndarray
    torque: np.ndarray
    base_quat: np.ndarray
    angular_velocity_b: np.ndarray


@dataclass(frozen=True)
class FallLimits:
    """When a robot counts as fallen.

    Attributes:
        min_base_height: metres; the pelvis below this lies on the ground.
        max_tilt_deg: degrees between the trunk and the vertical.
    """

    min_base_height: float = 0.2
    max_tilt_deg: float = 60.0


class SimulatedRobot:
    """One G1 in MuJoCo, advanced one control period at a time."""

    def __init__(self, model: mujoco.MjModel | None = None) -> None:
        """Start standing, in ``model`` or in `robot.model.build_model`'s."""
        self.model = model if model is not None else build_model()
        self.data = mujoco.MjData(self.model)
        self._layout = SensorLayout.of(self.model)
        self._damping = False
        self._watchers: list[Callable[[], None]] = []
        self.reset(standing_qpos())

    def reset(self, qpos: np.ndarray, qvel: np.ndarray | None = None) -> None:
        """Put the robot at ``qpos (36,)``, moving with ``qvel (35,)`` or at rest."""
        mujoco.mj_resetData(self.model, self.data)
        self.data.qpos[:] = qpos
        if qvel is not None:
            self.data.qvel[:] = qvel
        self.data.ctrl[:] = qpos[7:]
        self._damping = False
        mujoco.mj_forward(self.model, self.data)
        self._read_imu()

    def write(self, joint_targets: np.ndarray) -> None:
        """Set the position targets ``(29,)``, radians, for the next `advance`."""
        self.data.ctrl[:] = joint_targets
        self._damping = False

    def damp(self) -> None:
        """Let the joints go soft: no stiffness, only damping, until `write`."""
        self._damping = True

    def advance(self) -> None:
        """Simulate one control period of 20 ms and refresh all sensors."""
        for _ in range(SUBSTEPS):
            if self._damping:
                # A target equal to the joint angle leaves only the velocity term.
                self.data.ctrl[:] = self.data.qpos[7:]
            mujoco.mj_step(self.model, self.data)
            for watcher in self._watchers:
                watcher()
        # mj_step computes sensors before it integrates. Policies learn with an IMU of
        # that age; with a younger one they walk 2 cm off.
        self._read_imu()
        mujoco.mj_forward(self.model, self.data)

    def _read_imu(self) -> None:
        sensors, layout = self.data.sensordata, self._layout
        self._base_quat = sensors[layout.quat][:4].copy()
        self._gyro = sensors[layout.gyro].copy()

    def watch(self, watcher: Callable[[], None]) -> None:
        """Call ``watcher`` after every physics step of 5 ms from now on.

        It finds the new positions and velocities in `data`; forces and other sensors
        there are those of the beginning of the step.
        """
        self._watchers.append(watcher)

    def reading(self) -> RobotReading:
        """What the robot's own sensors report now."""
        data = self.data
        return RobotReading(
            joint_angles=data.qpos[7:].copy(),
            joint_velocities=data.qvel[6:].copy(),
            torque=data.sensordata[self._layout.torque].copy(),
            base_quat=self._base_quat.copy(),
            angular_velocity_b=self._gyro.copy(),
        )

    def true_state(self) -> RobotState:
        """The full, privileged state (copies), for evaluation."""
        data = self.data
        return read_state(
            self._layout, data.qpos.copy(), data.qvel.copy(), data.sensordata.copy()
        )

    def base_pose(self) -> tuple[np.ndarray, np.ndarray]:
        """True pelvis position ``(3,)``, metres, and quaternion ``(4,)``, world."""
        return self.data.qpos[:3].copy(), self.data.qpos[3:7].copy()

    def head_velocity(self) -> np.ndarray:
        """True velocity of the head key point, ``(3,)``, m/s, world."""
        sensors, layout = self.data.sensordata, self._layout
        velocity = sensors[layout.velocity].reshape(-1, 3)[g1.TORSO]
        spin = sensors[layout.angular_velocity].reshape(-1, 3)[g1.TORSO]
        torso = self.data.body("torso_link")
        arm = torso.xmat.reshape(3, 3) @ np.array(g1.HEAD_OFFSET)
        return velocity + np.cross(spin, arm)

    @property
    def qpos(self) -> np.ndarray:
        """(36,) true positions, a copy."""
        return self.data.qpos.copy()

    @property
    def qvel(self) -> np.ndarray:
        """(35,) true velocities, a copy."""
        return self.data.qvel.copy()

    @property
    def time(self) -> float:
        """Seconds simulated since the last `reset`."""
        return float(self.data.time)

    def fallen(self, limits: FallLimits | None = None) -> bool:
        """Whether the pelvis is on the ground or the trunk tilts too far."""
        limits = limits or FallLimits()
        upright = float(self.data.body("torso_link").xmat[8])
        too_low = float(self.data.qpos[2]) < limits.min_base_height
        return too_low or upright < math.cos(math.radians(limits.max_tilt_deg))
