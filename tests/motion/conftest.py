"""A small human: BVH text from joint angles, and the same body as arrays."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
import pytest

from openclone.motion.skeleton import JOINTS, HumanMotion

# name, parent, offset in cm (Y up, facing +Z, left is +X): a T-pose of 1.7 m.
SKELETON: tuple[tuple[str, str, tuple[float, float, float]], ...] = (
    ("Hips", "", (0, 0, 0)),
    ("Chest", "Hips", (0, 25, 0)),
    ("Neck", "Chest", (0, 25, 0)),
    ("Head", "Neck", (0, 10, 0)),
    ("LeftArm", "Chest", (18, 20, 0)),
    ("LeftForeArm", "LeftArm", (28, 0, 0)),
    ("LeftHand", "LeftForeArm", (25, 0, 0)),
    ("RightArm", "Chest", (-18, 20, 0)),
    ("RightForeArm", "RightArm", (-28, 0, 0)),
    ("RightHand", "RightForeArm", (-25, 0, 0)),
    ("LeftUpLeg", "Hips", (9, 0, 0)),
    ("LeftLeg", "LeftUpLeg", (0, -42, 0)),
    ("LeftFoot", "LeftLeg", (0, -41, 0)),
    ("LeftToeBase", "LeftFoot", (0, -7, 13)),
    ("RightUpLeg", "Hips", (-9, 0, 0)),
    ("RightLeg", "RightUpLeg", (0, -42, 0)),
    ("RightFoot", "RightLeg", (0, -41, 0)),
    ("RightToeBase", "RightFoot", (0, -7, 13)),
)
HIP_HEIGHT_CM = 92.0
Frame = dict[str, tuple[float, float, float]]


def _joint_text(index: int, scale: float, depth: int) -> list[str]:
    name, parent, offset = SKELETON[index]
    pad = "  " * depth
    channels = "Zrotation Xrotation Yrotation"
    head = (
        f"{pad}ROOT {name}"
        if not parent
        else f"{pad}JOINT {name}"
    )  # fmt: skip
    count = 3
    if not parent:
        count, channels = 6, "Xposition Yposition Zposition " + channels
    numbers = " ".join(f"{scale * value:g}" for value in offset)
    lines = [head, pad + "{", f"{pad}  OFFSET {numbers}"]
    lines.append(f"{pad}  CHANNELS {count} {channels}")
    children = [k for k, item in enumerate(SKELETON) if item[1] == name]
    for child in children:
        lines += _joint_text(child, scale, depth + 1)
    if not children:
        lines += [f"{pad}  End Site", pad + "  {", f"{pad}    OFFSET 0 {scale * 5:g} 0"]
        lines.append(pad + "  }")
    return [*lines, pad + "}"]


def _order(index: int = 0) -> list[str]:
    """Names in the order of the file (depth first)."""
    name = SKELETON[index][0]
    children = [k for k, item in enumerate(SKELETON) if item[1] == name]
    return [name, *(n for child in children for n in _order(child))]


def make_bvh(
    frames: Sequence[Frame],
    *,
    positions_cm: Sequence[tuple[float, float, float]] | None = None,
    scale: float = 1.0,
    fps: float = 50.0,
) -> str:
    """BVH text; a frame maps joints to (Z, X, Y) angles in degrees."""
    rows = []
    for index, frame in enumerate(frames):
        place = positions_cm[index] if positions_cm else (0.0, HIP_HEIGHT_CM, 0.0)
        row = [scale * value for value in place]
        for name in _order():
            row += frame.get(name, (0.0, 0.0, 0.0))
        rows.append(" ".join(f"{value:.6g}" for value in row))
    header = ["HIERARCHY", *_joint_text(0, scale, 0), "MOTION"]
    header += [f"Frames: {len(rows)}", f"Frame Time: {1 / fps:.7f}"]
    return "\n".join([*header, *rows]) + "\n"


@pytest.fixture(scope="session")
def bvh_text() -> Callable[..., str]:
    """`make_bvh`, for the tests."""
    return make_bvh


def standing(frames: int, fps: float = 50.0) -> HumanMotion:
    """A human who stands still, arms hanging straight down, at the origin."""
    names = {
        "hips": (0, 0, 0.92), "chest": (0, 0, 1.17), "neck": (0, 0, 1.42),
        "head": (0, 0, 1.52),
    }  # fmt: skip
    for side, sign in (("left", 1.0), ("right", -1.0)):
        parts = {
            "hip": (0, 0.09, 0.92), "knee": (0, 0.09, 0.50), "ankle": (0, 0.09, 0.09),
            "toe": (0.13, 0.09, 0.02), "shoulder": (0, 0.18, 1.37),
            "elbow": (0, 0.18, 1.09), "wrist": (0, 0.18, 0.84),
        }  # fmt: skip
        for part, (x, y, z) in parts.items():
            names[f"{side}_{part}"] = (x, sign * y, z)
    pose = np.array([names[joint] for joint in JOINTS], dtype=float)
    quats = np.zeros((frames, len(JOINTS), 4))
    quats[..., 0] = 1.0
    half = np.sqrt(0.5)
    for side, sign in (("left", -1.0), ("right", 1.0)):
        for part in ("shoulder", "elbow", "wrist"):
            # From the T-pose, arms down: a quarter turn about the forward axis.
            quats[:, JOINTS.index(f"{side}_{part}")] = (half, sign * half, 0, 0)
    return HumanMotion("standing", fps, np.tile(pose, (frames, 1, 1)), quats)


@pytest.fixture
def human() -> Callable[..., HumanMotion]:
    """`standing`, for the tests."""
    return standing


RUN_PERIOD, RUN_STANCE = 36, 13
"""Frames of 20 ms: a stride, and how long each foot of it bears."""


def running(lift: float = 0.25) -> tuple[HumanMotion, np.ndarray]:
    """A human who runs along +X, and who stands when: (T, 2), left and right.

    A foot lands flat and, from the middle of its stance on, turns about the ball until
    it points down by 65 degrees. In flight it goes a metre ahead, heel up, and the ball
    rises by ``lift`` metres.
    """
    frames = 180
    motion = standing(frames)
    positions = motion.positions.copy()
    stands = np.zeros((frames, 2), dtype=bool)
    stride = 1.2
    positions[..., 0] += (stride / RUN_PERIOD * np.arange(frames))[:, None]
    toe_off = np.radians(65)
    for index, (side, sign) in enumerate((("left", 1.0), ("right", -1.0))):
        for frame in range(frames):
            cycle, phase = divmod(frame + index * RUN_PERIOD // 2, RUN_PERIOD)
            half = RUN_STANCE / 2
            ball = np.array([stride * (cycle - index / 2 + 0.2), sign * 0.09, 0.02])
            turn = toe_off * np.clip(phase / half - 1.0, 0.0, 1.0) ** 2
            if phase < RUN_STANCE:
                stands[frame, index] = True
            else:
                swing = (phase - RUN_STANCE + 1) / (RUN_PERIOD - RUN_STANCE + 1)
                ball[0] += stride * (swing - 0.9 * np.sin(2 * np.pi * swing) / 6.3)
                ball[2] += lift * np.sin(np.pi * swing)
                turn = toe_off * np.cos(0.5 * np.pi * swing)
            back, up = -0.13, 0.07
            ankle = ball + np.array(
                [
                    back * np.cos(turn) + up * np.sin(turn),
                    0.0,
                    up * np.cos(turn) - back * np.sin(turn),
                ]
            )
            positions[frame, JOINTS.index(f"{side}_ankle")] = ankle
            positions[frame, JOINTS.index(f"{side}_toe")] = ball
    return HumanMotion("running", motion.fps, positions, motion.quats), stands


@pytest.fixture
def runner() -> Callable[..., tuple[HumanMotion, np.ndarray]]:
    """`running`, for the tests."""
    return running
