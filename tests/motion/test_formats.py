"""One motion in every format: each reader finds the same body in it."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import sample_recordings as samples
from scipy.spatial.transform import Rotation

from openclone.errors import InputError
from openclone.motion import readers
from openclone.motion.skeleton import JOINTS, HumanMotion
from openclone.motion.sources import asf_amc, bvh, mvnx

TRUTH = samples.make_truth()


def assert_is_truth(motion: HumanMotion, truth: samples.Truth = TRUTH) -> None:
    """Positions and orientations of all joints; a file world may face elsewhere."""
    assert motion.fps == pytest.approx(truth.fps, rel=1e-6)
    assert motion.num_frames == truth.frames
    for joint in JOINTS:
        assert np.allclose(motion.joint(joint), truth.place[joint], atol=1e-6), joint
        quats = motion.orientation(joint)[:, [1, 2, 3, 0]]
        error = (Rotation.from_quat(quats).inv() * truth.turn[joint]).magnitude()
        assert error.max() < 1e-6, joint


def read_bvh(tmp_path: Path, text: str) -> HumanMotion:
    path = tmp_path / "motion.bvh"
    path.write_text(text)
    return bvh.read(path)


@pytest.mark.parametrize("order", ["XYZ", "XZY", "YXZ", "YZX", "ZXY", "ZYX"])
@pytest.mark.parametrize("channels", [3, 6])
def test_bvh_of_any_euler_order(tmp_path: Path, order: str, channels: int) -> None:
    text = samples.bvh(TRUTH, order=order, channels=channels)
    assert_is_truth(read_bvh(tmp_path, text))


@pytest.mark.parametrize("unit", [1.0, 0.01, 0.001, 0.0254, 0.0254 / 0.45])
def test_bvh_of_any_unit(tmp_path: Path, unit: float) -> None:
    assert_is_truth(read_bvh(tmp_path, samples.bvh(TRUTH, unit=unit)))


def test_bvh_from_xsens(tmp_path: Path) -> None:
    text = samples.bvh(TRUTH, names=samples.XSENS, order="YXZ", channels=6)
    assert_is_truth(read_bvh(tmp_path, text))


def test_bvh_with_displacements_instead_of_positions(tmp_path: Path) -> None:
    assert_is_truth(read_bvh(tmp_path, samples.bvh(TRUTH, channels=6, added=True)))


@pytest.mark.parametrize(
    "world", [samples.Z_UP, np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])]
)
def test_bvh_with_z_up(tmp_path: Path, world: np.ndarray) -> None:
    """As Blender writes it; the second world faces -Y."""
    assert_is_truth(read_bvh(tmp_path, samples.bvh(TRUTH, world=world)))


def test_bvh_with_namespaces(tmp_path: Path) -> None:
    assert_is_truth(read_bvh(tmp_path, samples.bvh(TRUTH, prefix="mixamorig:")))


def lafan1_axes() -> dict[str, np.ndarray]:
    """The axes of LAFAN1's joints in the T-pose, spelled out as matrices."""
    forward, left, up = np.eye(3)
    limbs = {
        "hip": (-up, forward, -left), "knee": (-up, forward, -left),
        "toe": (forward, up, -left),
    }  # fmt: skip
    pitch = np.radians(-21.45)
    ankle = np.array([forward, up, -left]).T @ np.array(
        [[np.cos(pitch), -np.sin(pitch), 0], [np.sin(pitch), np.cos(pitch), 0],
         [0, 0, 1]]
    )  # fmt: skip
    axes = {name: np.array([up, forward, left]).T for name in samples.NAMES}
    for side, out, third in (("left", left, up), ("right", -left, -up)):
        for part, columns in limbs.items():
            axes[f"{side}_{part}"] = np.array(columns).T
        axes[f"{side}_ankle"] = ankle
        for part in ("shoulder", "elbow", "wrist"):
            axes[f"{side}_{part}"] = np.array([out, -forward, third]).T
    return axes


def test_bvh_with_axes_along_the_bones(tmp_path: Path) -> None:
    """LAFAN1: without rotations all its bones point the same way."""
    names = samples.ACCAD | {
        "chest": "Spine2", "left_toe": "LeftToe", "right_toe": "RightToe",
    }  # fmt: skip
    text = samples.bvh(TRUTH, names=names, order="ZYX", axes=lafan1_axes())
    assert_is_truth(read_bvh(tmp_path, text))


