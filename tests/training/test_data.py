"""Which clips a run learns from, and how often."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from openclone.errors import InputError
from openclone.motion.clip import ClipInfo, clip_from_qpos
from openclone.robot import g1
from openclone.robot.model import standing_qpos
from openclone.training.data import is_recorded, top_speed
from openclone.training.data_choice import DataChoice
from openclone.training.reference import build_reference
from openclone.training.starts import StartFrames


def travelling(name: str, speeds: list[float]):
    """A clip that moves along x at each of ``speeds`` (m/s) for a second."""
    speed = np.repeat(speeds, 50)
    qpos = np.tile(standing_qpos(), (len(speed) + 1, 1))
    qpos[1:, 0] = np.cumsum(speed) / 50
    return clip_from_qpos(ClipInfo(name, "forward", f"{name}.bvh", "CC0", 50.0), qpos)


def test_the_fastest_half_second_counts():
    assert top_speed(travelling("steady", [0.8, 0.8])) == pytest.approx(0.8)
    assert top_speed(travelling("burst", [0.5, 2.0, 0.5])) == pytest.approx(2.0)
    # A tenth of a second at 4 m/s within a rest is 0.8 m/s over half a second.
    leap = travelling("leap", [0.0, 0.0])
    leap.root_position[50:, 0] += np.minimum(np.arange(51) / 50 * 4.0, 0.4)
    assert top_speed(leap) == pytest.approx(0.8)


def test_fast_clips_are_left_out():
    clips = [travelling("walk", [0.9] * 3), travelling("run", [0.9, 2.5, 0.9])]
    choice = DataChoice(mirror=False, commands=False)
    assert len(choice.select(clips)) == 2
    kept = replace(choice, fastest=1.4).select(clips)
    assert [clip.info.name for clip in kept] == ["walk"]
    with pytest.raises(InputError, match="no clip of the wanted categories and speeds"):
        replace(choice, fastest=0.5).select(clips)


def test_recordings_and_what_is_made_of_them():
    info = ClipInfo("a/walk", "forward", "a/walk.bvh", "CC0", 50.0)
    own = replace(info, source="openclone synthetic generator")
    edited = replace(info, name="a/walk~slow1.2")
    assert [i.recorded for i in (info, edited, own)] == [True, True, False]
    made = [replace(travelling("x", [1.0]), info=i) for i in (info, edited, own)]
    assert [is_recorded(clip) for clip in made] == [True, False, False]


@pytest.mark.parametrize("weight", [1.0, 3.0])
def test_recordings_are_drawn_more_often(make_clip, model, weight):
    recorded, own = make_clip("recorded", 2.98), make_clip("own", 8.98)
    own = replace(own, info=replace(own.info, source="openclone synthetic generator"))
    reference = build_reference([recorded, own], model)
    assert reference.recorded == (True, False)
    generator = torch.Generator().manual_seed(0)
    starts = StartFrames(reference, 0.0, generator, weight)
    drawn = starts.draw(20_000)
    # 3 s and 9 s weigh as their square roots, 1 and 1.73.
    share = float((reference.clip[drawn] == 0).float().mean())
    assert share == pytest.approx(weight / (weight + 3**0.5), abs=0.03)


def test_failures_are_sought_whatever_the_weight(make_clip, model):
    clips = [make_clip("recorded", 2.98), make_clip("own", 8.98)]
    clips[1] = replace(
        clips[1], info=replace(clips[1].info, source="openclone generator")
    )
    reference = build_reference(clips, model)
    starts = StartFrames(reference, 1.0, torch.Generator().manual_seed(0), 100.0)
    starts.failures[:] = 0.0
    starts.failures[18] = 50.0
    frames = starts.draw(2000)
    # One of 19 half seconds, which the weight alone would hardly ever draw.
    assert float(((frames // 25 - 18).abs() <= 1).float().mean()) > 0.3


def test_nobody_is_put_into_the_ground(make_clip, model):
    clip = make_clip("sinking", 5.98)
    depth = np.clip(np.arange(clip.num_frames) / clip.num_frames - 0.5, 0.0, None)
    position = clip.root_position.copy()
    position[:, 2] -= 0.3 * depth
    reference = build_reference([replace(clip, root_position=position)], model)
    starts = StartFrames(reference, 0.0, torch.Generator().manual_seed(0))
    drawn = starts.draw(2000)
    ankles = reference.frames.body_position[:, list(g1.FEET), 2].amin(1)
    assert float(ankles.min()) < -0.05
    assert float(ankles[drawn].min()) >= 0.0
    # What would begin there, half of all, begins at the beginning.
    assert float((drawn == 0).float().mean()) > 0.2
