"""AMASS recordings: rotations on a fixed skeleton, worked out again with SciPy."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from openclone.errors import InputError
from openclone.motion import readers
from openclone.motion.skeleton import JOINTS, HumanMotion
from openclone.motion.skeleton_maps import FOLDER
from openclone.motion.sources import amass

# SMPL's joints in their published order; ours are named after the canonical skeleton.
SMPL = (
    "hips", "left_hip", "right_hip", "spine1", "left_knee", "right_knee", "spine2",
    "left_ankle", "right_ankle", "chest", "left_toe", "right_toe", "neck",
    "left_collar", "right_collar", "head", "left_shoulder", "right_shoulder",
    "left_elbow", "right_elbow", "left_wrist", "right_wrist",
)  # fmt: skip
UPRIGHT = (np.pi / 2, 0.0, 0.0)
"""Root rotation of someone who stands in AMASS's Z-up world: y up, facing -Y."""


def write(path: Path, poses: np.ndarray, **other: Any) -> HumanMotion:
    arrays: dict[str, Any] = {
        "poses": poses,
        "trans": np.tile([0.1, 0.2, 0.95], (len(poses), 1)),
        "betas": np.zeros(16),
        "gender": "female",
        "mocap_framerate": 120.0,
    }
    np.savez(path, **(arrays | other))
    motion = readers.read_motion(path)
    assert isinstance(motion, HumanMotion)
    return motion


def standing(frames: int = 3, width: int = 156) -> np.ndarray:
    poses = np.zeros((frames, width))
    poses[:, :3] = UPRIGHT
    return poses


@pytest.mark.parametrize("width", [72, 156, 165])
def test_t_pose(tmp_path: Path, width: int) -> None:
    motion = write(tmp_path / "m.npz", standing(width=width))
    assert motion.fps == 120
    assert motion.joint("hips")[0] == pytest.approx([0.1, 0.2, 0.95])
    # Facing -Y, left is +X.
    out = motion.joint("left_wrist")[0] - motion.joint("right_wrist")[0]
    assert out[0] > 1.3
    assert out[1:] == pytest.approx([0, 0], abs=1e-9)
    toe = motion.joint("left_toe")[0] - motion.joint("left_ankle")[0]
    assert toe[1] < -0.1
    # A body of 1.75 m by Drillis and Contini: eye and ankle heights, leg.
    assert motion.leg_length == pytest.approx(0.491 * 1.75, abs=1e-3)
    arm = motion.bone_length("left_shoulder", "left_elbow")
    assert arm == pytest.approx(0.186 * 1.75, abs=1e-3)
    head = motion.orientation("head")[0][[1, 2, 3, 0]]
    # Identity of the canonical skeleton faces +X: here it is turned to -Y.
    assert Rotation.from_quat(head).apply([1, 0, 0]) == pytest.approx([0, -1, 0])


def test_any_pose_like_scipy(tmp_path: Path) -> None:
    rng = np.random.default_rng(1)
    poses = standing(frames=4)
    poses[:, 3:66] = rng.normal(0, 0.5, (4, 63))
    motion = write(tmp_path / "m.npz", poses)
    table = tomllib.loads((FOLDER / "amass_smplh.toml").read_text())["joints"]
    assert set(table) == set(SMPL)
    turn, place = {}, {}
    for index, name in enumerate(SMPL):
        local = Rotation.from_rotvec(poses[:, 3 * index : 3 * index + 3])
        parent = table[name].get("parent")
        turn[name] = turn[parent] * local if parent else local
        offset = np.array(table[name]["offset"], float)
        place[name] = (
            place[parent] + turn[parent].apply(offset)
            if parent
            else np.tile([0.1, 0.2, 0.95], (4, 1))
        )
    for joint in JOINTS:
        assert np.allclose(motion.joint(joint), place[joint], atol=1e-9), joint


def test_knees_and_elbows_bend_like_smpl(tmp_path: Path) -> None:
    poses = standing()
    poses[:, 3 * SMPL.index("left_knee")] = np.pi / 2  # about x: the heel goes back
    poses[:, 3 * SMPL.index("left_elbow") + 1] = -np.pi / 2  # about y: forward
    motion = write(tmp_path / "m.npz", poses)
    shank = motion.joint("left_ankle")[0] - motion.joint("left_knee")[0]
    assert shank == pytest.approx([0, 0.246 * 1.75, 0], abs=1e-3)
    forearm = motion.joint("left_wrist")[0] - motion.joint("left_elbow")[0]
    assert forearm == pytest.approx([0, -0.146 * 1.75, 0], abs=1e-3)


def test_spelling_of_the_smplx_release(tmp_path: Path) -> None:
    arrays = {"poses": standing(width=165), "trans": np.zeros((3, 3))}
    np.savez(tmp_path / "m.npz", mocap_frame_rate=np.array(30), **arrays)
    assert amass.read(tmp_path / "m.npz").fps == 30


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"poses": np.zeros((3, 150))}, "150 columns"),
        ({"poses": np.zeros((3, 52, 3))}, "expected numbers of shape"),
        ({"poses": np.full((3, 156), np.nan)}, r"poses\[0, 0\] is not a finite"),
        ({"poses": np.full((3, 156), 90.0)}, "in radians"),
        ({"poses": np.zeros((1, 156)), "trans": np.zeros((1, 3))}, "1 frames"),
        ({"trans": np.zeros((2, 3))}, r"expected numbers of shape \(3, 3\)"),
        ({"mocap_framerate": "fast"}, "not one finite number"),
        ({"mocap_framerate": 0.0}, "frame rate 0"),
    ],
)
def test_malformed(tmp_path: Path, change: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        write(tmp_path / "m.npz", **({"poses": standing()} | change))


def test_body_shape_files_are_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "shape.npz", betas=np.zeros(16), gender="male")
    with pytest.raises(InputError, match="unknown kind"):
        readers.read_motion(tmp_path / "shape.npz")
    np.savez(tmp_path / "no_rate.npz", poses=standing(), trans=np.zeros((3, 3)))
    with pytest.raises(InputError, match="no array mocap_framerate"):
        readers.read_motion(tmp_path / "no_rate.npz")
