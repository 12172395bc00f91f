"""Motions whose hands go wherever arms can."""

from __future__ import annotations

import numpy as np
import pytest

from openclone.motion.batch import measure_clip
from openclone.motion.clip import check_clip, clip_hash
from openclone.motion.commands import is_command
from openclone.motion.quality import Gate, faults
from openclone.motion.sources.free_hands import free_hands_set, random_arm
from openclone.robot import g1
from openclone.robot.kinematics import Kinematics


@pytest.fixture(scope="module")
def clips():
    return free_hands_set(3, 4)


def test_they_are_sound_motions(clips):
    for clip in clips:
        check_clip(clip, "here")
        assert clip.info.category == "reach"
        assert not is_command(clip.info)
        assert not faults(measure_clip(clip), Gate())


def test_hands_go_above_the_head_and_down_again(clips):
    kinematics = Kinematics()
    highest = []
    for clip in clips:
        points = np.array([kinematics.key_points(row)[0] for row in clip.qpos])
        above = (points[:, 1:, 2] - points[:, :1, 2]).max(axis=1)
        highest.append(above.max())
        assert above[0] < -0.2
        assert above[-1] < -0.2
    assert max(highest) > 0.1


def test_arms_are_drawn_within_the_joints_limits_and_mirrored():
    for side in (0, 1):
        rng = np.random.default_rng(0)
        arms = np.array([random_arm(rng, side) for _ in range(500)])
        columns = slice(15 + 7 * side, 22 + 7 * side)
        assert (arms > g1.JOINT_LOWER[columns]).all()
        assert (arms < g1.JOINT_UPPER[columns]).all()
        assert 0.4 < (arms[:, 0] < -1.3).mean() < 0.6
        outward = arms[:, 1] if side == 0 else -arms[:, 1]
        assert outward.min() >= 0.0


def test_equal_seeds_give_equal_motions(clips):
    assert clip_hash(free_hands_set(3, 1)) == clip_hash(clips[:1])
    assert clip_hash(free_hands_set(4, 1)) != clip_hash(clips[:1])
