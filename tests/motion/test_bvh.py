"""The BVH reader: geometry by hand, real recordings, and errors that name the line."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from openclone.errors import InputError
from openclone.motion.sources import bvh
from openclone.spatial import rotations

Text = Callable[..., str]


def read(text: str, tmp_path: Path) -> bvh.HumanMotion:
    path = tmp_path / "motion.bvh"
    path.write_text(text)
    return bvh.read(path)


def test_t_pose_in_centimetres(bvh_text: Text, tmp_path: Path) -> None:
    motion = read(bvh_text([{}] * 5, fps=60), tmp_path)
    assert motion.num_frames == 5
    assert motion.fps == pytest.approx(60, abs=0.01)
    # Z up, facing +X, left is +Y; hips at 92 cm.
    assert motion.joint("hips")[0] == pytest.approx([0, 0, 0.92])
    assert motion.joint("left_wrist")[0] == pytest.approx([0, 0.71, 1.37])
    assert motion.joint("right_toe")[0] == pytest.approx([0.13, -0.09, 0.02])
    assert motion.leg_length == pytest.approx(0.83)
    assert np.allclose(motion.quats, [1, 0, 0, 0])


@pytest.mark.parametrize("scale", [0.01, 10.0, 1 / 2.54])
def test_units_are_recognised(bvh_text: Text, tmp_path: Path, scale: float) -> None:
    motion = read(bvh_text([{}] * 3, scale=scale), tmp_path)
    assert motion.joint("hips")[0, 2] == pytest.approx(0.92, rel=1e-3)


def test_turning_and_bending(bvh_text: Text, tmp_path: Path) -> None:
    # Y is the vertical axis of the file: a turn of +90 degrees is to the left.
    frame = {"Hips": (0.0, 0.0, 90.0), "LeftLeg": (0.0, 90.0, 0.0)}
    motion = read(bvh_text([frame] * 3), tmp_path)
    assert rotations.yaw(motion.orientation("hips")[0]) == pytest.approx(np.pi / 2)
    # Facing +Y the left hip lies at -X; the bent shank points backwards, to -Y.
    assert motion.joint("left_hip")[0] == pytest.approx([-0.09, 0, 0.92], abs=1e-6)
    assert motion.joint("left_ankle")[0] == pytest.approx([-0.09, -0.41, 0.5], abs=1e-6)


def test_channel_order_is_respected(bvh_text: Text, tmp_path: Path) -> None:
    # Z 90 then X 90 about the new axis: the arm's +X goes to +Y and stays there.
    frame = {"LeftArm": (90.0, 90.0, 0.0)}
    motion = read(bvh_text([frame] * 3), tmp_path)
    arm = motion.joint("left_elbow")[0] - motion.joint("left_shoulder")[0]
    assert arm == pytest.approx([0, 0, 0.28], abs=1e-6)


def test_calibration_frame_is_dropped(bvh_text: Text, tmp_path: Path) -> None:
    down = {"LeftArm": (-80.0, 0.0, 0.0), "RightArm": (80.0, 0.0, 0.0)}
    motion = read(bvh_text([{}, *[down] * 20]), tmp_path)
    assert motion.num_frames == 20
    assert motion.joint("left_wrist")[0, 2] < 0.95


def test_every_cut_is_an_input_error(bvh_text: Text, tmp_path: Path) -> None:
    text = bvh_text([{}] * 4)
    path = tmp_path / "cut.bvh"
    for length in range(0, len(text) - 10, 97):
        path.write_text(text[:length])
        with pytest.raises(InputError, match=r"cut\.bvh"):
            bvh.read(path)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("HIERARCHY", "HIERARCHIE", "line 1: expected 'HIERARCHY'"),
        (
            "OFFSET 0 25 0",
            "OFFSET 0 nan 0",
            r"line \d+: expected a number, found 'nan'",
        ),
        ("Xposition", "Xvelocity", "unknown channel 'Xvelocity'"),
        ("CHANNELS 6", "CHANNELS 999999", "channels is 999999"),
        ("Frames: 4", "Frames: 400", "4 frames follow, the header promises 400"),
        ("Frames: 4", "Frames: 99999999999", "99999999999 frames, expected"),
        ("Frame Time: 0.02", "Frame Time: 0", "frame time 0 s"),
        ("JOINT LeftHand", "JOINT LeftPaw", "no joint for left_wrist"),
        ("92", "inf", r"line \d+: expected 57 finite numbers"),
        ("92", "92 92", r"line \d+: expected 57 finite numbers, found 58"),
        ("OFFSET 0 -42 0", "OFFSET 0 -4200 0", "no human leg"),
    ],
)
def test_malformed_files_name_the_place(
    bvh_text: Text, tmp_path: Path, old: str, new: str, message: str
) -> None:
    text = bvh_text([{}] * 4)
    assert old in text
    with pytest.raises(InputError, match=message):
        read(text.replace(old, new), tmp_path)


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no such file"):
        bvh.read(tmp_path / "none.bvh")


@pytest.mark.parametrize(
    "name", ["accad/Female1_B03_Walk1", "cmu/walking_3", "cmu/walking_extra_walking_24"]
)
def test_recorded_walkers_face_where_they_go(recordings: Path, name: str) -> None:
    """Also of the clip in which CMU's export mirrors the root beyond 90 degrees."""
    motion = bvh.read(recordings / f"{name}.bvh")
    speed = np.gradient(motion.hip_center, axis=0) * motion.fps
    walking = np.linalg.norm(speed[:, :2], axis=1) > 0.5
    travel = np.arctan2(speed[:, 1], speed[:, 0])
    off = np.abs(
        rotations.wrap_angle(travel - rotations.yaw(motion.orientation("hips")))
    )
    assert np.mean(off[walking] < np.radians(45)) > 0.85
    assert motion.joint("head")[walking, 2].mean() > 1.3
    # Nobody flips over: the pelvis stays upright.
    up = rotations.rotate(motion.orientation("hips"), np.array([0.0, 0, 1]))
    assert up[:, 2].min() > 0.7
