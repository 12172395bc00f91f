"""Clip files: exact round trips, resampling, and refusal of everything malformed."""

from __future__ import annotations

import io
import json
import zipfile
from collections.abc import Callable
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest

from openclone.errors import InputError
from openclone.motion import clip as clips
from openclone.motion.clip import Clip, ClipInfo
from openclone.robot import g1
from openclone.spatial import rotations

INFO = ClipInfo("test/turning", "turn", "made by a test", "CC0", 30.0)


@pytest.fixture
def clip() -> Clip:
    """Two seconds of walking a circle at constant speed with swinging joints."""
    time = np.arange(61) / INFO.fps
    position = np.stack((np.cos(time), np.sin(time), 0.75 + 0 * time), -1)
    joints = g1.DEFAULT_POSE + 0.1 * time[:, None]
    return Clip(INFO, position, rotations.from_yaw(time), joints)


def test_round_trip_is_exact(clip: Clip, tmp_path: Path) -> None:
    path = tmp_path / "deep" / "turning.npz"
    clips.save_clip(clip, path)
    back = clips.load_clip(path)
    assert back.info == clip.info
    assert np.array_equal(back.qpos, clip.qpos)
    assert back.num_frames == 61
    assert back.seconds == pytest.approx(2.0)
    assert [item.name for item in path.parent.iterdir()] == ["turning.npz"]


def test_resampling_keeps_the_motion(clip: Clip) -> None:
    fast = clip.resampled(50.0)
    assert fast.num_frames == 101
    assert fast.seconds == pytest.approx(clip.seconds)
    assert np.allclose(fast.qpos[0], clip.qpos[0])
    assert np.allclose(fast.qpos[-1], clip.qpos[-1])
    time = np.arange(101) / 50
    assert np.allclose(np.unwrap(rotations.yaw(fast.root_quat)), time, atol=1e-9)
    assert np.allclose(fast.joint_angles, g1.DEFAULT_POSE + 0.1 * time[:, None])
    # A chord of the circle lies at most 1 - cos(1/60 rad) inside it.
    radius = np.linalg.norm(fast.root_position[:, :2], axis=1)
    assert np.all((radius > 1 - 1.5e-4) & (radius < 1 + 1e-9))


def test_qpos_with_jumping_signs_becomes_continuous(clip: Clip) -> None:
    qpos = clip.qpos.copy()
    qpos[20:40, 3:7] *= -2.0
    back = clips.clip_from_qpos(INFO, qpos)
    assert np.allclose(back.qpos, clip.qpos)


def test_hash_names_the_motions(clip: Clip) -> None:
    other = replace(clip, info=replace(INFO, name="test/other"))
    moved = replace(clip, root_position=clip.root_position + 1e-9)
    assert clips.clip_hash([clip, other]) == clips.clip_hash([other, clip])
    hashes = {clips.clip_hash([item]) for item in (clip, other, moved)}
    assert len(hashes) == 3
    assert all(len(item) == 64 for item in hashes)


def spoil(clip: Clip, field: str, change: Callable[[np.ndarray], object]) -> Clip:
    values = getattr(clip, field).copy()
    change(values)
    return replace(clip, **{field: values})


def put(place: object, value: float) -> Callable[[np.ndarray], object]:
    return lambda values: values.__setitem__(place, value)


BROKEN = {
    "nan": (
        lambda c: spoil(c, "joint_angles", put((7, 3), np.nan)),
        r"joint_angles\[7, 3\] is not a finite number; repair",
    ),
    "infinite": (
        lambda c: spoil(c, "root_position", put((60, 2), np.inf)),
        r"root_position\[60, 2\]",
    ),
    "not unit": (
        lambda c: spoil(c, "root_quat", put((5, 0), 3.0)),
        r"root_quat\[5\] has length 3\.",
    ),
    "28 joints": (
        lambda c: replace(c, joint_angles=c.joint_angles[:, :28]),
        r"joint_angles has shape \(61, 28\), expected \(61, 29\)",
    ),
    "fewer frames": (
        lambda c: replace(c, root_quat=c.root_quat[:50]),
        r"root_quat has shape \(50, 4\)",
    ),
    "a number": (
        lambda c: replace(c, root_position=np.array(3.0)),
        "2 to 1000000 frames, this one 1",
    ),
    "one frame": (
        lambda c: Clip(INFO, c.root_position[:1], c.root_quat[:1], c.joint_angles[:1]),
        "2 to 1000000 frames, this one 1",
    ),
    "rate": (lambda c: replace(c, info=replace(INFO, fps=0.0)), "fps is 0"),
    "rate nan": (lambda c: replace(c, info=replace(INFO, fps=np.nan)), "fps is nan"),
    "category": (
        lambda c: replace(c, info=replace(INFO, category="dance")),
        "unknown category 'dance'; use one of stand",
    ),
}


