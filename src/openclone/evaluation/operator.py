"""A human who would do what a clip does: the inverse of calibration.

Synthetic motions exist as clips of the G1 only. To send them through the whole of
teleoperation they need an operator: taller than the robot, with longer arms, whose
calibrated head and wrists come out at the clip's key points.
"""

from __future__ import annotations

import numpy as np

from openclone.motion.clip import Clip
from openclone.policy.command import KeyPoints
from openclone.robot import g1
from openclone.robot.kinematics import Kinematics
from openclone.robot.model import standing_qpos
from openclone.robot.state import key_point_poses
from openclone.spatial import rotations
from openclone.teleop.calibration import (
    CalibrationConfig,
    OperatorBody,
    RobotBody,
    calibrate,
)
from openclone.teleop.messages import OperatorRecording, recording_at_rate

HEAD_HEIGHT = 1.58
"""Metres; head point of a person of 1.70 m."""


def calibration_of_operator() -> CalibrationConfig:
    """Settings that undo `operator_of`."""
    return CalibrationConfig(operator=OperatorBody(HEAD_HEIGHT))


def operator_of(clip: Clip, kinematics: Kinematics) -> OperatorRecording:
    """Head and wrists of the human who performs ``clip``.

    Stretched arms are the exception to the inverse: calibration keeps hands within
    the robot's reach.
    """
    points, quats = key_point_poses(*kinematics.trajectory(clip.qpos))
    standing = KeyPoints(*kinematics.key_points(standing_qpos()))
    tall = np.full((3, 3), HEAD_HEIGHT)
    upright = np.tile(rotations.IDENTITY, (3, 1))
    config = calibration_of_operator()
    body = RobotBody.of(kinematics)
    scales = calibrate(tall, upright, standing, upright[0], body, config)
    head = points[:, :1]
    way = np.array([scales.travel_scale, scales.travel_scale, scales.head_scale])
    human_head = head / way
    heading = rotations.heading(quats[:, :1]) + 0.0 * quats[:, 1:]
    from_shoulder = (
        points[:, 1:]
        - head
        - rotations.rotate(heading, scales.robot.shoulder + 0.0 * points[:, 1:])
    )
    hand = rotations.rotate(quats[:, 1:], np.array(g1.HAND_OFFSET) + 0 * from_shoulder)
    arm = (from_shoulder - hand) / scales.arm_scale
    shoulder = rotations.rotate(heading, scales.operator_shoulder + 0 * arm)
    positions = np.concatenate((human_head, human_head + shoulder + arm), axis=1)
    return recording_at_rate(clip.info.name, clip.info.fps, positions, quats)
