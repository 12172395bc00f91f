"""The link to a simulated robot in the same process."""

from __future__ import annotations

import numpy as np

from openclone.odometry.ground_truth import GroundTruthOdometry
from openclone.simulation.robot import FallLimits, RobotReading, SimulatedRobot
from openclone.teleop.lidar_odometry import LidarOdometry
from openclone.teleop.robots.protocol import Truth


class SimulatedLink:
    """Advances the simulation by one control period with every command.

    A stand-in odometry is told the truth at every reading; LiDAR odometry hears of the
    joints alone and has sensors of its own.
    """

    def __init__(
        self,
        robot: SimulatedRobot,
        odometry: GroundTruthOdometry | LidarOdometry,
        limits: FallLimits | None = None,
    ) -> None:
        """Take over ``robot`` as it stands."""
        self._robot = robot
        self._odometry = odometry
        self._limits = limits or FallLimits()

    def read(self, now_ns: int) -> RobotReading:
        """The simulated sensors; also feeds the odometry."""
        reading = self._robot.reading()
        if isinstance(self._odometry, LidarOdometry):
            self._odometry.observe(now_ns, reading.joint_angles)
        else:
            position, quat = self._robot.base_pose()
            velocity = self._robot.head_velocity()
            self._odometry.observe(now_ns, position, quat, velocity)
        return reading

    def write(self, joint_targets: np.ndarray) -> None:
        """Apply the targets ``(29,)``, radians, for one control period."""
        self._robot.write(joint_targets)
        self._robot.advance()

    def damp(self) -> None:
        """Let one control period pass with soft joints."""
        self._robot.damp()
        self._robot.advance()

    def truth(self) -> Truth:
        """The simulation's state."""
        robot = self._robot
        return Truth(robot.qpos, robot.qvel, robot.fallen(self._limits))
