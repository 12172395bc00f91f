"""The text summary of a clip: hand-worked figures and planted faults."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from openclone.motion.clip import Clip, ClipInfo, clip_from_qpos
from openclone.motion.summary import summarize
from openclone.robot import g1
from openclone.robot.model import standing_qpos
from openclone.spatial import rotations


@pytest.fixture
def clip() -> Clip:
    """Two seconds of gliding 1 m ahead while turning left by 90 degrees."""
    time = np.linspace(0, 1, 101)
    qpos = np.tile(standing_qpos(), (101, 1))
    qpos[:, 0] = time
    qpos[:, 3:7] = rotations.from_yaw(0.5 * np.pi * time)
    return clip_from_qpos(ClipInfo("test/glide", "turn", "a test", "CC0", 50.0), qpos)


def rows(clip: Clip) -> dict[str, str]:
    return dict(line.split(maxsplit=1) for line in summarize(clip).splitlines())


def test_figures(clip: Clip) -> None:
    found = rows(clip)
    assert found["name"] == "test/glide"
    assert found["length"] == "101 frames, 2.00 s at 50 fps"
    assert found["path"] == "1.00 m, 0.50 m/s, turns +90 deg"
    assert found["faults"] == "none"


def test_faults_are_named(clip: Clip) -> None:
    knee = g1.joint_index("left_knee_joint")
    angles = clip.joint_angles.copy()
    angles[60, knee] = 3.0
    found = rows(replace(clip, joint_angles=angles))["faults"]
    # The knee ends at 2.8798 rad and turns at 20 rad/s.
    assert "frame 60: left_knee_joint is 0.120 rad beyond its limit" in found
    assert "left_knee_joint turns at 135.0 rad/s, its motor reaches 20" in found


def test_a_buried_foot_is_named(clip: Clip) -> None:
    position = clip.root_position.copy()
    position[40, 2] -= 0.03
    found = rows(replace(clip, root_position=position))["faults"]
    assert found.startswith("frame 40: a sole is 3")
