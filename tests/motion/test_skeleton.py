"""Canonical human motion: what a headset reports, and moving the start."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from openclone.errors import InputError
from openclone.motion.skeleton import (
    JOINTS,
    HumanMotion,
    make_motion,
    operator_points,
    scale_to_metres,
    start_at_origin,
    without_flips,
)
from openclone.spatial import rotations

Human = Callable[..., HumanMotion]


def turned(motion: HumanMotion, joint: str, turn: np.ndarray) -> HumanMotion:
    quats = motion.quats.copy()
    quats[:, JOINTS.index(joint)] = turn
    return replace(motion, quats=quats)


def test_hanging_hands_point_down_palms_inward(human: Human) -> None:
    positions, quats = operator_points(human(3))
    assert positions.shape == (3, 3, 3)
    assert quats[0, 0] == pytest.approx([1, 0, 0, 0])
    assert positions[0, 1] == pytest.approx([0, 0.18, 0.84])
    for index in (1, 2):
        matrix = rotations.to_matrix(quats[0, index])
        # Fingers (x) down, thumb (z) forward, so y still points left.
        assert matrix[:, 0] == pytest.approx([0, 0, -1], abs=1e-9)
        assert matrix[:, 2] == pytest.approx([1, 0, 0], abs=1e-9)
        assert matrix[:, 1] == pytest.approx([0, 1, 0], abs=1e-9)


@pytest.mark.parametrize(("side", "sign"), [("left", -1.0), ("right", 1.0)])
def test_hand_is_the_identity_when_the_arm_points_forward(
    human: Human, side: str, sign: float
) -> None:
    # From the T-pose: swing the arm forward about Z, then thumb up about the arm.
    forward = rotations.from_axis_angle(np.array([0.0, 0, 1]), sign * np.pi / 2)
    thumb_up = rotations.from_axis_angle(np.array([1.0, 0, 0]), sign * np.pi / 2)
    motion = turned(human(2), f"{side}_wrist", rotations.multiply(thumb_up, forward))
    quat = operator_points(motion)[1][0, 1 if side == "left" else 2]
    assert rotations.angle_between(quat, np.array([1.0, 0, 0, 0])) < 1e-6


def test_start_at_origin_is_one_rigid_motion(human: Human) -> None:
    still = human(4)
    turn = np.broadcast_to(rotations.from_yaw(np.array(2.0)), still.quats.shape)
    moved = replace(
        still,
        positions=rotations.rotate(turn, still.positions) + np.array([3.0, -1.0, 0.0]),
        quats=rotations.multiply(turn, still.quats),
    )
    back = start_at_origin(moved)
    assert np.allclose(back.positions, still.positions, atol=1e-9)
    assert rotations.angle_between(back.quats, still.quats).max() < 1e-6


def test_resampling_keeps_speed_and_length(human: Human) -> None:
    still = human(31, fps=30.0)
    path = np.linspace(0, 1, 31)[:, None, None] * np.array([1.2, 0, 0])
    faster = replace(still, positions=still.positions + path).resampled(50.0)
    assert faster.num_frames == 51
    speed = np.gradient(faster.joint("head")[:, 0]) * 50
    assert speed == pytest.approx(1.2, abs=1e-6)


def test_flips_are_bridged_and_trimmed(human: Human) -> None:
    still = human(60)
    upside_down = rotations.from_axis_angle(np.array([1.0, 0, 0]), np.pi)
    positions, quats = still.positions.copy(), still.quats.copy()
    for frame in (29, 30, 58, 59):
        center = still.hip_center[frame]
        positions[frame] = center + rotations.rotate(
            upside_down, positions[frame] - center
        )
        quats[frame] = rotations.multiply(
            np.broadcast_to(upside_down, quats[frame].shape), quats[frame]
        )
    mended = without_flips(replace(still, positions=positions, quats=quats))
    assert 52 <= mended.num_frames <= 58
    assert np.allclose(mended.positions, still.positions[: mended.num_frames])
    assert without_flips(still) is still


def test_impossible_bodies_are_refused(human: Human) -> None:
    still = human(5)
    with pytest.raises(InputError, match="no human leg"):
        scale_to_metres(3.0, "file")
    with pytest.raises(InputError, match="frame rate 1e"):
        make_motion("m", 1e9, still.positions, still.quats, "file")
    bad = still.positions.copy()
    bad[2, 3, 1] = np.inf
    with pytest.raises(InputError, match="not finite"):
        make_motion("m", 50, bad, still.quats, "file")
    with pytest.raises(InputError, match="1 frames"):
        make_motion("m", 50, still.positions[:1], still.quats[:1], "file")
    with pytest.raises(InputError, match="1 km"):
        make_motion("m", 50, still.positions + 2000, still.quats, "file")
