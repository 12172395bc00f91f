"""The ASF/AMC reader: Acclaim's rules by hand, real recordings, and clear errors."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from openclone.errors import InputError
from openclone.motion.sources import asf_amc
from openclone.spatial import rotations

UNIT = 0.0254 / 0.45
"""Metres per file unit in HDM05."""
# bone: parent, direction, length, axis in degrees, degrees of freedom
BONES = {
    "lowerback": ("root", (0, 1, 0), 5, (0, 0, 0), "rx ry rz"),
    "thorax": ("lowerback", (0, 1, 0), 4, (0, 0, 0), "rx ry rz"),
    "lowerneck": ("thorax", (0, 1, 0), 2, (0, 0, 0), ""),
    "head": ("lowerneck", (0, 1, 0), 2, (0, 0, 0), "rx ry rz"),
    **{
        f"{s}{name}": (parent.format(s=s), direction, length, axis, dof)
        for s, d in (("l", 1), ("r", -1))
        for name, parent, direction, length, axis, dof in (
            ("hipjoint", "root", (d * 0.6, -0.8, 0), 2, (0, 0, 0), ""),
            ("femur", "{s}hipjoint", (d * 0.342020, -0.939693, 0), 7.4,
             (0, 0, d * 20), "rx ry rz"),
            ("tibia", "{s}femur", (d * 0.342020, -0.939693, 0), 7.2,
             (0, 0, d * 20), "rx"),
            ("foot", "{s}tibia", (0, -0.6, 0.8), 2, (0, 0, 0), "rx rz"),
            ("toes", "{s}foot", (0, 0, 1), 1, (0, 0, 0), "rx"),
            ("clavicle", "thorax", (d, 0, 0), 3, (0, 0, 0), ""),
            ("humerus", "{s}clavicle", (d, 0, 0), 5, (0, 0, 0), "rx ry rz"),
            ("radius", "{s}humerus", (d, 0, 0), 4, (0, 0, 0), "rx"),
            ("hand", "{s}radius", (d, 0, 0), 1, (0, 0, 0), "rx rz"),
        )
    },
}  # fmt: skip


def asf_text() -> str:
    lines = [":version 1.10", ":units", "  length 0.45", "  angle deg", ":root"]
    lines += ["  order TX TY TZ RX RY RZ", "  axis XYZ", ":bonedata"]
    for name, (_, direction, length, axis, dof) in BONES.items():
        lines += ["  begin", f"    name {name}"]
        lines.append("    direction " + " ".join(map(str, direction)))
        lines += [f"    length {length}", f"    axis {axis[0]} {axis[1]} {axis[2]} XYZ"]
        lines += [f"    dof {dof}"] if dof else []
        lines.append("  end")
    lines += [":hierarchy", "  begin"]
    lines += [f"    {parent} {name}" for name, (parent, *_) in BONES.items()]
    return "\n".join([*lines, "  end"]) + "\n"


def amc_text(frames: int = 3, **moved: str) -> str:
    lines = [":FULLY-SPECIFIED", ":DEGREES"]
    for frame in range(1, frames + 1):
        lines += [str(frame), "root " + moved.get("root", "0 17 0 0 0 0")]
        for name, (*_, dof) in BONES.items():
            if dof:
                values = moved.get(name, " ".join("0" for _ in dof.split()))
                lines.append(f"{name} {values}")
    return "\n".join(lines) + "\n"


def read(tmp_path: Path, amc: str, asf: str | None = None) -> asf_amc.HumanMotion:
    (tmp_path / "HDM_xx.asf").write_text(asf_text() if asf is None else asf)
    path = tmp_path / "HDM_xx_move_001_60.amc"
    path.write_text(amc)
    return asf_amc.read(path)


def test_rest_pose(tmp_path: Path) -> None:
    motion = read(tmp_path, amc_text())
    assert motion.fps == 60
    assert motion.joint("hips")[0] == pytest.approx([0, 0, 17 * UNIT])
    assert motion.joint("left_elbow")[0] == pytest.approx([0, 8 * UNIT, 26 * UNIT])
    assert motion.leg_length == pytest.approx(14.6 * UNIT)
    assert np.allclose(motion.quats, [1, 0, 0, 0])


def test_bone_axes_tilt_the_joint(tmp_path: Path) -> None:
    """A quarter turn about the femur's own tilted x axis lifts it straight ahead."""
    motion = read(tmp_path, amc_text(lfemur="-90 0 0"))
    thigh = motion.joint("left_knee")[0] - motion.joint("left_hip")[0]
    assert thigh == pytest.approx([7.4 * UNIT, 0, 0], abs=1e-4)


