"""Gliding laps: an operator's head and hands on a body whose feet slide on purpose."""

from __future__ import annotations

import math

import numpy as np
import pytest

from openclone.motion.batch import measure_clip
from openclone.motion.clip import Clip, check_clip, clip_hash
from openclone.motion.commands import gate_for, is_command
from openclone.motion.planted import feet_of
from openclone.motion.quality import Gate, faults
from openclone.motion.sources import synthetic
from openclone.motion.sources.gliding import (
    Laps,
    gliding_laps,
    gliding_set,
)
from openclone.robot.kinematics import Kinematics
from openclone.robot.model import standing_qpos
from openclone.spatial import rotations

FPS = 50.0


@pytest.fixture(scope="module")
def laps() -> Clip:
    """A lap at 0.5 m/s round a circle of 2 m, 3 m between stops of 2 s."""
    return gliding_laps("test/lap", Laps(0.5, 2.0, 3.0, 1.0, 2.0, 0.03), seconds=20.0)


def test_starts_and_stops_as_told(laps: Clip) -> None:
    check_clip(laps, "here")
    step = np.diff(laps.root_position[:, :2], axis=0)
    speed = np.linalg.norm(step, axis=1) * FPS
    assert speed[: round(2.0 * FPS)].max() < 1e-9
    # 3 m at 0.5 m/s with half a second lost at each end: 7 s, then 2 s of rest.
    assert speed[round(5.5 * FPS)] == pytest.approx(0.5, abs=2e-3)
    assert speed[round(9.1 * FPS) : round(10.9 * FPS)].max() < 1e-9
    assert speed[round(9.0 * FPS) :].max() == pytest.approx(0.5, abs=2e-3)
    # After one leg the body has turned by 3 m / 2 m and looks along its way.
    assert rotations.yaw(laps.root_quat[500]) == pytest.approx(1.5, abs=1e-3)
    assert np.allclose(
        laps.root_position[500, :2],
        2 * np.array([np.sin(1.5), 1 - np.cos(1.5)]),
        atol=2e-3,
    )


def test_commands_are_those_of_a_carried_standing_body(laps: Clip) -> None:
    kinematics = Kinematics()
    points, _ = kinematics.key_points(standing_qpos())
    for frame in (0, 275, 400, 700):
        found, _ = kinematics.key_points(laps.qpos[frame])
        turn = rotations.from_yaw(rotations.yaw(laps.root_quat[frame]))
        wanted = rotations.rotate(turn, points - standing_qpos()[:3])
        wanted += laps.root_position[frame]
        assert np.allclose(found, wanted, atol=1e-9)
    # At full speed it stands lower.
    assert laps.root_position[275, 2] == pytest.approx(standing_qpos()[2] - 0.03)


def test_feet_glide_flat_on_the_ground(laps: Clip) -> None:
    corners = feet_of(laps.qpos).corners()[..., 2]
    ground = feet_of(standing_qpos()[None]).corners()[..., 2]
    assert np.abs(corners - ground).max() < 1e-3


def test_only_commands_may_slide(laps: Clip) -> None:
    quality = measure_clip(laps)
    assert quality.slide_cm_s > Gate().slide_cm_s
    assert any("slide" in reason for reason in faults(quality))
    assert not faults(quality, gate_for(laps.info, Gate()))
    walk = synthetic.generate("forward", np.random.default_rng(0))
    assert gate_for(walk.info, Gate()) == Gate()
    # Everything but sliding still counts.
    assert gate_for(laps.info, Gate()).ground_share == Gate().ground_share


def test_seeds_vary_the_laps() -> None:
    first, again, other = gliding_set(3, 7), gliding_set(3, 7), gliding_set(4, 7)
    assert clip_hash(first) == clip_hash(again) != clip_hash(other)
    assert len({clip.info.name for clip in first}) == 7
    assert [clip.info.category for clip in first] == ["forward"] * 6 + ["backward"]
    straight = [np.ptp(clip.root_position[:, 1]) < 1e-9 for clip in first]
    assert straight == [True, False, False, False, False, True, False]
    ways = [
        np.linalg.norm(np.diff(clip.root_position, axis=0)[:, :2], axis=1).max()
        for clip in first
    ]
    assert len(set(ways)) == 7
    assert min(ways) * FPS > 0.19
    assert max(ways) * FPS < 0.61
    # Backward: against where it looks.
    last = first[-1]
    ahead = rotations.rotate(last.root_quat[:-1], np.array([1.0, 0.0, 0.0]))
    assert (np.diff(last.root_position, axis=0) * ahead).sum(1).max() < 1e-6
    assert all(is_command(clip.info) and not clip.info.recorded for clip in first)
    assert math.isclose(first[0].seconds, 45.0)


def test_the_default_set_holds_no_commands(monkeypatch: pytest.MonkeyPatch) -> None:
    """So `evaluate tracking` does not measure on them."""
    monkeypatch.setattr(synthetic, "CATEGORIES", ("forward", "backward"))
    clips = synthetic.default_set(0, minutes=0.1)
    assert not any(is_command(clip.info) for clip in clips)
