"""Hands turn over the wrist's range, smoothly, within limits, body unmoved."""

from __future__ import annotations

from functools import cache

import mujoco
import numpy as np
import pytest

from openclone.motion.clip import Clip
from openclone.motion.coverage import hand_coverage
from openclone.motion.hands import (
    HandConfig,
    draw_targets,
    with_varied_hands,
    wrist_quat,
)
from openclone.motion.sources import synthetic
from openclone.robot import g1
from openclone.robot.model import build_model
from openclone.spatial import rotations

WRISTS = [k for k, name in enumerate(g1.JOINT_NAMES) if "wrist" in name]


@cache
def walk() -> Clip:
    return synthetic.generate("forward", np.random.default_rng(4), pace=0.6)


@cache
def varied() -> Clip:
    return with_varied_hands(walk(), np.random.default_rng(0))


def test_only_the_arms_change() -> None:
    before, after = walk().qpos, varied().qpos
    np.testing.assert_allclose(before[:, :22], after[:, :22], atol=1e-12)
    assert np.abs(before[:, 22:] - after[:, 22:]).max() > 0.5
    np.testing.assert_allclose(before[[0, -1]], after[[0, -1]], atol=1e-9)


def test_arms_keep_to_their_limits_and_motors() -> None:
    angles = varied().joint_angles
    assert (angles >= g1.JOINT_LOWER).all()
    assert (angles <= g1.JOINT_UPPER).all()
    speed = np.abs(np.diff(angles, axis=0)) * 50.0
    assert (speed < g1.MAX_SPEED).all()


def hands(clip: Clip) -> tuple[np.ndarray, np.ndarray]:
    """Positions (T, 2, 3) and rotations (T, 2, 3, 3) of both hands, world."""
    model = build_model(floor=False)
    data = mujoco.MjData(model)
    place = np.empty((clip.num_frames, 2, 3))
    turn = np.empty((clip.num_frames, 2, 3, 3))
    for k, row in enumerate(clip.qpos):
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        for side, name in enumerate(("left", "right")):
            site = data.site(f"{name}_hand")
            place[k, side], turn[k, side] = site.xpos, site.xmat.reshape(3, 3)
    return place, turn


def test_hands_stay_near_and_turn_smoothly() -> None:
    before, _ = hands(walk())
    after, turn = hands(varied())
    config = HandConfig()
    allowed = config.offset + config.position_tolerance + 0.005
    assert np.linalg.norm(after - before, axis=-1).max() < allowed
    step = turn[1:].swapaxes(-1, -2) @ turn[:-1]
    cosine = np.clip((np.trace(step, axis1=-2, axis2=-1) - 1) / 2, -1, 1)
    # The targets turn at 4 rad/s at most; the arm's own motion comes on top.
    assert (np.arccos(cosine) * 50.0).max() < 8.0


def test_coverage_grows() -> None:
    before, after = hand_coverage([walk()]), hand_coverage([varied()])
    assert after.cells > 2 * before.cells
    assert after.fingers > before.fingers
    assert after.palms > before.palms
    for name, share in after.joint_range.items():
        assert share > before.joint_range[name]


def test_coverage_of_everything_and_of_nothing() -> None:
    rng = np.random.default_rng(0)
    still = Clip(
        walk().info, walk().root_position[:2], walk().root_quat[:2],
        np.tile(g1.DEFAULT_POSE, (2, 1)),
    )  # fmt: skip
    nothing = hand_coverage([still])
    assert nothing.cells == 1 / 216
    assert max(nothing.joint_range.values()) == 0.0
    angles = np.tile(g1.DEFAULT_POSE, (4000, 1))
    angles[:, WRISTS] = rng.uniform(
        g1.JOINT_LOWER[WRISTS], g1.JOINT_UPPER[WRISTS], (4000, 6)
    )
    full = Clip(
        walk().info,
        np.zeros((4000, 3)),
        np.tile(rotations.IDENTITY, (4000, 1)),
        angles,
    )
    everything = hand_coverage([full])
    assert everything.cells > 0.99
    assert min(everything.joint_range.values()) > 0.95


def test_targets_lie_on_arcs_between_reachable_orientations() -> None:
    config = HandConfig()
    rng = np.random.default_rng(3)
    targets, angles = draw_targets(rng, 0, 500, 50.0, config)
    lower, upper = g1.JOINT_LOWER[WRISTS[:3]], g1.JOINT_UPPER[WRISTS[:3]]
    assert (angles >= lower).all()
    assert (angles <= upper).all()
    turn = rotations.angle_between(targets.quat[1:], targets.quat[:-1]) * 50.0
    assert turn.max() < config.peak_speed * 1.02
    assert np.linalg.norm(targets.offset, axis=1).max() <= config.offset
    # SLERP: between two rests the axis of rotation does not change.
    rest = np.flatnonzero(turn < 0.02)
    gaps = np.flatnonzero(np.diff(rest) > 20)
    start, stop = rest[gaps[0]] + 3, rest[gaps[0] + 1] - 3
    steps = rotations.to_rotation_vector(
        rotations.multiply(
            rotations.conjugate(targets.quat[start : stop - 1]),
            targets.quat[start + 1 : stop],
        )
    )
    axes = steps / np.linalg.norm(steps, axis=1, keepdims=True)
    assert (axes @ axes[len(axes) // 2]).min() > 0.999


@pytest.mark.parametrize("side", [0, 1])
def test_the_wrist_turns_as_in_mujoco(side: int) -> None:
    model = build_model(floor=False)
    data = mujoco.MjData(model)
    name = ("left", "right")[side]
    angles = np.random.default_rng(side).uniform(-1.0, 1.0, 3)
    data.qpos[7 + np.array(WRISTS[3 * side : 3 * side + 3])] = angles
    mujoco.mj_kinematics(model, data)
    forearm = data.body(f"{name}_elbow_link").xquat
    hand = data.body(f"{name}_wrist_yaw_link").xquat
    expected = rotations.multiply(rotations.conjugate(forearm), hand)
    found = wrist_quat(side, angles[None])[0]
    assert rotations.angle_between(found, expected) < 1e-6
