"""The DeepMimic reader: joint senses by hand, a real recording, and clear errors."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from openclone.errors import InputError
from openclone.motion.sources import deepmimic

QUATS = (4, 8, 12, 16, 21, 25, 30, 35, 39)
RIGHT_KNEE, RIGHT_ELBOW, LEFT_ELBOW = 20, 29, 43


def frame(**values: float) -> list[float]:
    """Standing upright, arms hanging; ``c20=...`` sets a column."""
    row = [0.0] * deepmimic.FRAME_SIZE
    row[0], row[2] = 0.025, 0.9
    for column in QUATS:
        row[column] = 1.0
    for name, value in values.items():
        row[int(name[1:])] = value
    return row


def read(tmp_path: Path, frames: list[list[float]]) -> deepmimic.HumanMotion:
    path = tmp_path / "motion.txt"
    path.write_text(json.dumps({"Loop": "none", "Frames": frames}))
    return deepmimic.read(path)


def test_hanging_arms_and_handedness(tmp_path: Path) -> None:
    motion = read(tmp_path, [frame()] * 4)
    assert motion.fps == pytest.approx(40)
    assert motion.joint("hips")[0] == pytest.approx([0, 0, 0.9])
    assert motion.joint("left_ankle")[0, 1] > 0 > motion.joint("right_ankle")[0, 1]
    assert motion.joint("left_toe")[0, 0] > 0
    # The wrist hangs straight below the shoulder, fingers down, thumb forward.
    arm = motion.joint("left_wrist")[0] - motion.joint("left_shoulder")[0]
    assert arm == pytest.approx([0, 0, -0.534], abs=1e-6)


def test_hinges_bend_the_human_way(tmp_path: Path) -> None:
    quarter = np.pi / 2
    row = frame(c20=-quarter, c29=quarter, c43=quarter)
    motion = read(tmp_path, [row] * 3)
    shank = motion.joint("right_ankle")[0] - motion.joint("right_knee")[0]
    assert shank == pytest.approx([-0.41, 0, 0], abs=1e-6)
    for side in ("left", "right"):
        forearm = motion.joint(f"{side}_wrist")[0] - motion.joint(f"{side}_elbow")[0]
        assert forearm == pytest.approx([0.259, 0, 0], abs=1e-6)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        ('{"Frames": [[0.1, 1', "not valid JSON"),
        ("[1, 2]", 'no list "Frames"'),
        ('{"Frames": []}', 'no list "Frames" of 2'),
        ('{"Frames": [[1, 2], [3, 4]]}', r"Frames\[0\]: expected 44 finite"),
        (json.dumps({"Frames": [frame(), frame(c7=float("nan"))]}), r"Frames\[1\]"),
        (
            json.dumps({"Frames": [frame(), frame(c25=0.3)]}),
            r"Frames\[1\]: the quaternion of right_shoulder has length 0.3",
        ),
        (json.dumps({"Frames": [frame(c0=0.0)] * 3}), r"Frames\[0\]: duration 0 s"),
        (json.dumps({"Frames": [frame()] * 2}).replace("0.9", '"x"'), r"Frames\[0\]"),
    ],
)
def test_malformed_files(tmp_path: Path, content: str, message: str) -> None:
    path = tmp_path / "bad.txt"
    path.write_text(content)
    with pytest.raises(InputError, match=message):
        deepmimic.read(path)


def test_recorded_walk(recordings: Path) -> None:
    motion = deepmimic.read(recordings / "deepmimic" / "humanoid3d_long_walk2.txt")
    assert motion.fps == pytest.approx(120, abs=0.1)
    lowest = np.minimum(motion.joint("left_toe")[:, 2], motion.joint("right_toe")[:, 2])
    # One foot is always near the ground.
    assert np.abs(lowest).max() < 0.12
    assert np.median(motion.joint("head")[:, 2]) == pytest.approx(1.43, abs=0.08)
