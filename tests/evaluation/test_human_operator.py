from pathlib import Path

import numpy as np
import pytest

from openclone.evaluation.human_operator import operator_of_motion
from openclone.motion.clip import ClipInfo
from openclone.motion.library import read_recording
from openclone.motion.retarget import FPS, retarget
from openclone.motion.skeleton import start_at_origin
from openclone.policy.command import KeyPoints
from openclone.robot.kinematics import Kinematics
from openclone.robot.state import key_point_poses
from openclone.spatial import rotations
from openclone.teleop.calibration import RobotBody, calibrate


@pytest.mark.parametrize(
    ("name", "metres"),
    [("cmu/test_walking_1.bvh", 0.06), ("hdm05/HDM_dg_squat1Reps_025_120.amc", 0.12)],
)
def test_live_targets_look_like_the_retargeted_motion(
    recordings: Path, name: str, metres: float
) -> None:
    """Calibration and retargeting lead from one human to the robot by two ways.

    The person squats on the toes; the robot's ankles end the retargeted squat earlier.
    """
    motion = start_at_origin(read_recording(recordings / name).resampled(FPS))
    clip, _ = retarget(motion, ClipInfo("clip", "transition", "", "", FPS))
    kinematics = Kinematics()
    wanted, wanted_quat = key_point_poses(*kinematics.trajectory(clip.qpos))
    recording, config = operator_of_motion(motion)
    calibration = calibrate(
        recording.positions[0],
        recording.quats[0],
        KeyPoints(wanted[0], wanted_quat[0]),
        rotations.heading(wanted_quat[0, 0]),
        RobotBody.of(kinematics),
        config,
    )
    found = calibration.apply(recording.positions, recording.quats)
    count = min(len(wanted), len(found.position))
    error = found.position[:count] - wanted[:count]
    error -= error[:, :1].mean(0) * [1, 1, 0]  # where the origin lies is arbitrary
    assert np.linalg.norm(error, axis=-1).mean() < metres
    turn = rotations.angle_between(found.quat[:count, 1:], wanted_quat[:count, 1:])
    assert np.degrees(turn).mean() < 15.0