def test_fixed_axis_order(tmp_path: Path) -> None:
    """Acclaim turns about fixed axes, x first: root (90, 90, 0) sends +Y to +X."""
    motion = read(tmp_path, amc_text(root="0 17 0 90 90 0"))
    # +Y --x 90--> +Z --y 90--> +X of the file, which is +Y (left) here.
    spine = motion.joint("chest")[0] - motion.joint("hips")[0]
    assert spine == pytest.approx([0, 5 * UNIT, 0], abs=1e-6)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("\n2\n", "\n7\n", r"line \d+: expected frame 2, found '7'"),
        ("ltibia 0\n", "", r"line \d+: frame 1 lacks 'ltibia'"),
        ("ltibia 0\n", "ltibia nan\n", r"line \d+: expected 1 finite numbers"),
        ("ltibia 0\n", "ltibia 0 0\n", "'ltibia' with 2 values does not fit"),
        ("ltibia 0\n", "tail 0\n", "'tail' with 1 values does not fit"),
    ],
)
def test_malformed_motion(tmp_path: Path, old: str, new: str, message: str) -> None:
    text = amc_text()
    assert old in text
    with pytest.raises(InputError, match=message):
        read(tmp_path, text.replace(old, new, 1))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("direction 0 1 0", "direction 0 inf 0", r"asf, line \d+: expected 3 finite"),
        ("dof rx ry rz", "dof tx", "unsupported degrees of freedom"),
        ("    lfemur ltibia\n", "    lfemur lwing\n", "unknown bone"),
        ("    root lowerback\n", "", "does not hang on the root"),
        ("name head", "name skull", "unknown bone|no bone 'head'"),
        ("length 0.45", "length 0", "unit length 0"),
        ("length 0.45", "length 0.045", "a leg is 8.24 m long"),
        ("axis 0 0 0 XYZ", "axis 0 0 0 XYW", "unknown order of axes 'XYW'"),
    ],
)
def test_malformed_skeleton(tmp_path: Path, old: str, new: str, message: str) -> None:
    text = asf_text()
    assert old in text
    with pytest.raises(InputError, match=message):
        read(tmp_path, amc_text(), text.replace(old, new))


def test_every_cut_of_either_file_is_an_input_error(tmp_path: Path) -> None:
    amc, asf = amc_text(), asf_text()
    for length in range(0, amc.rindex("\n3\n"), 41):
        if amc[:length].endswith("\n") and amc[length:].startswith(("2\n", "3\n")):
            continue
        with pytest.raises(InputError):
            read(tmp_path, amc[:length].rstrip("0 \n") + "\nlfemur")
    for length in range(0, len(asf) - 60, 101):
        with pytest.raises(InputError):
            read(tmp_path, amc, asf[:length])


def test_no_frames(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="there are no frames"):
        read(tmp_path, ":DEGREES\n")


def test_skeleton_must_lie_beside(tmp_path: Path) -> None:
    path = tmp_path / "alone_120.amc"
    path.write_text(amc_text())
    with pytest.raises(InputError, match=r"no \.asf skeleton beside it"):
        asf_amc.read(path)


def test_recorded_squat(recordings: Path) -> None:
    motion = asf_amc.read(recordings / "hdm05" / "HDM_bd_squat1Reps_001_120.amc")
    assert motion.fps == 120
    height = motion.joint("hips")[:, 2]
    assert height[0] == pytest.approx(0.98, abs=0.06)
    assert height.min() < 0.75
    up = rotations.rotate(motion.orientation("head"), np.array([0.0, 0, 1]))
    assert up[:, 2].min() > 0.7
    # Squatting knees point forward, not back.
    lowest = int(height.argmin())
    middle = 0.5 * (motion.joint("left_hip") + motion.joint("left_ankle"))
    forward = rotations.rotate_inverse(
        rotations.heading(motion.orientation("hips")),
        motion.joint("left_knee") - middle,
    )
    assert forward[lowest, 0] > 0.1
