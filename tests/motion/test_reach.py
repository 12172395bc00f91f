"""Reachable targets: worked out by hand and by forward kinematics."""

from __future__ import annotations

import numpy as np
import pytest

from openclone.motion.reach import (
    hip_move,
    is_upright,
    pitched,
    upright_offset,
    within_waist,
)
from openclone.robot import g1
from openclone.robot.kinematics import Kinematics
from openclone.robot.model import standing_qpos
from openclone.spatial import rotations

Y = np.array([0.0, 1.0, 0.0])
WAIST = [7 + g1.joint_index(f"waist_{k}_joint") for k in ("yaw", "roll", "pitch")]


def poses(waist: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pelvis and torso (T, 4) of the robot with waist angles (T, 3)."""
    qpos = np.tile(standing_qpos(), (len(waist), 1))
    qpos[:, 3:7] = rotations.from_euler(np.array([[0.4, 0.2, -0.1]]), "ZYX")
    qpos[:, WAIST] = waist
    _, quats = Kinematics().trajectory(qpos)
    return quats[:, g1.ROOT], quats[:, g1.TORSO]


def test_a_waist_within_its_range_is_left_alone() -> None:
    pelvis, torso = poses(np.random.default_rng(0).uniform(-0.3, 0.3, (20, 3)))
    kept = within_waist(pelvis, torso)
    assert rotations.angle_between(kept, pelvis).max() < 1e-6


def test_beyond_it_the_pelvis_follows_the_torso() -> None:
    waist = np.array([[0.5, 0.0, 1.2], [-0.3, 0.9, 0.0], [0.0, -0.8, -1.0]])
    pelvis, torso = poses(waist)
    moved = within_waist(pelvis, torso)
    rest = rotations.to_matrix(rotations.multiply(rotations.conjugate(moved), torso))
    # Through MuJoCo: some waist angles inside the range join the two.
    roll = np.arcsin(rest[:, 2, 1])
    pitch = np.arctan2(-rest[:, 2, 0], rest[:, 2, 2])
    yaw = np.arctan2(-rest[:, 0, 1], rest[:, 1, 1])
    found = np.stack((yaw, roll, pitch), axis=1)
    assert np.abs(found[:, 1:]).max() < 0.5
    assert found[:, 0] == pytest.approx(waist[:, 0], abs=1e-6)
    root, chest = poses(found)
    joined = rotations.multiply(rotations.conjugate(root), chest)
    wanted = rotations.multiply(rotations.conjugate(moved), torso)
    assert rotations.angle_between(joined, wanted).max() < 1e-6


def test_a_tipped_pelvis_is_set_upright() -> None:
    """23 degrees back while standing: 8 degrees may be posture, 15 are the skeleton."""
    quat = np.tile(rotations.from_axis_angle(Y, np.radians(-23.0)), (30, 1))
    offset = upright_offset(quat, np.ones(30, dtype=bool))
    assert np.degrees(offset) == pytest.approx(-15)
    upright = pitched(quat, -offset)
    left = rotations.angle_between(upright, np.array([1.0, 0, 0, 0]))
    assert np.degrees(left) == pytest.approx(8)
    assert upright_offset(quat, np.zeros(30, dtype=bool)) == 0
    natural = np.tile(rotations.from_axis_angle(Y, np.radians(6.0)), (30, 1))
    assert upright_offset(natural, np.ones(30, dtype=bool)) == 0


def test_who_stands_upright() -> None:
    hip = np.zeros((3, 3))
    neck = np.array([[0.0, 0, 0.5], [0.3, 0, 0.4], [0.0, 0, 0.5]])
    leg = np.array([[0.99, 0.98], [0.99, 0.99], [0.99, 0.8]])
    assert is_upright(hip, neck, leg).tolist() == [True, False, False]


def shank_lean(ahead: float, up: float) -> float:
    """Forward lean of the shank by the cosine rule, limbs of 0.3 m each."""
    reach = np.hypot(ahead, up)
    return float(np.arctan2(ahead, up) + np.arccos(reach / 0.6))


def test_a_squat_is_raised_until_the_ankle_allows_it() -> None:
    leg = np.array([[0.0, 0.55], [0.0, 0.2], [-0.1, 0.2], [0.1, 0.25]])
    lift = 0.3 * hip_move(leg, np.zeros(4), 0.3, 0.3, 0.8, (0.0, 0.3))
    assert lift[0] == 0
    for (ahead, up), raised in zip(leg[1:], lift[1:], strict=True):
        before = shank_lean(ahead, up)
        after = shank_lean(ahead, up + raised)
        assert after == pytest.approx(min(before, 0.8), abs=0.01)
    # Hip above ankle: both limbs lean alike, 0.6 cos(0.8) high.
    assert 0.2 + lift[1] == pytest.approx(0.6 * np.cos(0.8), abs=0.001)


def test_a_raised_heel_allows_deeper_squats() -> None:
    leg = np.array([[0.0, 0.3]])
    flat = hip_move(leg, np.zeros(1), 0.3, 0.3, 0.8, (0.0, 0.3))
    on_toes = hip_move(leg, np.array([-0.4]), 0.3, 0.3, 0.8, (0.0, 0.3))
    assert 0.3 * flat[0] > 0.05
    assert on_toes[0] == 0


def test_a_hip_that_goes_back_need_not_rise() -> None:
    leg = np.array([[0.05, 0.3]])
    back = 0.2 * hip_move(leg, np.zeros(1), 0.3, 0.3, 0.8, (-0.2, 0.0))
    assert 0 < back[0] < 0.2
    assert shank_lean(0.05 - back[0], 0.3) == pytest.approx(0.8, abs=0.01)
    far = leg + np.array([[0.3, 0.0]])  # all of the way is not enough
    assert hip_move(far, np.zeros(1), 0.3, 0.3, 0.8, (-0.2, 0))[0] == 1
