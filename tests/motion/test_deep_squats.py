"""Squats to the lowest stance, and commands that go below it."""

from __future__ import annotations

import numpy as np
import pytest

from openclone.errors import InputError
from openclone.motion.batch import measure_clip
from openclone.motion.clip import check_clip, clip_hash
from openclone.motion.commands import gate_for, is_command
from openclone.motion.heights import head_heights
from openclone.motion.quality import Gate, faults
from openclone.motion.sources.deep_squats import DEEPEST, deep_squat_set, way_down
from openclone.robot.kinematics import Kinematics


@pytest.fixture(scope="module")
def squats():
    return deep_squat_set(3, 4)


def test_motions_and_commands_take_turns(squats):
    assert [is_command(clip.info) for clip in squats] == [False, True, False, True]
    assert {clip.info.category for clip in squats} == {"squat"}
    for clip in squats:
        check_clip(clip, "here")
        heads = head_heights(clip.qpos)
        assert heads[0] > 1.15
        assert heads[-1] == pytest.approx(heads[0], abs=1e-6)


def test_motions_are_as_deep_as_legs_allow_and_sound(squats):
    for clip in squats[::2]:
        low = head_heights(clip.qpos).min()
        assert DEEPEST - 0.02 <= low <= 0.77
        assert not faults(measure_clip(clip), Gate())


def test_commands_go_deeper_and_no_hand_reaches_the_ground(squats):
    kinematics = Kinematics()
    for clip in squats[1::2]:
        assert DEEPEST - 0.19 <= head_heights(clip.qpos).min() <= DEEPEST + 0.02
        assert faults(measure_clip(clip), Gate())
        assert not faults(measure_clip(clip), gate_for(clip.info, Gate()))
        points = np.array([kinematics.key_points(row)[0] for row in clip.qpos])
        assert points[:, 1:, 2].min() > 0.0


def test_equal_seeds_give_equal_squats(squats):
    assert clip_hash(deep_squat_set(3, 2)) == clip_hash(list(squats[:2]))
    assert clip_hash(deep_squat_set(4, 2)) != clip_hash(list(squats[:2]))


def test_what_the_legs_cannot_do_is_refused():
    def still(qpos: np.ndarray, rng: np.random.Generator) -> None:
        del qpos, rng

    with pytest.raises(InputError, match="cannot squat to a head height"):
        way_down(0.3, still, np.random.default_rng(0))
