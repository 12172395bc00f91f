"""The G1's table against mjlab's MJCF and motor constants, and unknown joints."""

from __future__ import annotations

import re

import mujoco
import numpy as np
import pytest

from openclone.errors import InputError
from openclone.robot import g1
from openclone.robot.model import g1_xml


@pytest.fixture(scope="module")
def mjcf() -> mujoco.MjModel:
    return mujoco.MjModel.from_xml_path(str(g1_xml()))


def test_joint_order_is_unitrees() -> None:
    # Unitree's motor order as its documentation counts it: 6 + 6 + 3 + 7 + 7.
    assert g1.NUM_JOINTS == 29
    parts = [name.split("_")[0] for name in g1.JOINT_NAMES]
    assert (
        parts
        == ["left"] * 6 + ["right"] * 6 + ["waist"] * 3 + ["left"] * 7 + ["right"] * 7
    )
    numbers = {
        "left_knee_joint": 3,
        "right_hip_pitch_joint": 6,
        "right_ankle_roll_joint": 11,
        "waist_yaw_joint": 12,
        "left_shoulder_pitch_joint": 15,
        "left_elbow_joint": 18,
        "right_shoulder_pitch_joint": 22,
        "right_wrist_yaw_joint": 28,
    }
    for name, number in numbers.items():
        assert g1.joint_index(name) == number


def test_names_and_limits_are_the_mjcfs(mjcf: mujoco.MjModel) -> None:
    names = [mjcf.joint(index).name for index in range(1, mjcf.njnt)]
    assert tuple(names) == g1.JOINT_NAMES
    limits = np.stack((g1.JOINT_LOWER, g1.JOINT_UPPER), axis=1)
    assert np.allclose(limits, mjcf.jnt_range[1:], atol=1e-6)
    assert (g1.DEFAULT_POSE >= g1.JOINT_LOWER).all()
    assert (g1.DEFAULT_POSE <= g1.JOINT_UPPER).all()
    for body in g1.KEY_BODIES:
        assert mjcf.body(body).id > 0


def test_motors_and_gains_are_mjlabs() -> None:
    from mjlab.asset_zoo.robots.unitree_g1 import g1_constants

    seen = set()
    for actuator in g1_constants.G1_ARTICULATION.actuators:
        for pattern in actuator.target_names_expr:
            for index, name in enumerate(g1.JOINT_NAMES):
                if not re.fullmatch(pattern, name):
                    continue
                seen.add(name)
                assert np.isclose(g1.ARMATURE[index], actuator.armature)
                assert np.isclose(g1.MAX_TORQUE[index], actuator.effort_limit)
                assert np.isclose(g1.KP[index], actuator.stiffness)
                assert np.isclose(g1.KD[index], actuator.damping)
                scale = g1_constants.G1_ACTION_SCALE[pattern]
                assert np.isclose(g1.ACTION_SCALE[index], scale)
    assert seen == set(g1.JOINT_NAMES)
    assert g1_constants.ACTUATOR_7520_22.velocity_limit == g1.M7520_22.max_speed
    assert g1_constants.HOME_KEYFRAME.pos[2] == g1.STANDING_HEIGHT


def test_gains_are_the_published_ones() -> None:
    # BeyondMimic's printed gains, rounded to one decimal (kp) and two (kd).
    printed = {
        "left_hip_pitch_joint": (40.2, 2.56),
        "right_knee_joint": (99.1, 6.31),
        "left_ankle_roll_joint": (28.5, 1.81),
        "waist_pitch_joint": (28.5, 1.81),
        "right_elbow_joint": (14.3, 0.91),
        "left_wrist_yaw_joint": (16.8, 1.07),
    }
    for name, (kp, kd) in printed.items():
        assert g1.KP[g1.joint_index(name)] == pytest.approx(kp, abs=0.06)
        assert g1.KD[g1.joint_index(name)] == pytest.approx(kd, abs=0.006)


def test_left_and_right_mirror_each_other() -> None:
    for name in g1.JOINT_NAMES:
        if not name.startswith("left"):
            continue
        left = g1.joint_index(name)
        right = g1.joint_index(name.replace("left", "right"))
        limits = np.array([g1.JOINT_LOWER[right], g1.JOINT_UPPER[right]])
        if "roll" in name or "yaw" in name:
            limits = -limits[::-1]
        assert np.allclose(limits, [g1.JOINT_LOWER[left], g1.JOINT_UPPER[left]])
        assert g1.KP[left] == g1.KP[right]


def test_unknown_joint_names_the_remedy() -> None:
    with pytest.raises(InputError, match=r"no joint 'left_toe_joint'.*robot joints"):
        g1.joint_index("left_toe_joint")
