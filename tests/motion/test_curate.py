"""Builds of small fabricated folders: what is kept, what is not, and the same twice."""

from __future__ import annotations

import csv
import hashlib
import json
from collections.abc import Callable
from pathlib import Path

import pytest

from openclone.errors import InputError
from openclone.motion import batch, library
from openclone.motion.batch import Outcome
from openclone.motion.clip import ClipInfo, clip_from_qpos, save_clip
from openclone.motion.curate import BUILD_FILE, REJECTS, Build, BuildConfig, build
from openclone.motion.discover import discover, guess_category
from openclone.motion.inspection import find_recording, human_beside
from openclone.robot.model import standing_qpos

Text = Callable[..., str]
DOWN = {"LeftArm": (-75.0, 0.0, 0.0), "RightArm": (75.0, 0.0, 0.0)}
UP = {"LeftArm": (20.0, 0.0, 0.0), "RightArm": (-20.0, 0.0, 0.0)}
HEADER = "split\tcategory\tpath\tformat\tseconds\tlicence\n"


def row(category: str, path: str, split: str = "train") -> str:
    return f"{split}\t{category}\t{path}\tbvh\t0.6\tCC0 (a test)\n"


@pytest.fixture(scope="module")
def root(bvh_text: Text, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two good performances of two takes, and one motion with each fault."""
    folder = tmp_path_factory.mktemp("set")
    files = {
        "stand_1.bvh": bvh_text([DOWN] * 31),
        "stand_2.bvh": bvh_text([DOWN] * 33),
        "wave_1.bvh": bvh_text([UP] * 31),
        "copy_of_wave.bvh": bvh_text([UP] * 31),
        "brief.bvh": bvh_text([DOWN] * 6),
        "broken.bvh": bvh_text([DOWN] * 31)[:-200] + "x\n",
        # A person who lies head down in the air for half of the time.
        "flip.bvh": bvh_text([DOWN] * 16 + [{**DOWN, "Hips": (0, 180, 0)}] * 16),
    }
    for name, text in files.items():
        (folder / name).write_text(text)
    manifest = HEADER + "".join(
        row("wave" if "wave" in name else "stand", name) for name in files
    )
    (folder / "manifest.tsv").write_text(manifest + row("stand", "missing.bvh"))
    return folder


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="module")
def made(
    root: Path, cache: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Build, Path]:
    out = tmp_path_factory.mktemp("out")
    return build((root,), out, cache=cache, workers=1), out


def hashes(folder: Path) -> dict[str, str]:
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name != BUILD_FILE
    }


def test_the_good_are_kept(made: tuple[Build, Path]) -> None:
    result, out = made
    assert {clip.info.name for clip in result.clips} == {"stand_1", "stand_2", "wave_1"}
    for clip in result.clips:
        data = (out / clip.path).read_bytes()
        assert hashlib.sha256(data).hexdigest() == clip.sha256
        assert clip.info.licence == "CC0 (a test)"
        assert clip.quality.ankle_mm is not None
    assert result.seconds == pytest.approx(0.6 + 0.64 + 0.6, abs=0.05)


def test_the_bad_are_named_with_the_right_reason(made: tuple[Build, Path]) -> None:
    result, out = made
    reasons = {r.info.name: "; ".join(r.reasons) for r in result.rejects}
    assert set(reasons) == {"copy_of_wave", "brief", "broken", "flip", "missing"}
    assert reasons["copy_of_wave"] == "the same recording as wave_1"
    assert "only 0.10 s (at least 0.5)" in reasons["brief"]
    assert "broken.bvh, line" in reasons["broken"]
    assert "flips over" in reasons["flip"]
    assert "no such file" in reasons["missing"]
    with (out / REJECTS).open() as stream:
        table = {r["name"]: r["reason"] for r in csv.DictReader(stream, delimiter="\t")}
    assert table == reasons


def test_what_is_built_can_be_loaded(made: tuple[Build, Path], tmp_path: Path) -> None:
    result, out = made
    rows = library.read_manifest(out)
    assert [entry.path for entry in rows] == [out / c.path for c in result.clips]
    clips = library.load_clips(out, "train", None, tmp_path, print)
    names = {clip.info.name for clip in clips}
    assert names == {c.info.name for c in result.clips if c.split == "train"}
    assert {clip.info.category for clip in clips} <= {"stand", "wave"}


def test_takes_of_one_performance_stay_together(made: tuple[Build, Path]) -> None:
    sides = {clip.info.name: clip.split for clip in made[0].clips}
    assert sides["stand_1"] == sides["stand_2"]


def test_splits_of_a_manifest_are_kept(root: Path, cache: Path, tmp_path: Path) -> None:
    text = HEADER + row("stand", "stand_1.bvh") + row("wave", "wave_1.bvh", "dev")
    text += row("stand", "stand_2.bvh", "dev")
    for name in ("stand_1.bvh", "stand_2.bvh", "wave_1.bvh"):
        (tmp_path / name).write_bytes((root / name).read_bytes())
    (tmp_path / "manifest.tsv").write_text(text)
    for seed in range(4):
        config = BuildConfig(seed=seed)
        result = build((tmp_path,), tmp_path / "out", config, cache=cache, workers=1)
        # stand_1 and stand_2 are takes of one performance: both are held out.
        assert {clip.split for clip in result.clips} == {"dev"}
        assert [item.name for item in result.moved] == ["stand_1"]
    settings = json.loads((tmp_path / "out" / BUILD_FILE).read_text())
    assert settings["moved"][0]["given"] == "train"
    config = BuildConfig(resplit=True)
    again = build((tmp_path,), tmp_path / "out", config, cache=cache, workers=1)
    # One performance of each category is too little to hold any out.
    assert {clip.split for clip in again.clips} == {"train"}
    assert not again.moved


def test_same_bytes_for_one_and_two_processes(
    root: Path,
    made: tuple[Build, Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(batch, "_WORTHWHILE", 1)
    again = build((root,), tmp_path / "out", cache=tmp_path / "cache", workers=2)
    assert again.digest == made[0].digest
    assert hashes(tmp_path / "out") == hashes(made[1])


def test_an_interrupted_build_goes_on(root: Path, tmp_path: Path) -> None:
    def interrupt(count: int, total: int, outcome: Outcome) -> None:
        if count == 2:
            raise KeyboardInterrupt

    out, cache = tmp_path / "out", tmp_path / "cache"
    with pytest.raises(KeyboardInterrupt):
        build((root,), out, cache=cache, workers=1, progress=interrupt)
    assert not (out / "manifest.tsv").exists()
    fresh: dict[str, bool] = {}

    def note(count: int, total: int, outcome: Outcome) -> None:
        fresh[outcome.job.info.name] = outcome.fresh

    build((root,), out, cache=cache, workers=1, progress=note)
    assert [name for name, is_fresh in fresh.items() if not is_fresh] == [
        "stand_1",
        "stand_2",
    ]
    assert fresh["wave_1"]


def test_damaged_figures_are_made_again(root: Path, tmp_path: Path) -> None:
    jobs = [library.job_of(library.read_manifest(root)[0], tmp_path)]
    assert batch.run_jobs(jobs, 1)[0].fresh
    assert not batch.run_jobs(jobs, 1)[0].fresh
    jobs[0].result.with_suffix(".json").write_text('{"version": 0}')
    assert batch.run_jobs(jobs, 1)[0].fresh


def test_a_new_build_replaces_the_old_one(
    root: Path, cache: Path, tmp_path: Path
) -> None:
    build((root,), tmp_path, cache=cache, workers=1)
    (tmp_path / "train" / "mine.npz").write_bytes(b"kept")
    config = BuildConfig(seed=0, dev_share=0.0)
    result = build((root / "wave_1.bvh",), tmp_path, config, cache=cache, workers=1)
    found = {str(p.relative_to(tmp_path)) for p in tmp_path.rglob("*.npz")}
    assert found == {result.clips[0].path, "train/mine.npz"}


def test_ready_clips_pass_the_same_gate(tmp_path: Path) -> None:
    still = standing_qpos()[None].repeat(51, axis=0)
    sunk = still.copy()
    sunk[:, 2] -= 0.05
    for name, qpos in (("good", still), ("sunk", sunk)):
        info = ClipInfo(f"made/{name}", "stand", "a generator", "CC0", 50.0)
        save_clip(clip_from_qpos(info, qpos), tmp_path / "in" / f"{name}.npz")
    out = tmp_path / "out"
    result = build((tmp_path / "in",), out, cache=tmp_path / "cache", workers=1)
    assert [clip.info.name for clip in result.clips] == ["made/good"]
    assert result.clips[0].info.source == "a generator"
    assert result.clips[0].quality.ankle_mm is None
    assert "under the ground" in result.rejects[0].reasons[0]


def test_settings_are_written_down(made: tuple[Build, Path], root: Path) -> None:
    result, out = made
    settings = json.loads((out / BUILD_FILE).read_text())
    assert settings["motions"] == result.digest
    assert (settings["clips"], settings["rejects"]) == (3, 5)
    assert settings["config"]["seed"] == 0
    assert (out / settings["sources"][0]).resolve() == root.resolve()


def test_the_human_is_found_again(made: tuple[Build, Path], root: Path) -> None:
    result, out = made
    path = out / result.clips[0].path
    clip = library.load_clip(path)
    recording = find_recording(clip, path)
    assert recording is not None
    assert recording.resolve() == (root / clip.info.source).resolve()
    human = human_beside(clip, recording)
    assert human.shape == (clip.num_frames, 18, 3)
    # The person of the fixture is 1.7 m tall: feet on the ground, head at 1.5 m.
    assert human[..., 2].min() == pytest.approx(0, abs=0.05)
    assert 1.3 < human[..., 2].max() < 1.8
    with pytest.raises(InputError, match="lasts 6 frames, the clip"):
        human_beside(clip, root / "brief.bvh")


def test_folders_without_a_manifest_are_searched(
    bvh_text: Text, tmp_path: Path
) -> None:
    (tmp_path / "deep").mkdir()
    (tmp_path / "deep" / "slow_walk.bvh").write_text(bvh_text([DOWN] * 3))
    (tmp_path / "notes.txt").write_text("no motion")
    found = discover((tmp_path,))
    assert [(r.name, r.info.category) for r in found] == [("deep/slow_walk", "forward")]
    assert discover((tmp_path,), "turn", "CC0")[0].info.category == "turn"
    twice = discover((tmp_path, tmp_path / "deep"))
    assert [r.name for r in twice] == ["deep/slow_walk", "slow_walk"]
    with pytest.raises(InputError, match="no such file or folder"):
        discover((tmp_path / "nowhere",))
    with pytest.raises(InputError, match="unknown category 'dance'"):
        discover((tmp_path,), "dance")
    with pytest.raises(InputError, match="two motions are called"):
        discover((tmp_path, tmp_path, tmp_path))


@pytest.mark.parametrize(
    ("name", "category"),
    [
        ("accad/Female1_B05_WalkBackwards", "backward"),
        ("accad/Female1_B22_SideStepLeft", "stepside"),
        ("hdm05/HDM_bd_sneak2StepsLStart_001_120", "crouchwalk"),
        ("hdm05/HDM_bd_depositFloorR_001_120", "pickup"),
        ("lafan/walk1_subject2", "forward"),
        ("a/b/unnamed", "transition"),
    ],
)
def test_categories_are_guessed_from_names(name: str, category: str) -> None:
    assert guess_category(name) == category
