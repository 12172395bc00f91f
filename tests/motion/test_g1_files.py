"""Motions of the G1 in other projects' formats: exact round trips, mjlab's loaders."""

from __future__ import annotations

import pickle
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import sample_recordings as samples
from scipy.spatial.transform import Rotation

from openclone import cli
from openclone.errors import InputError
from openclone.motion import exports, library, readers
from openclone.motion.clip import Clip, ClipInfo, clip_from_qpos, load_clip, save_clip
from openclone.motion.sources import g1_csv, gmr_npz, mjlab_npz
from openclone.robot import g1
from openclone.robot.model import standing_qpos


def make_clip(fps: float = 50.0, frames: int = 60) -> Clip:
    """Standing, turning while every joint swings by itself."""
    rng = np.random.default_rng(3)
    time = np.arange(frames) / fps
    qpos = np.tile(standing_qpos(), (frames, 1))
    qpos[:, 0] = 0.7 * time
    turn = Rotation.from_euler("zyx", np.stack((2 * time, 0.1 * time, -0.2 * time), 1))
    qpos[:, 3:7] = turn.as_quat()[:, [3, 0, 1, 2]]
    qpos[:, 7:] += 0.2 * np.sin(3 * time[:, None] + rng.uniform(0, 6, g1.NUM_JOINTS))
    info = ClipInfo("a/b", "turn", "a test", "CC0", fps)
    return clip_from_qpos(info, qpos)


def assert_same_motion(a: Clip, b: Clip) -> None:
    """To the last bit."""
    assert a.info.fps == b.info.fps
    assert np.array_equal(a.qpos, b.qpos)


def test_clip_round_trip_is_exact(tmp_path: Path) -> None:
    clip = make_clip(fps=59.94)
    save_clip(clip, tmp_path / "c.npz")
    again = readers.read_motion(tmp_path / "c.npz")
    assert isinstance(again, Clip)
    assert again.info == clip.info
    assert_same_motion(again, clip)
    assert_same_motion(load_clip(tmp_path / "c.npz"), clip)


def test_csv_round_trip_is_exact(tmp_path: Path) -> None:
    clip = make_clip(fps=30.0)
    g1_csv.write(clip, tmp_path / "m.csv")
    again = readers.read_motion(tmp_path / "m.csv")
    assert isinstance(again, Clip)
    assert_same_motion(again, clip)
    first = (tmp_path / "m.csv").read_text().splitlines()[1].split(",")
    assert len(first) == 36
    # Quaternion xyzw: the vertical part third, the scalar part last.
    assert float(first[5]) == clip.root_quat[1, 3]
    assert float(first[6]) == clip.root_quat[1, 0]


@pytest.mark.parametrize("fps", [50.0, 29.97])
def test_npz_round_trips_are_exact(tmp_path: Path, fps: float) -> None:
    clip = make_clip(fps)
    gmr_npz.write(clip, tmp_path / "gmr.npz")
    mjlab_npz.write(clip, tmp_path / "mjlab.npz")
    mjlab_npz.write(clip, tmp_path / "isaac.npz", isaac_order=True)
    for name in ("gmr", "mjlab", "isaac"):
        again = readers.read_motion(tmp_path / f"{name}.npz")
        assert isinstance(again, Clip), name
        assert_same_motion(again, clip)


@pytest.mark.parametrize("kind", ["csv", "mjlab", "beyondmimic", "gmr"])
def test_export_and_import_commands(tmp_path: Path, kind: str) -> None:
    fps = 30.0 if kind == "csv" else 50.0
    clip = make_clip(fps=fps, frames=12)
    save_clip(clip, tmp_path / "c.npz")
    out = tmp_path / ("m.csv" if kind == "csv" else "m.npz")
    words = ["motions", "export", tmp_path / "c.npz", "--format", kind, "--out", out]
    cli.run([str(word) for word in words])
    back = tmp_path / "back.npz"
    words = ["motions", "import", out, "--out", back, "--category", "turn"]
    cli.run([str(word) for word in words])
    assert_same_motion(load_clip(back), clip)
    assert load_clip(back).info.category == "turn"


