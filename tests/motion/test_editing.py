"""Edits keep feet planted, joints inside their limits, and promises about time.

All measures are taken here with MuJoCo, not with the code under test.
"""

from __future__ import annotations

from functools import cache

import mujoco
import numpy as np
import pytest

from openclone.errors import InputError
from openclone.motion.blend import joined
from openclone.motion.clip import Clip, ClipInfo, clip_from_qpos
from openclone.motion.edit import pad_start, pad_still
from openclone.motion.heights import height_series, with_head_height
from openclone.motion.planted import EditRefused
from openclone.motion.recombine import recombined
from openclone.motion.soundness import check_edit, outside_soles
from openclone.motion.sources import synthetic
from openclone.motion.warp import random_rates, time_reversed, time_warped
from openclone.robot import g1
from openclone.robot.model import SOLE_CORNERS, build_model, standing_qpos
from openclone.spatial import rotations

TOUCH = 0.003


@cache
def model() -> mujoco.MjModel:
    return build_model(floor=False)


@cache
def example(category: str, seed: int = 1) -> Clip:
    rng = np.random.default_rng(seed)
    return synthetic.generate(category, rng, f"test/{category}", pace=0.7)


def soles_and_head(clip: Clip) -> tuple[np.ndarray, np.ndarray]:
    """(T, 8, 3) corners of both soles and (T, 3) the head, by MuJoCo."""
    data = mujoco.MjData(model())
    corners, head = np.empty((clip.num_frames, 8, 3)), np.empty((clip.num_frames, 3))
    for k, row in enumerate(clip.qpos):
        data.qpos[:] = row
        mujoco.mj_kinematics(model(), data)
        parts = []
        for side in ("left", "right"):
            foot = data.body(f"{side}_ankle_roll_link")
            parts.append(foot.xpos + SOLE_CORNERS @ foot.xmat.reshape(3, 3).T)
        corners[k], head[k] = np.concatenate(parts), data.site("head").xpos
    return corners, head


def assert_planted(clip: Clip) -> None:
    corners, _ = soles_and_head(clip)
    assert corners[..., 2].min() > -0.005
    low = corners[..., 2] < TOUCH
    both = low[1:] & low[:-1]
    step = np.linalg.norm(np.diff(corners[..., :2], axis=0), axis=-1) * clip.info.fps
    assert both.any()
    assert step[both].max() < 0.05
    assert (clip.joint_angles >= g1.JOINT_LOWER - 1e-6).all()
    assert (clip.joint_angles <= g1.JOINT_UPPER + 1e-6).all()
    speed = np.abs(np.diff(clip.joint_angles, axis=0)) * clip.info.fps
    assert (speed < g1.MAX_SPEED).all()


@pytest.mark.parametrize("height", [1.1, 0.9, 0.7])
def test_the_head_goes_down_and_the_feet_stay(height: float) -> None:
    clip = example("stand")
    low = with_head_height(clip, height)
    corners, head = soles_and_head(low)
    before, _ = soles_and_head(clip)
    assert np.median(head[:, 2]) == pytest.approx(height, abs=0.01)
    assert np.abs(corners - before).max() < 0.008
    assert_planted(low)


def test_the_series_of_figure_3_has_a_clip_or_a_reason_for_each_height() -> None:
    clips, refusals = height_series(example("stand"), (1.0, 0.1))
    assert len(clips) == 1
    assert len(refusals) == 1
    assert "leg" in refusals[0]


def test_legs_of_one_and_arms_of_another() -> None:
    legs, arms = example("forward"), example("wave")
    clip = recombined(legs, arms)
    assert clip.num_frames == legs.num_frames
    corners, _ = soles_and_head(clip)
    before, _ = soles_and_head(legs)
    # Every step falls where and when it fell before.
    assert np.abs(corners - before).max() < 0.008
    assert_planted(clip)
    # The arm that waved rises as it did; the ends belong to the walk.
    lifted = np.abs(arms.joint_angles[:, 16] - arms.joint_angles[0, 16]).max()
    right = np.abs(arms.joint_angles[:, 23] - arms.joint_angles[0, 23]).max()
    column = 16 if lifted > right else 23
    moved = np.abs(clip.joint_angles[:, column] - clip.joint_angles[0, column]).max()
    assert moved > 0.8 * max(lifted, right)
    np.testing.assert_allclose(
        clip.joint_angles[[0, -1], 12:], legs.joint_angles[[0, -1], 12:], atol=1e-6
    )


def test_backwards_in_time() -> None:
    clip = example("forward")
    back = time_reversed(clip)
    np.testing.assert_allclose(back.qpos, clip.qpos[::-1], atol=1e-12)
    assert back.info.category == "backward"
    assert_planted(back)


def test_a_constant_rate_divides_the_duration() -> None:
    clip = example("turn")
    fast = time_warped(clip, 1.25)
    assert fast.seconds == pytest.approx(clip.seconds / 1.25, abs=0.03)
    middle = fast.num_frames // 2
    at = middle * 1.25
    low = int(at)
    between = clip.joint_angles[low] * (low + 1 - at)
    between = between + clip.joint_angles[low + 1] * (at - low)
    np.testing.assert_allclose(fast.joint_angles[middle], between, atol=1e-6)
    assert_planted(fast)


