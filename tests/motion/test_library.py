"""Data sets: manifests, the cache of retargeted clips, folders of ready clips."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from openclone.errors import InputError
from openclone.motion import library
from openclone.motion.clip import ClipInfo, clip_from_qpos, load_clip, save_clip
from openclone.robot.model import standing_qpos

HEADER = "split\tcategory\tpath\tformat\tseconds\tlicence\n"
Text = Callable[..., str]


def row(split: str, category: str, path: str) -> str:
    return f"{split}\t{category}\t{path}\tbvh\t0.1\tCC0 (a test)\n"


@pytest.fixture
def root(bvh_text: Text, tmp_path: Path) -> Path:
    """Two standing recordings, one of each split."""
    folder = tmp_path / "set"
    (folder / "a").mkdir(parents=True)
    down = {"LeftArm": (-75.0, 0.0, 0.0), "RightArm": (75.0, 0.0, 0.0)}
    up = {"LeftArm": (20.0, 0.0, 0.0), "RightArm": (-20.0, 0.0, 0.0)}
    (folder / "a" / "stand.bvh").write_text(bvh_text([down] * 6))
    (folder / "a" / "wave.bvh").write_text(bvh_text([up] * 6))
    manifest = HEADER + row("train", "stand", "a/stand.bvh")
    manifest += row("train", "wave", "a/wave.bvh") + row("dev", "squat", "a/none.bvh")
    (folder / "manifest.tsv").write_text(manifest)
    return folder


def save(path: Path, category: str) -> None:
    info = ClipInfo(path.stem, category, "a test", "CC0", 50.0)
    save_clip(clip_from_qpos(info, np.tile(standing_qpos(), (5, 1))), path)


def test_recordings_are_retargeted_once(root: Path, tmp_path: Path) -> None:
    cache, lines = tmp_path / "cache", []
    first = library.load_clips(root, "train", None, cache, lines.append)
    assert [clip.info.name for clip in first] == ["a/stand", "a/wave"]
    assert first[0].info == ClipInfo(
        "a/stand", "stand", "a/stand.bvh", "CC0 (a test)", 50.0
    )
    assert len(lines) == 2
    assert "a/stand" in lines[0]
    again = library.load_clips(root, "train", ("wave",), cache, lines.append)
    assert len(lines) == 2
    assert np.array_equal(again[0].qpos, first[1].qpos)


def test_cache_follows_the_content(root: Path, bvh_text: Text, tmp_path: Path) -> None:
    cache, lines = tmp_path / "cache", []
    library.load_clips(root, "train", ("stand",), cache, lines.append)
    for path in cache.glob("*.npz"):
        path.write_bytes(b"damaged")
    library.load_clips(root, "train", ("stand",), cache, lines.append)
    assert len(lines) == 2
    (root / "a" / "stand.bvh").write_text(bvh_text([{}] * 6))
    library.load_clips(root, "train", ("stand",), cache, lines.append)
    assert len(lines) == 3
    assert all(load_clip(path).num_frames == 6 for path in cache.glob("*.npz"))


@pytest.mark.parametrize(
    ("split", "categories", "message"),
    [
        ("test", None, "no split 'test'; use one of dev, train"),
        ("train", ("fly",), "unknown category 'fly'; use one of stand, forward"),
        ("train", ("jump",), "no motion of category 'jump'; use one of stand, wave"),
        ("dev", None, r"none\.bvh: no such file; correct the manifest"),
    ],
)
def test_wrong_wishes_name_the_right_ones(
    root: Path,
    tmp_path: Path,
    split: str,
    categories: tuple[str, ...] | None,
    message: str,
) -> None:
    with pytest.raises(InputError, match=message):
        library.load_clips(root, split, categories, tmp_path / "cache", print)


def test_takes_of_what_is_held_out_are_left_out(
    root: Path, bvh_text: Text, tmp_path: Path
) -> None:
    for name in ("stand_1", "stand_2", "nod", "bow"):
        (root / "a" / f"{name}.bvh").write_text(bvh_text([{}] * 6))
    rows = [
        row("train", "stand", "a/stand_1.bvh"),
        row("dev", "stand", "a/stand_2.bvh"),
        row("train", "wave", "a/wave.bvh"),
        row("train", "wave", "a/nod.bvh"),
        row("test", "wave", "a/bow.bvh"),
    ]
    names = {"apart": ["a/wave"], "all": ["a/stand_1", "a/wave", "a/nod"]}
    greetings = [text.replace("\n", "\tgreeting\n") for text in rows[3:]]
    head = HEADER.replace("\n", "\tperformance\n")
    # Said by the manifest (nod and bow are one greeting), or seen by the names.
    said = head + "".join([text.replace("\n", "\t\n") for text in rows[:3]] + greetings)
    for manifest, apart in ((said, names["apart"]), (HEADER + "".join(rows), None)):
        (root / "manifest.tsv").write_text(manifest)
        lines: list[str] = []
        for wanted, kept in (
            (True, apart or ["a/wave", "a/nod"]),
            (False, names["all"]),
        ):
            clips = library.load_clips(
                root, "train", None, tmp_path / "cache", lines.append, apart=wanted
            )
            assert [clip.info.name for clip in clips] == kept
        (told,) = [line for line in lines if "held out" in line]
        assert "a/stand_1" in told
        assert ("a/nod" in told) == (apart is not None)


@pytest.mark.parametrize(
    ("manifest", "message"),
    [
        ("split path\n", "line 1: no column 'split'"),
        (HEADER + row("train", "stand", "../secret.bvh"), "line 2: the path"),
        (HEADER + row("train", "stand", "/etc/passwd"), "leaves the folder"),
        (HEADER + row("train", "dance", "a/stand.bvh"), "unknown category 'dance'"),
        (HEADER + 2 * row("train", "stand", "a/stand.bvh"), "line 3: .* listed twice"),
        (HEADER + "train\tstand\n", "line 2: no path"),
    ],
)
def test_malformed_manifests(root: Path, manifest: str, message: str) -> None:
    (root / "manifest.tsv").write_text(manifest)
    with pytest.raises(InputError, match=message):
        library.load_clips(root, "train", None, root / "cache", print)


def test_ready_clips_without_manifest(tmp_path: Path) -> None:
    save(tmp_path / "flat" / "one.npz", "stand")
    save(tmp_path / "flat" / "two.npz", "wave")
    clips = library.load_clips(tmp_path / "flat", "any", ("wave",), tmp_path, print)
    assert [clip.info.name for clip in clips] == ["two"]
    save(tmp_path / "split" / "dev" / "three.npz", "stand")
    clips = library.load_clips(tmp_path / "split", "dev", None, tmp_path, print)
    assert [clip.info.name for clip in clips] == ["three"]
    with pytest.raises(InputError, match="no split 'train'; use one of dev"):
        library.load_clips(tmp_path / "split", "train", None, tmp_path, print)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="neither a manifest nor clip files"):
        library.load_clips(tmp_path / "empty", "train", None, tmp_path, print)
    with pytest.raises(InputError, match="no such folder"):
        library.load_clips(tmp_path / "nowhere", "train", None, tmp_path, print)


def test_recordings_are_read_by_suffix(root: Path, tmp_path: Path) -> None:
    assert library.read_recording(root / "a" / "stand.bvh").num_frames == 6
    with pytest.raises(InputError, match=r"no reader for '\.fbx'; use \.bvh"):
        library.read_recording(tmp_path / "dance.fbx")


def test_default_cache(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert library.default_cache() == tmp_path / "openclone" / "clips"
    monkeypatch.delenv("XDG_CACHE_HOME")
    assert library.default_cache() == Path.home() / ".cache" / "openclone" / "clips"