def test_export_refuses_what_the_format_is_not(tmp_path: Path) -> None:
    clip = make_clip(frames=4)
    with pytest.raises(InputError, match=r"a file for csv ends in \.csv"):
        exports.export(clip, "csv", tmp_path / "m.npz")
    with pytest.raises(InputError, match="frames per second"):
        exports.export(clip, "gmr", tmp_path / "m.npz", fps=1e9)
    assert exports.export(clip, "csv", tmp_path / "m.csv").info.fps == 30


def test_isaac_lab_order() -> None:
    """The beginning of the list that Isaac Lab prints for the G1."""
    joints, bodies = mjlab_npz.breadth_first()
    names = [g1.JOINT_NAMES[index].removesuffix("_joint") for index in joints]
    assert names[:9] == [
        "left_hip_pitch", "right_hip_pitch", "waist_yaw",
        "left_hip_roll", "right_hip_roll", "waist_roll",
        "left_hip_yaw", "right_hip_yaw", "waist_pitch",
    ]  # fmt: skip
    assert names[-2:] == ["left_wrist_yaw", "right_wrist_yaw"]
    assert sorted(joints) == list(range(29))
    assert sorted(bodies) == list(range(30))


def test_mjlab_training_loads_the_export(tmp_path: Path) -> None:
    torch = pytest.importorskip("torch")
    from mjlab.tasks.tracking.mdp.commands import MotionLoader

    clip = make_clip()
    mjlab_npz.write(clip, tmp_path / "m.npz")
    bodies = torch.tensor([0, 15, 22])
    loaded = MotionLoader(str(tmp_path / "m.npz"), bodies)
    assert loaded.time_step_total == clip.num_frames
    assert np.allclose(loaded.joint_pos, clip.joint_angles, atol=1e-6)
    assert np.allclose(loaded.body_pos_w[:, 0], clip.root_position, atol=1e-6)
    assert np.allclose(loaded.body_quat_w[:, 0], clip.root_quat, atol=1e-6)
    # Velocities are the derivatives of what is loaded beside them.
    for name in ("joint", "body"):
        place = getattr(loaded, "joint_pos" if name == "joint" else "body_pos_w")
        speed = getattr(loaded, "joint_vel" if name == "joint" else "body_lin_vel_w")
        difference = (place[2:] - place[:-2]).numpy() * 25.0
        assert np.abs(difference - speed[1:-1].numpy()).max() < 0.02, name
    spin = loaded.body_ang_vel_w[1:-1, 2].numpy()
    quat = loaded.body_quat_w[:, 2].numpy()[:, [1, 2, 3, 0]].astype(float)
    turn = Rotation.from_quat(quat[2:]) * Rotation.from_quat(quat[:-2]).inv()
    assert np.abs(turn.as_rotvec() * 25.0 - spin).max() < 0.02


def mjlab_converter(path: Path) -> Any:
    """The motion as mjlab's script ``csv_to_npz`` reads it, at 50 Hz."""
    pytest.importorskip("torch")
    from mjlab.scripts.csv_to_npz import MotionLoader

    return MotionLoader(str(path), input_fps=30, output_fps=50, device="cpu")


def test_mjlab_converts_the_csv(tmp_path: Path) -> None:
    clip = make_clip(fps=30.0)
    g1_csv.write(clip, tmp_path / "m.csv")
    loaded = mjlab_converter(tmp_path / "m.csv")
    wanted = clip.resampled(50.0)
    count = loaded.output_frames
    assert abs(count - wanted.num_frames) <= 1
    count = min(count, wanted.num_frames)
    joints = loaded.motion_dof_poss[:count].numpy()
    assert np.abs(joints - wanted.joint_angles[:count]).max() < 1e-5
    quat = loaded.motion_base_rots[:count].numpy()
    assert np.abs(np.abs((quat * wanted.root_quat[:count]).sum(1)) - 1).max() < 1e-5


def test_the_robot_in_mjlab_has_our_order() -> None:
    """The names by which mjlab's loader picks bodies, from its own scene."""
    pytest.importorskip("torch")
    from mjlab.asset_zoo.robots import get_g1_robot_cfg
    from mjlab.entity import Entity

    from openclone.robot.model import build_model

    robot = Entity(get_g1_robot_cfg())
    model = build_model(floor=False)
    assert list(robot.body_names) == [model.body(k).name for k in range(1, model.nbody)]
    assert list(robot.joint_names) == list(g1.JOINT_NAMES)


