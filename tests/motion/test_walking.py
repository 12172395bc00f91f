"""Walks move at the velocity that was asked for, and people's ways of walking."""

from __future__ import annotations

from functools import cache

import mujoco
import numpy as np
import pytest

from openclone.motion.clip import Clip, ClipInfo, clip_from_qpos
from openclone.motion.sources import gestures, whole_body
from openclone.motion.sources.choreography import FPS, Choreography, Gait
from openclone.motion.sources.walking import (
    Velocity,
    advanced,
    draw_gait,
    eased,
    pelvis_height,
    stroll,
)
from openclone.robot.model import SOLE_CORNERS, build_model
from openclone.spatial import rotations

VELOCITIES = (
    Velocity(0.3),
    Velocity(0.95),
    Velocity(-0.55),
    Velocity(0.0, 0.18),
    Velocity(turn=1.55),
    Velocity(turn=-0.8),
    Velocity(-0.3, turn=0.6),
)


@cache
def walk_at(velocity: Velocity) -> Clip:
    """Six seconds or more at ``velocity``; drawn again until it is in reach."""
    for seed in range(5):
        rng = np.random.default_rng(seed)
        arms = gestures.hanging_arms(rng)
        score = Choreography(rng, width=0.2, height=0.77, arms=arms, toe_out=0.05)
        score.hold(0.8)
        gait = draw_gait(rng, velocity)
        stroll(score, [gait] * round(6 / gait.step_s), pelvis_height(rng, gait))
        score.hold(0.5)
        try:
            qpos = whole_body.solve(score.plan())
        except whole_body.Unreachable:
            continue
        return clip_from_qpos(ClipInfo("walk", "forward", "", "", FPS), qpos)
    pytest.fail(f"{velocity} is out of reach")


def rates(clip: Clip) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Forward, sideways (m/s) and turning (rad/s), over 2 s in mid-clip."""
    middle, half = clip.num_frames // 2, round(FPS)
    span = slice(middle - half, middle + half + 1)
    yaw = np.unwrap(rotations.yaw(clip.root_quat[span]))
    step = np.diff(clip.root_position[span, :2], axis=0) * FPS
    cosine, sine = np.cos(yaw[:-1]), np.sin(yaw[:-1])
    ahead = cosine * step[:, 0] + sine * step[:, 1]
    left = cosine * step[:, 1] - sine * step[:, 0]
    return ahead.mean(), left.mean(), (yaw[-1] - yaw[0]) / 2.0


@pytest.mark.parametrize("velocity", VELOCITIES, ids=str)
def test_walks_at_the_velocity_asked_for(velocity: Velocity) -> None:
    ahead, left, turn = rates(walk_at(velocity))
    # The sway of the pelvis does not average out over 2 s; a few cm/s remain.
    assert ahead == pytest.approx(velocity.forward, abs=0.05)
    assert left == pytest.approx(velocity.sideways, abs=0.06)
    assert turn == pytest.approx(velocity.turn, abs=0.13)


def sole_heights(clip: Clip) -> np.ndarray:
    """(T, 2) height of each sole's lowest corner, by MuJoCo."""
    model = build_model(floor=False)
    data = mujoco.MjData(model)
    heights = np.empty((clip.num_frames, 2))
    for k, row in enumerate(clip.qpos):
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        for side, name in enumerate(("left", "right")):
            body = data.body(f"{name}_ankle_roll_link")
            corners = body.xpos + SOLE_CORNERS @ body.xmat.reshape(3, 3).T
            heights[k, side] = corners[:, 2].min()
    return heights


@pytest.mark.parametrize("velocity", VELOCITIES[:3], ids=str)
def test_every_swing_rises_about_fifty_millimetres(velocity: Velocity) -> None:
    heights = sole_heights(walk_at(velocity))
    for side in range(2):
        up = np.flatnonzero(np.diff((heights[:, side] > 0.003).astype(int)) == 1)
        down = np.flatnonzero(np.diff((heights[:, side] > 0.003).astype(int)) == -1)
        assert len(up) >= 3
        peaks = [heights[a:b, side].max() for a, b in zip(up, down, strict=True)]
        assert min(peaks) > 0.045
        assert max(peaks) < 0.1


def test_the_pelvis_sways_over_the_standing_foot() -> None:
    clip = walk_at(VELOCITIES[0])
    heights = sole_heights(clip)
    left_alone = (heights[:, 1] > 0.02) & (heights[:, 0] < 0.003)
    right_alone = (heights[:, 0] > 0.02) & (heights[:, 1] < 0.003)
    y = clip.root_position[:, 1]
    # Facing x, left is +y: the pelvis is on the side of the foot that carries it.
    assert y[left_alone].mean() - y[right_alone].mean() > 0.02


def test_turns_without_stopping_at_every_step() -> None:
    clip = walk_at(Velocity(turn=1.55))
    yaw = np.unwrap(rotations.yaw(clip.root_quat))
    rate = np.gradient(yaw) * FPS
    middle = slice(clip.num_frames // 2 - 75, clip.num_frames // 2 + 75)
    assert rate[middle].min() > 0.6


def test_two_steps_make_the_whole_drift() -> None:
    gait = Gait(sideways=0.1, turn=-0.4, lead=0.7)
    body = np.zeros(3)
    for side in (0, 1):
        body = advanced(body, side, gait)
    assert body[2] == pytest.approx(-0.4)
    assert np.hypot(*body[:2]) == pytest.approx(0.1, abs=0.003)


def test_eased_walks_start_and_stop_in_small_steps() -> None:
    wanted = [Gait(forward=0.5, turn=-1.5)] * 6 + [Gait(forward=-0.3)] * 6
    gaits = eased(wanted)
    forward = np.array([0.0, *(gait.forward for gait in gaits), 0.0])
    turn = np.array([0.0, *(gait.turn for gait in gaits), 0.0])
    assert np.abs(np.diff(forward)).max() <= 0.2 + 1e-9
    assert np.abs(np.diff(turn)).max() <= 0.5 + 1e-9
    assert forward.max() == 0.5
    assert forward.min() == pytest.approx(-0.3)
    assert turn.min() == -1.5
