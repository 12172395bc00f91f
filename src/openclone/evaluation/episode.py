"""One closed-loop run: the student on the simulated robot follows a reference.

At 50 Hz the student is told where head and hands of the reference will be at the next
step and nothing else; the robot's own head position comes with the odometry error of
Eq. 2.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import mujoco
import numpy as np

from openclone.errors import InputError
from openclone.evaluation import metrics
from openclone.evaluation.metrics import Trace
from openclone.motion.clip import Clip
from openclone.odometry.noise import OdometryNoise, OdometryNoiseConfig
from openclone.policy.bundle import Bundle
from openclone.policy.command import Command, KeyPoints
from openclone.policy.controller import StudentController
from openclone.policy.observation import Proprioception
from openclone.robot import g1
from openclone.robot.model import CONTROL_PERIOD, SensorLayout
from openclone.robot.state import (
    RobotState,
    key_point_poses,
    key_point_velocities,
    read_state,
)
from openclone.simulation.robot import SimulatedRobot
from openclone.spatial import rotations
from openclone.training.reference import generalized_velocities, sensed

MIN_PELVIS_HEIGHT = 0.2
"""Metres; lower, and the robot has fallen."""
MAX_TILT_DEG = 60.0
"""Trunk's up-vector further than this from the reference's is a fall."""


@dataclass(frozen=True)
class Reference:
    """A clip at 50 Hz, with everything that commands and metrics need.

    Attributes:
        qpos: (T, 36), MuJoCo positions.
        start_velocity: (35,), MuJoCo velocities at the first frame.
        position, quat: (T, 14, 3) and (T, 14, 4), key bodies, world.
        points, point_quats: (T, 3, 3) and (T, 3, 4), head and hands, world.
        point_velocities: (T, 3, 3), m/s, world, smoothed as in training.
    """

    qpos: np.ndarray
    start_velocity: np.ndarray
    position: np.ndarray
    quat: np.ndarray
    points: np.ndarray
    point_quats: np.ndarray
    point_velocities: np.ndarray


def make_reference(clip: Clip, model: mujoco.MjModel) -> Reference:
    """Resample ``clip`` to the control rate and run the kinematics over it."""
    qpos = clip.resampled(1.0 / CONTROL_PERIOD).qpos
    if len(qpos) < 2:
        raise InputError(
            f"the clip lasts {clip.seconds:.3f} s, less than one control step",
            where=clip.info.name,
            remedy="leave it out",
        )
    qvel = generalized_velocities(model, qpos)
    moving = read_state(SensorLayout.of(model), qpos, qvel, sensed(model, qpos, qvel))
    points, point_quats = key_point_poses(moving.body_position, moving.body_quat)
    return Reference(
        qpos=qpos,
        start_velocity=qvel[0],
        position=moving.body_position,
        quat=moving.body_quat,
        points=points,
        point_quats=point_quats,
        point_velocities=key_point_velocities(moving),
    )


def has_fallen(position: np.ndarray, quat: np.ndarray, reference: np.ndarray) -> bool:
    """Whether a robot with key bodies ``(14, 3)``, ``(14, 4)`` lies or falls.

    Args:
        position: metres, world.
        quat: wxyz, world from body.
        reference: (14, 4), the reference's; bowing is no fall where it bows too.
    """
    up = np.array([0.0, 0.0, 1.0])
    trunk = rotations.rotate(quat[g1.TORSO], up)
    wanted = rotations.rotate(reference[g1.TORSO], up)
    tilted = float(trunk @ wanted) < math.cos(math.radians(MAX_TILT_DEG))
    return tilted or float(position[g1.ROOT, 2]) < MIN_PELVIS_HEIGHT


class Episode:
    """The student on the simulated robot, one control step at a time."""

    def __init__(
        self,
        robot: SimulatedRobot,
        bundle: Bundle,
        noise: OdometryNoiseConfig | None,
        rng: np.random.Generator,
    ) -> None:
        """Take over ``robot`` as it stands; ``noise`` of None is perfect odometry."""
        self._robot = robot
        self._controller = StudentController(bundle)
        self._noise = OdometryNoise(1, noise, rng) if noise else None
        self.state = robot.true_state()

    def step(self, command: Command) -> RobotState:
        """Let the student act on ``command`` for one period; the state after it."""
        state = self.state
        points, quats = key_point_poses(state.body_position, state.body_quat)
        if self._noise is not None:
            # Odometry locates the head; hands follow by kinematics: one offset for all.
            head = key_point_velocities(state)[None, 0]
            points = points + self._noise.step(head, CONTROL_PERIOD)
        reading = self._robot.reading()
        now = Proprioception(
            joint_angles=reading.joint_angles,
            joint_velocities=reading.joint_velocities,
            angular_velocity_b=reading.angular_velocity_b,
            base_quat=reading.base_quat,
        )
        targets = self._controller.step(command, now, KeyPoints(points, quats))
        self._robot.write(targets)
        self._robot.advance()
        self.state = self._robot.true_state()
        return self.state


def run_clip(
    episode: Episode, reference: Reference, look: bool = True
) -> tuple[Trace, np.ndarray]:
    """Follow ``reference`` to its end or to a fall.

    Args:
        episode: the robot on the first frame.
        reference: what it is commanded.
        look: tell the student how the head is turned (`Command.look`).

    Returns:
        The trace, frames 1 to T of the reference, and the robot's qpos ``(T, 36)``.
    """
    positions, quats, contacts, angles = [], [], [], []
    fell = False
    for t in range(1, len(reference.qpos)):
        target = KeyPoints(reference.points[t], reference.point_quats[t])
        velocity = reference.point_velocities[t]
        state = episode.step(Command(target, velocity, float(look)))
        positions.append(state.body_position.copy())
        quats.append(state.body_quat.copy())
        angles.append(state.joint_angles.copy())
        contacts.append(state.foot_force[:, 2] > metrics.CONTACT_FORCE)
        fell = has_fallen(positions[-1], quats[-1], reference.quat[t])
        if fell:
            break
    count = len(positions)
    trace = Trace(
        period=CONTROL_PERIOD,
        position=np.array(positions),
        quat=np.array(quats),
        reference_position=reference.position[1 : count + 1],
        reference_quat=reference.quat[1 : count + 1],
        contact=np.array(contacts),
        fell=fell,
    )
    root = (trace.position[:, g1.ROOT], trace.quat[:, g1.ROOT])
    return trace, np.concatenate((*root, np.array(angles)), axis=1)
