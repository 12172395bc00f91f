"""The student's side of the training task: what it would measure on a real robot."""

from __future__ import annotations

import numpy as np
import torch

from openclone.odometry.faults import OdometryFaults, OdometryFaultsConfig
from openclone.odometry.noise import OdometryNoise, OdometryNoiseConfig
from openclone.policy import observation
from openclone.policy.command import Command, KeyPoints
from openclone.policy.constants import Constant
from openclone.policy.observation import History, Proprioception
from openclone.robot import g1
from openclone.robot.model import CONTROL_PERIOD
from openclone.robot.state import RobotState, key_point_poses, key_point_velocities
from openclone.spatial import rotations
from openclone.training.task import StepResult, TrackingTask

_DEFAULT_POSE = Constant(g1.DEFAULT_POSE)


def sensed_frame(robot: RobotState, action: torch.Tensor) -> torch.Tensor:
    """The frame of history that robots sense after ``action (n, 29)``, ``(n, 93)``."""
    base = robot.body_quat[:, g1.ROOT]
    spin = robot.body_angular_velocity[:, g1.ROOT]
    now = Proprioception(
        joint_angles=robot.joint_angles,
        joint_velocities=robot.joint_velocities,
        angular_velocity_b=rotations.rotate_inverse(base, spin),
        base_quat=base,
    )
    return observation.frame(now, action, _DEFAULT_POSE.like(action))


def student_input(
    robot: RobotState, command: Command, error: torch.Tensor, history: History
) -> torch.Tensor:
    """What students of n robots see, ``(n, 2388)``.

    Args:
        robot: true states.
        command: targets for t + 1.
        error: (n, 1, 3), metres, of the odometry.
        history: of the robots.
    """
    position, quat = key_point_poses(robot.body_position, robot.body_quat)
    measured = KeyPoints(position + error, quat)
    heading = rotations.heading(robot.body_quat[:, g1.ROOT])
    task = observation.task(command, measured, heading)
    return observation.student(task, history)


class StudentView:
    """History, odometry error and actions of the robots of a task."""

    def __init__(
        self,
        task: TrackingTask,
        history: int,
        noise: OdometryNoiseConfig,
        rng: np.random.Generator,
        faults: OdometryFaultsConfig | None = None,
    ) -> None:
        """Start with each robot's first frame.

        Args:
            task: the robots.
            history: frames of history.
            noise: the odometry's error, Eq. 2.
            rng: source of the odometry's errors.
            faults: what else is wrong with it; None: nothing.
        """
        self.task = task
        self._scale = task.action_scale
        self._noise = OdometryNoise(task.num_envs, noise, rng)
        self.error = torch.zeros(task.num_envs, 1, 3, device=task.device)
        """(n, 1, 3), metres, of the odometry."""
        self._faults = None
        if faults is not None and faults != OdometryFaultsConfig():
            # A stream of its own leaves the draws of Eq. 2 as they are without faults.
            stream = rng.spawn(1)[0]
            start = self._head_position()
            self._faults = OdometryFaults(start, faults, CONTROL_PERIOD, stream)
        self.action = torch.zeros_like(task.action)
        self.history = History(sensed_frame(task.robot_state(), self.action), history)

    def to_target(self, action: torch.Tensor) -> torch.Tensor:
        """Joint targets of the student's action: default pose + scale x action."""
        return _DEFAULT_POSE.like(action) + self._scale * action

    def to_action(self, targets: torch.Tensor) -> torch.Tensor:
        """The student's action that gives ``targets``."""
        return (targets - _DEFAULT_POSE.like(targets)) / self._scale

    def command(self) -> Command:
        """Targets for t + 1: the reference's head and hands."""
        return self.task.command()

    def observe(self) -> torch.Tensor:
        """The student's input, ``(n, 2388)``."""
        robot = self.task.robot_state()
        return student_input(robot, self.command(), self.error, self.history)

    def step(self, action: torch.Tensor) -> StepResult:
        """Apply the student's action for one period and take in the new sensors."""
        task = self.task
        result = task.step(self.to_target(action))
        self.action = action.clone()
        robot = task.robot_state()
        ids = result.ended.to(task.device)
        self.action[ids] = 0.0
        velocity = key_point_velocities(robot)[:, 0]
        self._measure(result.ended.numpy(), velocity.cpu().numpy())
        frame = sensed_frame(robot, self.action)
        self.history.push(frame)
        self.history.refill(ids, frame[ids])
        return result

    def _head_position(self) -> np.ndarray:
        robot = self.task.robot_state()
        points, _ = key_point_poses(robot.body_position, robot.body_quat)
        return points[:, 0].double().cpu().numpy()

    def _measure(self, born: np.ndarray, velocity: np.ndarray) -> None:
        """New odometry error of the head; ``born`` robots start without any."""
        self._noise.reset(born)
        error = self._noise.step(velocity, CONTROL_PERIOD)
        if self._faults is not None:
            position = self._head_position()
            self._faults.reset(born, position[born])
            error = self._faults.step(position, error) - position
        self.error = torch.from_numpy(error).to(self.error)[:, None]