LAFAN1_T_POSE = {
    "Hips": (90, 0, 90), "LeftUpLeg": (180, 0, 180), "RightUpLeg": (180, 0, 180),
    "LeftFoot": (68.55, 0, 0), "RightFoot": (68.55, 0, 0),
    "LeftToe": (21.45, 0, 0), "RightToe": (21.45, 0, 0),
    "LeftShoulder": (0, -90, 180), "RightShoulder": (0, 90, 180),
}  # fmt: skip
"""ZYX angles in degrees, others zero: LAFAN1's T-pose to the nearest right angle."""
LAFAN1_BONES: tuple[tuple[str, str, tuple[float, float, float]], ...] = (
    ("Hips", "", (0, 0, 0)),
    ("LeftUpLeg", "Hips", (0.1, 1.9, 10.5)), ("LeftLeg", "LeftUpLeg", (43.5, 0, 0)),
    ("LeftFoot", "LeftLeg", (42.4, 0, 0)), ("LeftToe", "LeftFoot", (17.3, 0, 0)),
    ("RightUpLeg", "Hips", (0.1, 1.9, -10.5)), ("RightLeg", "RightUpLeg", (43.5, 0, 0)),
    ("RightFoot", "RightLeg", (42.4, 0, 0)), ("RightToe", "RightFoot", (17.3, 0, 0)),
    ("Spine", "Hips", (6.9, -2.6, 0)), ("Spine1", "Spine", (12.6, 0, 0)),
    ("Spine2", "Spine1", (12.3, 0, 0)), ("Neck", "Spine2", (25.8, 0, 0)),
    ("Head", "Neck", (11.8, 0, 0)),
    ("LeftShoulder", "Spine2", (19.7, -1.5, 6)),
    ("LeftArm", "LeftShoulder", (11, 0, 0)),
    ("LeftForeArm", "LeftArm", (33, 0, 0)), ("LeftHand", "LeftForeArm", (25, 0, 0)),
    ("RightShoulder", "Spine2", (19.7, -1.5, -6)),
    ("RightArm", "RightShoulder", (11, 0, 0)),
    ("RightForeArm", "RightArm", (33, 0, 0)), ("RightHand", "RightForeArm", (25, 0, 0)),
)  # fmt: skip


def lafan1(**moved: tuple[float, float, float]) -> str:
    """A skeleton of LAFAN1's kind in its T-pose, some joints moved (ZYX degrees)."""
    lines, row = ["HIERARCHY"], [0.0, 92.0, 0.0]

    def add(name: str, parent: str, offset: tuple[float, float, float]) -> None:
        head = "JOINT" if parent else "ROOT"
        place = "" if parent else "Xposition Yposition Zposition "
        lines.append(f"{head} {name} {{ OFFSET {' '.join(map(str, offset))}")
        count = 3 if parent else 6
        lines.append(f"CHANNELS {count} {place}Zrotation Yrotation Xrotation")
        row.extend(moved.get(name, LAFAN1_T_POSE.get(name, (0, 0, 0))))
        for bone in LAFAN1_BONES:
            if bone[1] == name:
                add(*bone)
        lines.append("}")

    add(*LAFAN1_BONES[0])
    lines += ["MOTION", "Frames: 3", "Frame Time: 0.0333333"]
    return "\n".join(lines + [" ".join(map(str, row))] * 3)


def test_lafan1_by_hand(tmp_path: Path) -> None:
    motion = read_bvh(tmp_path, lafan1())
    assert motion.fps == pytest.approx(30, abs=0.01)
    assert np.allclose(np.abs(motion.quats[..., 0]), 1, atol=1e-9)
    assert motion.joint("left_wrist")[0, 1] - motion.joint("left_hip")[0, 1] > 0.5
    assert motion.joint("left_toe")[0, 0] - motion.joint("left_ankle")[0, 0] > 0.15
    assert motion.joint("head")[0, 2] > 1.5
    # About its z: the knee bends the shank back, the elbow the forearm forward.
    bent = read_bvh(tmp_path, lafan1(LeftLeg=(-60, 0, 0), RightForeArm=(-90, 0, 0)))
    shank = bent.joint("left_ankle")[0] - bent.joint("left_knee")[0]
    assert shank == pytest.approx([-0.424 * np.sqrt(0.75), 0, -0.212], abs=1e-6)
    forearm = bent.joint("right_wrist")[0] - bent.joint("right_elbow")[0]
    assert forearm == pytest.approx([0.25, 0, 0], abs=1e-6)