def test_a_data_set_may_hold_foreign_clips(tmp_path: Path) -> None:
    # Standing still, which passes the quality gate.
    qpos = np.tile(standing_qpos(), (40, 1))
    clip = clip_from_qpos(ClipInfo("s", "stand", "a test", "CC0", 30.0), qpos)
    g1_csv.write(clip, tmp_path / "m.csv")
    (tmp_path / "notes.csv").write_text("a,b\n")
    (tmp_path / "notes.txt").write_text("hello")
    (tmp_path / "walk.txt").write_text(samples.deepmimic())
    found = sorted(p.name for p in tmp_path.iterdir() if readers.looks_like_motion(p))
    assert found == ["m.csv", "walk.txt"]
    header = "\t".join(library.COLUMNS)
    row = "train\tturn\tm.csv\tcsv\t2\tCC0 (a test)"
    (tmp_path / library.MANIFEST).write_text(f"{header}\n{row}\n")
    lines: list[str] = []
    loaded = library.load_clips(tmp_path, "train", None, tmp_path / "c", lines.append)
    assert loaded[0].info == ClipInfo("m", "turn", "m.csv", "CC0 (a test)", 50.0)
    assert np.array_equal(loaded[0].qpos, clip.resampled(50.0).qpos)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ("0.790000,", "", "line 1: expected 36 finite numbers, found 35"),
        ("0.790000", "nan", "line 1: expected 36 finite"),
        ("0.790000", "7_9", "line 1: expected 36 finite"),
        ("1.000000", "2.000000", "line 1: column 7 is 2"),
        ("1.000000", "0.200000", "line 1: the quaternion has length 0.2"),
        ("0.250000", "25.0", "line 6: column 23 is 25"),
        ("0.790000", "79000", "line 1: column 3 is 7.9e"),
    ],
)
def test_malformed_csv(tmp_path: Path, old: str, new: str, message: str) -> None:
    text = samples.g1_csv()
    assert old in text
    (tmp_path / "m.csv").write_text(text.replace(old, new))
    with pytest.raises(InputError, match=message):
        g1_csv.read(tmp_path / "m.csv")


def test_empty_csv(tmp_path: Path) -> None:
    (tmp_path / "m.csv").write_text("\n\n")
    with pytest.raises(InputError, match="2 to"):
        g1_csv.read(tmp_path / "m.csv")


def test_joints_and_bodies_that_disagree(tmp_path: Path) -> None:
    clip = make_clip()
    mjlab_npz.write(clip, tmp_path / "m.npz")
    arrays = dict(np.load(tmp_path / "m.npz"))
    arrays["joint_pos"] = arrays["joint_pos"][:, ::-1]
    np.savez(tmp_path / "bad.npz", **arrays)
    with pytest.raises(InputError, match="from where joint_pos puts them"):
        mjlab_npz.read(tmp_path / "bad.npz")


def test_arrays_that_need_pickle_are_never_loaded(tmp_path: Path) -> None:
    np.savez(
        tmp_path / "m.npz",
        fps=np.array(30),
        root_pos=np.array([{}, []], dtype=object),
        root_rot=np.zeros((2, 4)),
        dof_pos=np.zeros((2, 29)),
    )
    with pytest.raises(InputError, match=r"'root_pos' is not readable"):
        readers.read_motion(tmp_path / "m.npz")
    (tmp_path / "p.npz").write_bytes(pickle.dumps({"a": 1}))
    with pytest.raises(InputError, match="not a readable npz"):
        readers.read_motion(tmp_path / "p.npz")


def test_a_giant_on_paper_takes_no_memory(tmp_path: Path) -> None:
    """NumPy alone would allocate what the header promises before it reads."""
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (99999999999, 3), }"
    header = header.ljust(117) + b"\n"
    member = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header
    with zipfile.ZipFile(tmp_path / "m.npz", "w") as archive:
        for name in ("root_pos", "root_rot", "dof_pos", "fps"):
            archive.writestr(f"{name}.npy", member)
    with pytest.raises(InputError, match="not readable"):
        readers.read_motion(tmp_path / "m.npz")
    with pytest.raises(InputError):
        load_clip(tmp_path / "m.npz")