def test_uneven_rates_stay_within_their_bounds_and_on_the_path() -> None:
    rng = np.random.default_rng(0)
    rates = random_rates(rng, 8.0, 0.25, 50.0)
    assert rates.min() >= 1 / 1.25 - 1e-9
    assert rates.max() <= 1.25 + 1e-9
    assert np.ptp(rates) > 0.05
    assert np.abs(np.diff(rates)).max() * 50 < 1.0


def test_a_jump_cannot_be_warped() -> None:
    with pytest.raises(EditRefused, match="gravity") as refusal:
        time_warped(example("jump"), 1.2)
    assert refusal.value.reason == "flight"


def test_impossible_rates_are_an_input_error() -> None:
    with pytest.raises(InputError, match=r"give 0\.4 to 2\.5"):
        time_warped(example("turn"), 9.0)


def test_one_clip_after_another_without_a_seam() -> None:
    first, second = example("turn"), example("squat")
    clip = joined(first, second)
    seam = first.num_frames - 1
    assert clip.num_frames == first.num_frames + second.num_frames - 1
    np.testing.assert_allclose(clip.qpos[:seam], first.qpos[:seam], atol=1e-9)
    assert_planted(clip)
    acceleration = np.abs(np.diff(clip.joint_angles, 2, axis=0)) * 50.0**2
    usual = max(
        np.abs(np.diff(part.joint_angles, 2, axis=0)).max() * 50.0**2
        for part in (first, second)
    )
    window = slice(seam - 5, seam + 45)
    assert acceleration[window].max() < max(usual, 40.0)
    # The second motion happens: the head goes down as far as in the squat.
    _, head = soles_and_head(clip)
    _, alone = soles_and_head(second)
    assert head[:, 2].min() == pytest.approx(alone[:, 2].min(), abs=0.03)


def test_clips_that_meet_in_the_air_are_refused() -> None:
    first = example("forward")
    corners, _ = soles_and_head(first)
    lifted = corners[:, :4, 2].min(axis=1) > 0.03
    cut = int(np.flatnonzero(lifted)[0]) + 1
    part = Clip(
        first.info,
        first.root_position[:cut],
        first.root_quat[:cut],
        first.joint_angles[:cut],
    )
    with pytest.raises(EditRefused, match="in the air"):
        joined(part, example("stand"))


def test_standing_before_and_after() -> None:
    clip = example("turn")
    padded = pad_start(pad_still(clip, 0.5), 0.4)
    assert padded.seconds == pytest.approx(clip.seconds + 0.9)
    np.testing.assert_allclose(padded.qpos[20:-25], clip.qpos)
    np.testing.assert_allclose(padded.qpos[:20], np.tile(clip.qpos[0], (20, 1)))


def test_sliding_feet_are_refused() -> None:
    clip = example("stand")
    glide = np.zeros((clip.num_frames, 3))
    glide[:, 0] = 0.1 * np.arange(clip.num_frames) / clip.info.fps
    sliding = Clip(
        clip.info, clip.root_position + glide, clip.root_quat, clip.joint_angles
    )
    with pytest.raises(EditRefused, match="slide at 10") as refusal:
        check_edit(sliding, (clip,))
    assert refusal.value.reason == "sliding feet"


def leaning(angle: float) -> tuple[Clip, float]:
    """Standing with the whole body leaning forward about the ankles, feet flat.

    Also: metres that the centre of mass is ahead of the toes.
    """
    data = mujoco.MjData(model())
    data.qpos[:] = standing_qpos()
    mujoco.mj_kinematics(model(), data)
    anchor = data.xanchor[model().joint("left_ankle_pitch_joint").id]
    turn = rotations.from_axis_angle(np.array([0.0, 1.0, 0.0]), angle)
    data.qpos[:3] = anchor + rotations.rotate(turn, data.qpos[:3] - anchor)
    data.qpos[1] = 0.0
    data.qpos[3:7] = turn
    data.qpos[[7 + 4, 7 + 10]] -= angle
    mujoco.mj_kinematics(model(), data)
    mujoco.mj_comPos(model(), data)
    toes = data.body("left_ankle_roll_link").xpos[0] + SOLE_CORNERS[:, 0].max()
    info = ClipInfo("leaning", "stand", "", "", 50.0)
    clip = clip_from_qpos(info, np.tile(data.qpos, (40, 1)))
    return clip, float(data.subtree_com[1, 0] - toes)


@pytest.mark.parametrize("angle", [0.0, 0.1, 0.3])
def test_the_weight_is_outside_by_what_geometry_says(angle: float) -> None:
    clip, ahead = leaning(angle)
    outside = outside_soles(clip)
    if ahead > -0.03:  # The toes are the nearest edge.
        assert outside[5:-5] == pytest.approx(np.full(30, ahead), abs=0.003)
    else:
        assert outside.max() < 0


def test_a_body_ahead_of_its_feet_would_fall() -> None:
    upright, _ = leaning(0.0)
    falling, ahead = leaning(0.35)
    assert ahead > 0.05
    with pytest.raises(EditRefused, match="it would fall") as refusal:
        check_edit(falling, (upright,))
    assert refusal.value.reason == "would fall"
