"""Retargeting: postures worked out by hand, and the promised quality on recordings."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import pytest

from openclone.motion import skeleton
from openclone.motion.clip import Clip, ClipInfo
from openclone.motion.library import read_recording
from openclone.motion.proportions import FPS, RetargetConfig
from openclone.motion.quality import ClipQuality
from openclone.motion.readers import read_motion
from openclone.motion.retarget import (
    CannotFollowError,
    Solver,
    retarget,
    start_at_origin,
)
from openclone.motion.skeleton import JOINTS, HumanMotion
from openclone.motion.targets import make_targets
from openclone.robot import g1
from openclone.robot.kinematics import Kinematics
from openclone.robot.model import SOLE_CORNERS, build_model
from openclone.spatial import rotations

Human = Callable[..., HumanMotion]
INFO = ClipInfo("test/motion", "stand", "made by a test", "CC0", 50.0)


@pytest.fixture(scope="module")
def solver() -> Solver:
    return Solver()


@pytest.fixture(scope="module")
def kinematics() -> Kinematics:
    return Kinematics(build_model(floor=False))


@pytest.fixture(scope="module")
def walk(recordings: Path, solver: Solver) -> tuple[Clip, ClipQuality]:
    """Two seconds of a recorded walk."""
    motion = read_recording(recordings / "accad" / "Female1_B03_Walk1.bvh")
    short = replace(motion, positions=motion.positions[:60], quats=motion.quats[:60])
    return retarget(short, replace(INFO, category="forward", fps=30.0), solver)


def arms_forward(motion: HumanMotion) -> HumanMotion:
    """Both arms stretched ahead, palms in, thumbs up."""
    positions, quats = motion.positions.copy(), motion.quats.copy()
    for side, sign in (("left", -1.0), ("right", 1.0)):
        forward = rotations.from_axis_angle(np.array([0.0, 0, 1]), sign * np.pi / 2)
        thumb_up = rotations.from_axis_angle(np.array([1.0, 0, 0]), sign * np.pi / 2)
        turn = rotations.multiply(thumb_up, forward)
        shoulder = motion.joint(f"{side}_shoulder")
        for part, reach in (("shoulder", 0.0), ("elbow", 0.28), ("wrist", 0.53)):
            index = JOINTS.index(f"{side}_{part}")
            positions[:, index] = shoulder + np.array([reach, 0, 0])
            quats[:, index] = turn
    return replace(motion, positions=positions, quats=quats)


def test_standing_human_makes_a_standing_robot(
    human: Human, solver: Solver, kinematics: Kinematics
) -> None:
    clip, quality = retarget(human(10), INFO, solver)
    assert clip.num_frames == 10
    assert np.allclose(clip.root_position[0, :2], 0)
    assert rotations.yaw(clip.root_quat[0]) == pytest.approx(0, abs=1e-9)
    positions, quats = kinematics.bodies(clip.qpos[-1])
    for foot in g1.FEET:
        soles = positions[foot] + rotations.rotate(quats[foot][None], SOLE_CORNERS)
        assert soles[:, 2] == pytest.approx(0, abs=0.003)
    # The same posture on both sides: mirrored joints differ in the signs of roll, yaw.
    joints = clip.joint_angles[-1]
    mirror = np.array([1, -1, -1, 1, 1, -1])
    assert joints[:6] == pytest.approx(mirror * joints[6:12], abs=0.02)
    assert (joints[[3, 9]] > 0.05).all()
    head, left, right = kinematics.key_points(clip.qpos[-1])[0]
    assert head[2] > 1.1
    assert left[1] > 0.12
    assert left[2] < 0.8
    assert right == pytest.approx(left * [1, -1, 1], abs=0.02)
    assert quality.ankle_mm < 2
    assert quality.self_share == 0


def test_stretched_arms_give_the_neutral_hand_frame(
    human: Human, solver: Solver, kinematics: Kinematics
) -> None:
    clip, quality = retarget(arms_forward(human(10)), INFO, solver)
    positions, quats = kinematics.bodies(clip.qpos[-1])
    for wrist, sign in zip(g1.WRISTS, (1, -1), strict=True):
        assert rotations.angle_between(quats[wrist], np.array([1.0, 0, 0, 0])) < 0.15
        # Upper arm and forearm of the G1 are 0.369 m long in all.
        shoulder = positions[g1.TORSO] + np.array([0.004, sign * 0.147, 0.245])
        reach = positions[wrist] - shoulder
        assert reach == pytest.approx([0.369, 0, 0], abs=0.03)
    assert quality.wrist_mm < 25


def test_path_is_scaled_by_the_legs_and_keeps_its_heading(
    human: Human, solver: Solver
) -> None:
    """A human who glides 1 m to the left while standing: no legs, just the path."""
    still = human(60)
    path = np.linspace(0, 1, 60)[:, None, None] * np.array([0, 1.0, 0])
    targets = make_targets(
        replace(still, positions=still.positions + path), RetargetConfig()
    )
    moved = targets.position["pelvis"][-1] - targets.position["pelvis"][0]
    scale = (0.306 + 0.318) / (0.42 + 0.41)
    assert moved == pytest.approx([0, scale, 0], abs=0.03)


def test_start_at_origin() -> None:
    rng = np.random.default_rng(3)
    qpos = rng.normal(size=(6, 36))
    qpos[:, 3:7] = rotations.normalize(qpos[:, 3:7])
    moved = start_at_origin(qpos)
    assert moved[0, :2] == pytest.approx([0, 0])
    assert rotations.yaw(moved[0, 3:7]) == pytest.approx(0, abs=1e-9)
    assert np.array_equal(moved[:, 7:], qpos[:, 7:])
    assert np.array_equal(moved[:, 2], qpos[:, 2])
    # Distances and turns between frames stay.
    assert np.linalg.norm(moved[5, :3] - moved[1, :3]) == pytest.approx(
        np.linalg.norm(qpos[5, :3] - qpos[1, :3])
    )
    assert rotations.angle_between(moved[5, 3:7], moved[1, 3:7]) == pytest.approx(
        rotations.angle_between(qpos[5, 3:7], qpos[1, 3:7])
    )


def test_recorded_walk_goes_forward_on_still_feet(
    walk: tuple[Clip, ClipQuality], kinematics: Kinematics
) -> None:
    clip, quality = walk
    assert clip.info.fps == FPS
    assert clip.root_position[-1, 0] > 1.0
    assert abs(clip.root_position[-1, 1]) < 0.4
    # Independently of `measure`: the lower foot's sole never slides nor sinks.
    positions, quats = kinematics.trajectory(clip.qpos)
    feet, turns = positions[:, list(g1.FEET)], quats[:, list(g1.FEET)]
    soles = feet[:, :, None] + rotations.rotate(turns[:, :, None], SOLE_CORNERS)
    assert soles[..., 2].min() > -0.005
    flat = (soles[..., 2].max(-1) < 0.003)[1:] & (soles[..., 2].max(-1) < 0.003)[:-1]
    speed = np.linalg.norm(np.diff(feet[..., :2], axis=0), axis=-1) * FPS
    assert flat.mean() > 0.2
    assert speed[flat].mean() < 0.03
    # Knees bend backwards only, and no joint is faster than allowed.
    assert clip.joint_angles[:, [3, 9]].min() > 0.0
    fastest = np.abs(np.diff(clip.joint_angles, axis=0)).max() * FPS
    assert fastest <= RetargetConfig().max_joint_speed + 1e-6
    assert (clip.joint_angles >= g1.JOINT_LOWER - 1e-6).all()
    assert (clip.joint_angles <= g1.JOINT_UPPER + 1e-6).all()
    assert quality.wrist_mm < 20
    assert quality.self_share < 0.02


def test_hands_out_of_reach_pull_the_body_nowhere(human: Human, solver: Solver) -> None:
    still = make_targets(human(12), RetargetConfig())
    away = {
        link: place + np.array([0.8, 0.3, 0.4]) * ("wrist" in link or "elbow" in link)
        for link, place in still.position.items()
    }
    qpos = solver.track(replace(still, position=away))
    wanted = still.position["pelvis"]
    assert np.linalg.norm(qpos[:, :3] - wanted, axis=1).max() < 0.002
    tilt = rotations.angle_between(qpos[:, 3:7], still.quat["pelvis"])
    assert tilt.max() < 0.01
    # The arms do what they can: both hands reach out ahead.
    data = mujoco.MjData(solver.model)
    data.qpos[:] = qpos[-1]
    mujoco.mj_kinematics(solver.model, data)
    for side in ("left", "right"):
        assert data.body(f"{side}_wrist_yaw_link").xpos[0] > 0.2


def test_hands_stay_out_of_the_body(human: Human, solver: Solver) -> None:
    """Arms that a slim human lets hang inside the robot's wide hips."""
    still = human(10)
    positions = still.positions.copy()
    for side, sign in (("left", 1.0), ("right", -1.0)):
        for part in ("elbow", "wrist"):
            positions[:, JOINTS.index(f"{side}_{part}"), 1] = sign * 0.10
    clip, quality = retarget(replace(still, positions=positions), INFO, solver)
    assert quality.self_share == 0
    model = build_model(floor=False, self_collision=True)
    data = mujoco.MjData(model)
    data.qpos[:] = clip.qpos[-1]
    mujoco.mj_forward(model, data)
    assert data.ncon == 0 or data.contact.dist.min() > -0.005


def test_an_impossible_motion_is_refused(human: Human, solver: Solver) -> None:
    still = human(30)
    positions = still.positions.copy()
    # A swapped marker: for a third of the time the left foot is two metres away.
    foot = [JOINTS.index(f"left_{part}") for part in ("ankle", "toe")]
    positions[10:20, foot] += np.array([-2.0, 0, 0.5])
    with pytest.raises(CannotFollowError, match="cannot follow it"):
        retarget(replace(still, positions=positions), INFO, solver)


@pytest.mark.parametrize("take", ["bk_squat1Reps_013_120", "bk_squat1Reps_016_120"])
def test_quick_deep_bends_ask_for_no_flight(recordings: Path, take: str) -> None:
    """Feet stay down, so the pelvis cannot be pulled down faster than it falls."""
    motion = read_motion(recordings / "hdm05" / f"HDM_{take}.amc")
    assert isinstance(motion, HumanMotion)
    motion = skeleton.start_at_origin(motion.resampled(FPS))
    targets = make_targets(motion, RetargetConfig())
    height = targets.position["pelvis"][:, 2]
    assert height.min() < 0.6
    assert (np.diff(height, 2) * FPS**2).min() > -9.81
