"""From the operator's body and room to the robot's: scale, heading and origin.

The operator stands, the robot stands; one frame fixes the map. The head follows the
operator's head, scaled by height. A hand follows the operator's wrist as seen from the
shoulder, scaled by arm length, so that a stretched arm stays a stretched arm. Shoulders
are not tracked: they are placed below the head by the proportions of the body.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from openclone.errors import InputError
from openclone.policy.command import KeyPoints
from openclone.robot import g1
from openclone.robot.kinematics import Kinematics
from openclone.robot.model import standing_qpos
from openclone.spatial import rotations

_SIDES = np.array([1.0, -1.0])


@dataclass(frozen=True)
class BodyProportions:
    """The operator's body as shares of the height of the head point when standing.

    Human averages, fitted to 114 retargeted recordings of seven actors: so the live
    targets look to the policy like the motions it was trained on.

    Attributes:
        shoulder_side, shoulder_down: shoulder from the head point, to the side and
            down, in the head's heading frame.
        arm: shoulder to wrist, stretched.
    """

    shoulder_side: float = 0.125
    shoulder_down: float = 0.10
    arm: float = 0.357


@dataclass(frozen=True)
class OperatorBody:
    """The operator's own measures.

    Attributes:
        head_height: metres, head point above the floor when standing upright.
        arm: metres, shoulder to wrist, stretched; None: by proportion.
    """

    head_height: float
    arm: float | None = None


@dataclass(frozen=True)
class CalibrationConfig:
    """How the operator's body becomes the robot's.

    Attributes:
        operator: the operator's measures; None: head height at calibration.
        heading_deg: direction in the operator's world, about Z, that becomes the
            robot's heading; None: where the head looks at calibration.
        travel_scale: metres of the robot per metre of the operator's way; None: the
            ratio of heights, so that strides fit the robot's legs; 1.0: the robot
            goes exactly as far as the operator, as in the paper's experiments.
        proportions: what is not measured of the operator's body.
        arm_gain: fitted with the proportions; makes up for elbows that are never
            quite straight.
        reach: metres, the hand point stays this near to the robot's shoulder.
    """

    operator: OperatorBody | None = None
    heading_deg: float | None = None
    travel_scale: float | None = None
    proportions: BodyProportions = field(default_factory=BodyProportions)
    arm_gain: float = 1.05
    reach: float = 0.42


@dataclass(frozen=True)
class RobotBody:
    """The standing robot's measures, from its kinematics.

    Attributes:
        head_height: metres, head key point above the ground.
        shoulder: (2, 3), metres, left and right shoulder from the head key point,
            in the heading frame.
        arm: metres, shoulder to wrist, stretched.
    """

    head_height: float
    shoulder: np.ndarray
    arm: float

    @staticmethod
    def of(kinematics: Kinematics) -> RobotBody:
        """Measure the robot in its standing pose and with straight arms."""
        qpos = standing_qpos()
        points, _ = kinematics.key_points(qpos)
        # Arms hanging straight: from the roll joint's height down to the wrist.
        elbow = g1.joint_index("left_elbow_joint")
        qpos[7 + g1.joint_index("left_shoulder_pitch_joint") : 7 + elbow] = 0.0
        qpos[7 + elbow] = 0.5 * np.pi
        bodies, _ = kinematics.bodies(qpos)
        upper = bodies[g1.KEY_BODIES.index("left_shoulder_roll_link")]
        wrist = bodies[g1.WRISTS[0]]
        left = np.array([upper[0], wrist[1], upper[2]]) - points[0]
        return RobotBody(
            head_height=float(points[0, 2]),
            shoulder=np.stack((left, left * np.array([1.0, -1.0, 1.0]))),
            arm=float(np.linalg.norm(wrist - (points[0] + left))),
        )


@dataclass(frozen=True)
class Calibration:
    """The map from the operator's world to the robot's odometry world.

    Attributes:
        turn: (4,), wxyz, yaw only, robot's world from operator's.
        operator_origin, robot_origin: (2,), metres, ground points that correspond.
        head_scale: of heights; travel_scale: of horizontal ways.
        operator_shoulder: (2, 3), metres, from the head point, heading frame.
        robot: the robot's measures.
        arm_scale: of the hand as seen from the shoulder.
        reach: metres, limit of the hand's distance from the shoulder.
    """

    turn: np.ndarray
    operator_origin: np.ndarray
    robot_origin: np.ndarray
    head_scale: float
    travel_scale: float
    operator_shoulder: np.ndarray
    robot: RobotBody
    arm_scale: float
    reach: float

    def apply(self, positions: np.ndarray, quats: np.ndarray) -> KeyPoints:
        """Map operator points ``(..., 3, 3)`` and ``(..., 3, 4)`` to robot targets."""
        turn = np.broadcast_to(self.turn, quats.shape)
        origin = np.append(self.operator_origin, 0.0)
        place = rotations.rotate(turn, positions - origin)
        quat = rotations.multiply(turn, quats)
        head = place[..., 0, :] * self._scale()
        head[..., :2] += self.robot_origin
        heading = rotations.heading(quat[..., :1, :]) + 0.0 * quat[..., 1:, :]
        shoulder = rotations.rotate(
            heading, self.operator_shoulder + 0 * place[..., 1:, :]
        )
        arm = place[..., 1:, :] - place[..., :1, :] - shoulder
        hand = self._hand(arm * self.arm_scale, heading, quat[..., 1:, :])
        hands = head[..., None, :] + hand
        return KeyPoints(np.concatenate((head[..., None, :], hands), -2), quat)

    def anchored(
        self, positions: np.ndarray, quats: np.ndarray, held: KeyPoints
    ) -> Calibration:
        """The same scales, moved and turned so that the head lands on ``held``'s.

        Args:
            positions: (3, 3), metres, operator's world, now.
            quats: (3, 4), wxyz, operator's world from point, now.
            held: targets that the robot holds; only the head's place and heading count.
        """
        back = rotations.conjugate(rotations.heading(quats[0]))
        return replace(
            self,
            turn=rotations.multiply(rotations.heading(held.quat[0]), back),
            operator_origin=positions[0, :2].copy(),
            robot_origin=held.position[0, :2].copy(),
        )

    def _scale(self) -> np.ndarray:
        return np.array([self.travel_scale, self.travel_scale, self.head_scale])

    def _hand(
        self, wrist: np.ndarray, heading: np.ndarray, quat: np.ndarray
    ) -> np.ndarray:
        """Hand from the head point; ``wrist (..., 2, 3)`` is seen from the shoulder."""
        hand = wrist + rotations.rotate(quat, np.array(g1.HAND_OFFSET) + 0 * wrist)
        distance = rotations.norm(hand)
        hand = hand * np.minimum(1.0, self.reach / np.maximum(distance, 1e-9))
        return hand + rotations.rotate(heading, self.robot.shoulder + 0 * wrist)


def calibrate(
    positions: np.ndarray,
    quats: np.ndarray,
    measured: KeyPoints,
    heading: np.ndarray,
    body: RobotBody,
    config: CalibrationConfig,
) -> Calibration:
    """Fix the map from one frame of a standing operator.

    Args:
        positions: (3, 3), metres, operator's world.
        quats: (3, 4), wxyz, operator's world from point.
        measured: the robot's head and hands now, by odometry.
        heading: (4,), wxyz, yaw only, of the robot's base now.
        body: the robot's measures.
        config: how the bodies correspond.

    Raises:
        InputError: the head is not at a human height.
    """
    operator = config.operator or OperatorBody(float(positions[0, 2]))
    height = operator.head_height
    if not 0.5 <= height <= 2.5:
        raise InputError(
            f"the operator's head is {height:.2f} m above the floor",
            where="calibration",
            remedy="stand upright; check the headset's floor level and its unit",
        )
    scale = body.head_height / height
    part = config.proportions
    side = _SIDES[:, None] * np.array([0.0, part.shoulder_side, 0.0])
    shoulder = side - np.array([0.0, 0.0, part.shoulder_down])
    ahead = rotations.heading(quats[0])
    if config.heading_deg is not None:
        ahead = rotations.from_yaw(np.radians(config.heading_deg))
    turn = rotations.multiply(heading, rotations.conjugate(ahead))
    return Calibration(
        turn=turn,
        operator_origin=positions[0, :2].copy(),
        robot_origin=measured.position[0, :2].copy(),
        head_scale=scale,
        travel_scale=scale if config.travel_scale is None else config.travel_scale,
        operator_shoulder=shoulder * height,
        robot=body,
        arm_scale=config.arm_gain * body.arm / (operator.arm or part.arm * height),
        reach=config.reach,
    )


def measure_operator(
    positions: np.ndarray, quats: np.ndarray, proportions: BodyProportions
) -> OperatorBody:
    """The operator's measures from a whole recording.

    The head's height is a high percentile, since a recording may begin in a crouch, but
    not its maximum, which may be a jump. The arm is the distance that the wrists rarely
    exceed, kept within what is human for that height.

    Args:
        positions: (T, 3, 3), metres, operator's world.
        quats: (T, 3, 4), wxyz.
        proportions: of the human body.
    """
    height = float(np.percentile(positions[:, 0, 2], 90))
    heading = rotations.heading(quats[:, :1]) + 0.0 * quats[:, 1:]
    side = _SIDES[:, None] * np.array([0.0, proportions.shoulder_side, 0.0])
    shoulder = (side - np.array([0.0, 0.0, proportions.shoulder_down])) * height
    offset = rotations.rotate(heading, shoulder + 0.0 * positions[:, 1:])
    arms = positions[:, 1:] - positions[:, :1] - offset
    seen = float(np.percentile(np.linalg.norm(arms, axis=-1), 95))
    usual = proportions.arm * height
    return OperatorBody(height, float(np.clip(seen, 0.78 * usual, 1.1 * usual)))