def write_raw(clip: Clip, path: Path, **changes: np.ndarray) -> None:
    """Write the file format by hand, unchecked."""
    metadata = json.dumps({"format": clips.FORMAT, **asdict(clip.info)})
    arrays = {
        "metadata": np.array(metadata),
        "root_position": clip.root_position,
        "root_quat": clip.root_quat,
        "joint_angles": clip.joint_angles,
        **changes,
    }
    np.savez(path, **arrays)  # type: ignore[arg-type]


@pytest.mark.parametrize("name", BROKEN)
def test_broken_values_are_refused(name: str, clip: Clip, tmp_path: Path) -> None:
    change, message = BROKEN[name]
    path = tmp_path / "broken.npz"
    with pytest.raises(InputError, match=message) as raised:
        clips.save_clip(change(clip), path)
    assert str(path) in str(raised.value)
    assert not path.exists()
    write_raw(change(clip), path)
    with pytest.raises(InputError, match=message) as raised:
        clips.load_clip(path)
    assert str(raised.value).startswith(f"{path}: ")


def test_missing_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"no such clip file; make clips"):
        clips.load_clip(tmp_path / "none.npz")


@pytest.mark.parametrize("share", [0.0, 0.3, 0.9, 0.999])
def test_truncated_file(share: float, clip: Clip, tmp_path: Path) -> None:
    path = tmp_path / "short.npz"
    clips.save_clip(clip, path)
    whole = path.read_bytes()
    path.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(InputError, match="not a readable clip"):
        clips.load_clip(path)


def test_every_flipped_byte_is_refused_or_harmless(clip: Clip, tmp_path: Path) -> None:
    """Damage never escapes as another exception."""
    path = tmp_path / "damaged.npz"
    clips.save_clip(clip, path)
    whole = bytearray(path.read_bytes())
    rng = np.random.default_rng(0)
    for place in rng.integers(0, len(whole), 200):
        damaged = whole.copy()
        damaged[place] ^= 0xFF
        path.write_bytes(damaged)
        try:
            clips.load_clip(path)
        except InputError:
            continue


def test_object_arrays_are_refused(clip: Clip, tmp_path: Path) -> None:
    """An object array holds a pickle, which could run code on reading."""
    path = tmp_path / "pickle.npz"
    trap = np.array([{"run": "code"}], dtype=object)
    write_raw(clip, path, joint_angles=trap)
    with pytest.raises(InputError, match="not a readable clip"):
        clips.load_clip(path)


@pytest.mark.parametrize(
    "metadata",
    ["not json", "[]", "{}", '{"format": "openclone-clip-9"}', "17"],
)
def test_bad_metadata_is_refused(metadata: str, clip: Clip, tmp_path: Path) -> None:
    path = tmp_path / "metadata.npz"
    write_raw(clip, path, metadata=np.array(metadata))
    with pytest.raises(InputError, match=r"metadata\.npz: not a"):
        clips.load_clip(path)


def test_archive_without_arrays_and_other_files(tmp_path: Path) -> None:
    path = tmp_path / "other.npz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("readme.txt", "hello")
    with pytest.raises(InputError, match="not a readable clip"):
        clips.load_clip(path)
    buffer = io.BytesIO()
    np.save(buffer, np.zeros(3))
    path.write_bytes(buffer.getvalue())
    with pytest.raises(InputError, match="not a readable clip"):
        clips.load_clip(path)


def test_an_oversized_archive_is_refused_unread(
    clip: Clip, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "bomb.npz"
    clips.save_clip(clip, path)
    monkeypatch.setattr(clips, "MAX_FILE_BYTES", path.stat().st_size - 1)
    with pytest.raises(InputError, match="larger than"):
        clips.load_clip(path)
