"""Recordings as a governor passes them on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from openclone.motion.clip import Clip, ClipInfo, clip_from_qpos
from openclone.motion.commands import is_command
from openclone.policy.governor import GovernorConfig
from openclone.robot.model import standing_qpos
from openclone.spatial import rotations
from openclone.training.data_choice import DataChoice
from openclone.training.held_back import held_back, held_back_clips


def jog(speed: float, turn: float = 0.0, seconds: float = 2.0) -> Clip:
    """A body that travels at ``speed`` m/s, turns at ``turn`` and swings an arm."""
    fps = 60.0
    time = np.arange(round(seconds * fps)) / fps
    qpos = np.tile(standing_qpos(), (len(time), 1))
    qpos[:, 0] = speed * time
    qpos[:, 3:7] = rotations.from_yaw(turn * time)
    qpos[:, 22] += 0.4 * np.sin(8.0 * time)
    return clip_from_qpos(ClipInfo("a/jog", "forward", "a/jog.bvh", "CC0", fps), qpos)


def test_the_way_is_slower_and_all_else_as_it_was():
    config = GovernorConfig(travel_speed=0.5, travel_acceleration=0.5)
    clip = jog(1.5)
    made = held_back(clip, config)
    assert made.info.fps == 50.0
    assert made.info.licence == "CC0"
    way = np.diff(made.root_position[:, :2], axis=0)
    speed = np.linalg.norm(way, axis=1) * 50.0
    assert speed.max() == pytest.approx(0.5, abs=1e-6)
    # Half a second of standing, 2 s of jogging, then at most 4 s of catching up:
    # 3 m at 0.5 m/s, less what the start costs, would take 4 s and a little.
    assert made.seconds == pytest.approx(0.5 + clip.seconds + 4.0, abs=0.05)
    wanted = clip.resampled(50.0).joint_angles
    np.testing.assert_allclose(made.joint_angles[25 : 25 + len(wanted)], wanted)
    np.testing.assert_allclose(made.qpos[:, 2], standing_qpos()[2], atol=1e-9)


def test_turns_are_held_back_too():
    made = held_back(jog(0.0, turn=2.0, seconds=1.0), GovernorConfig())
    yaw = np.unwrap(rotations.yaw(made.root_quat))
    fastest = np.diff(yaw).max() * 50.0
    assert fastest == pytest.approx(GovernorConfig().turn_speed, rel=1e-3)


def test_only_fast_recordings_are_held_back():
    fast, slow = jog(1.2), jog(0.4)
    edited = replace(fast, info=replace(fast.info, name="a/jog~slow1.2"))
    own = replace(fast, info=replace(fast.info, source="openclone generator"))
    made = held_back_clips([fast, slow, edited, own])
    assert [clip.info.name for clip in made] == ["a/jog~held-back"]
    assert is_command(made[0].info)


@pytest.mark.parametrize(
    ("choice", "count"),
    [
        (DataChoice(mirror=False), 2),
        (DataChoice(), 4),
        (DataChoice(mirror=False, commands=False), 1),
        (DataChoice(mirror=False, recorded_only=True), 1),
    ],
)
def test_presets_train_on_them_with_the_other_commands(choice, count):
    assert len(choice.select([jog(1.2)])) == count
