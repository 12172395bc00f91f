"""The centre of mass of limbs against the model's own."""

import numpy as np
import pytest

from openclone.motion.masses import centre_of_limbs, knee_between
from openclone.motion.proportions import SHANK, THIGH, TORSO
from openclone.motion.sources.whole_body import centre_of_mass
from openclone.robot import g1
from openclone.robot.kinematics import Kinematics
from openclone.robot.model import standing_qpos
from openclone.spatial import rotations

_KINEMATICS = Kinematics()


def bent(knee: float, pitch: float) -> np.ndarray:
    """Feet flat under a trunk that leans by ``pitch``: hips flex, ankles give way."""
    qpos = standing_qpos()
    qpos[2] = 1.0
    qpos[3:7] = rotations.from_axis_angle(np.array([0.0, 1.0, 0.0]), pitch)
    for side in ("left", "right"):
        hip = -0.5 * knee - pitch
        for joint, angle in (
            ("hip_pitch", hip),
            ("knee", knee),
            ("ankle_pitch", -0.5 * knee),
        ):
            qpos[7 + g1.joint_index(f"{side}_{joint}_joint")] = angle
    return qpos


def estimated(qpos: np.ndarray) -> np.ndarray:
    place, turn = _KINEMATICS.bodies(qpos)
    at = {name: index for index, name in enumerate(g1.KEY_BODIES)}

    def link(name: str) -> np.ndarray:
        return place[at[name]][None]

    pelvis, pelvis_quat = link("pelvis"), turn[at["pelvis"]][None]
    torso = pelvis + rotations.rotate(pelvis_quat, TORSO)
    feet, arms = [], []
    for side in ("left", "right"):
        foot = f"{side}_ankle_roll_link"
        feet.append((link(foot), turn[at[foot]][None]))
        joints = ("shoulder_roll", "elbow", "wrist_yaw")
        arms.append(tuple(link(f"{side}_{j}_link") - torso for j in joints))
    torso_quat = turn[at["torso_link"]][None]
    return centre_of_limbs(pelvis, pelvis_quat, torso_quat, feet, arms)[0]


@pytest.mark.parametrize(
    ("knee", "pitch"), [(0.3, 0.0), (1.0, 0.2), (1.6, 0.5), (2.0, 0.8)]
)
def test_it_is_the_models_within_one_and_a_half_centimetres(knee, pitch):
    qpos = bent(knee, pitch)
    true = centre_of_mass(qpos[None])[0]
    np.testing.assert_allclose(estimated(qpos)[:2], true[:2], atol=0.015)
    assert estimated(qpos)[2] == pytest.approx(true[2], abs=0.02)


def test_a_knee_is_as_far_from_hip_and_ankle_as_the_bones_are_long():
    hip, ankle = np.array([[0.0, 0.1, 0.6]]), np.array([[0.1, 0.12, 0.1]])
    ahead = np.array([[1.0, 0.0, 0.0]])
    knee = knee_between(hip, ankle, ahead)
    assert np.linalg.norm(knee - hip) == pytest.approx(THIGH)
    assert np.linalg.norm(knee - ankle) == pytest.approx(SHANK)
    assert knee[0, 0] > 0.1