def test_arms_that_hang_in_the_rest_pose(tmp_path: Path) -> None:
    """Rest with arms down: the same motion as from a rest in the T-pose."""
    text = samples.bvh(TRUTH)
    down = {}
    for side, sign in (("left", -1.0), ("right", 1.0)):
        quarter = Rotation.from_rotvec([sign * np.pi / 2, 0, 0]).as_matrix()
        for part in ("shoulder", "elbow", "wrist"):
            # The joint's axes are the world's while the arm hangs.
            down[f"{side}_{part}"] = quarter.T @ samples.Y_UP
    hanging = samples.bvh(TRUTH, axes=down)
    assert "OFFSET 28.0" in text
    assert "OFFSET 0.000000000 -28.0" in hanging
    assert_is_truth(read_bvh(tmp_path, hanging))


def test_a_new_skeleton_needs_only_a_map(tmp_path: Path) -> None:
    odd = {name: f"bone_{index}" for index, name in enumerate(samples.NAMES)}
    text = samples.bvh(TRUTH, names=odd)
    with pytest.raises(InputError, match="no joint for hips"):
        read_bvh(tmp_path, text)
    lines = ['format = "bvh"', 'world = "rest"', 'axes = "rest"', "[names]"]
    lines += [f'{name} = "{value}"' for name, value in odd.items()]
    (tmp_path / "mine.skeleton.toml").write_text("\n".join(lines))
    assert_is_truth(read_bvh(tmp_path, text))
    files = readers.source_files(tmp_path / "motion.bvh")
    assert [file.name for file in files] == ["motion.bvh", "mine.skeleton.toml"]


@pytest.mark.parametrize(
    ("angle", "order"), [("deg", "TX TY TZ RX RY RZ"), ("rad", "RX RY RZ TX TY TZ")]
)
def test_asf_amc(tmp_path: Path, angle: str, order: str) -> None:
    (tmp_path / "07.asf").write_text(samples.asf(angle=angle, root_order=order))
    # CMU's names end in the take, not in the rate, which is 120.
    path = tmp_path / "07_01.amc"
    truth = samples.make_truth(fps=120)
    text = samples.amc(truth, degrees=angle == "deg", root_first=order[0] == "T")
    path.write_text(text)
    assert_is_truth(asf_amc.read(path), truth)


def test_mvnx(tmp_path: Path) -> None:
    path = tmp_path / "motion.mvnx"
    path.write_text(samples.mvnx(TRUTH))
    assert_is_truth(mvnx.read(path))


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("<mvnx", '<!DOCTYPE m [<!ENTITY a "b">]>\n<mvnx', "line 2: a document type"),
        ("<mvnx", "<mvn", "line 2: the root element is 'mvn'"),
        ('frameRate="60"', 'frameRate="0"', "frameRate is 0"),
        ('frameRate="60"', "", "line 3: expected 1 finite"),
        ('label="T8"', 'label="T9"', "no segment for chest"),
        ('label="T8"', 'label="Neck"', "segment 'Neck' comes twice"),
        ("0.92", "x", r"line \d+: expected (54|72) finite numbers"),
        ("</frame>", "", "not well-formed"),
        ("<velocity>", "<position>1</position><velocity>", "position twice"),
        ("</subject>", '</subject><subject frameRate="60"/>', "a second subject"),
        ("<frames>", "<a>" * 40 + "<frames>", "more than 32 nested"),
        ('type="normal"', 'type="tpose"', "no frames|0 frames"),
    ],
)
def test_malformed_mvnx(tmp_path: Path, old: str, new: str, message: str) -> None:
    text = samples.mvnx(TRUTH)
    assert old in text
    path = tmp_path / "motion.mvnx"
    path.write_text(text.replace(old, new))
    with pytest.raises(InputError, match=message):
        mvnx.read(path)


def test_xml_bombs_stay_small(tmp_path: Path) -> None:
    path = tmp_path / "bomb.mvnx"
    for text in (
        "<mvnx><!--" + "x" * 3_000_000,
        "<mvnx a='" + "x" * 3_000_000,
        "<mvnx>" + "".join(f"<a{k}/>" for k in range(5000)),
        "<mvnx>" + "<a>" * 5000,
    ):
        path.write_text(text)
        with pytest.raises(InputError, match=r"bomb\.mvnx, line 1"):
            mvnx.read(path)


def test_pickles_and_strangers_are_refused(tmp_path: Path) -> None:
    for name in ("a.pkl", "a.fbx", "a"):
        (tmp_path / name).write_bytes(b"x")
    with pytest.raises(InputError, match="pickle"):
        readers.read_motion(tmp_path / "a.pkl")
    with pytest.raises(InputError, match=r"no reader for '\.fbx'"):
        readers.read_motion(tmp_path / "a.fbx")
    with pytest.raises(InputError, match="without suffix"):
        readers.read_motion(tmp_path / "a")
