"""What a build adds to its training clips: slower turns, lowered stands."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from openclone.motion import library
from openclone.motion.batch import Outcome
from openclone.motion.clip import load_clip, save_clip
from openclone.motion.curate import Build, BuildConfig, build
from openclone.motion.enrich import Enrichment, slowness
from openclone.motion.heights import head_heights
from openclone.motion.inspection import find_recording, human_beside
from openclone.motion.sources.gliding import Laps, gliding_laps

HEADER = "split\tcategory\tpath\tformat\tseconds\tlicence\n"
DOWN = {"LeftArm": (-75.0, 0.0, 0.0), "RightArm": (75.0, 0.0, 0.0)}
CONFIG = BuildConfig(enrichment=Enrichment(slower=(1.5,), heads_m=(0.9, 0.3)))


def nodding(frames: int, cycles: float) -> list[dict[str, tuple[float, float, float]]]:
    """A body whose chest bends forward and back ``cycles`` times."""
    bend = 15 * (1 - np.cos(2 * np.pi * cycles * np.arange(frames) / frames))
    return [{**DOWN, "Chest": (0.0, float(angle), 0.0)} for angle in bend]


@pytest.fixture(scope="module")
def made(
    bvh_text: Callable[..., str], tmp_path_factory: pytest.TempPathFactory
) -> tuple[Build, Path, dict[str, bool]]:
    """The build, its folder, and which of its motions were fresh when built again."""
    root, cache = tmp_path_factory.mktemp("set"), tmp_path_factory.mktemp("cache")
    rows = [HEADER]
    for split, category, name, frames in (
        ("train", "turn", "bend", 60),
        ("dev", "turn", "other", 50),
        ("train", "stand", "wait", 180),
        ("dev", "stand", "pause", 170),
        ("train", "stand", "brief", 100),
    ):
        (root / f"{name}.bvh").write_text(bvh_text(nodding(frames, 1.0)))
        rows.append(f"{split}\t{category}\t{name}.bvh\tbvh\t1\tCC0\n")
    (root / "manifest.tsv").write_text("".join(rows))
    laps = gliding_laps("synthetic/gliding_00", Laps(0.4, 2.0, 1.0, 0.5, 0.5, 0.02), 4)
    own = tmp_path_factory.mktemp("own")
    save_clip(laps, own / "gliding.npz")
    out = tmp_path_factory.mktemp("out")
    fresh: dict[str, bool] = {}

    def note(count: int, total: int, outcome: Outcome) -> None:
        fresh[outcome.job.info.name] = outcome.fresh

    build((root, own), out, CONFIG, cache=cache, workers=1)
    result = build((root, own), out, CONFIG, cache=cache, workers=1, progress=note)
    return result, out, fresh


def test_training_clips_and_no_others_are_varied(
    made: tuple[Build, Path, dict[str, bool]],
) -> None:
    sides = {clip.info.name: clip.split for clip in made[0].clips}
    assert sides == {
        "bend": "train",
        "bend~slow1.5": "train",
        "other": "dev",
        "wait": "train",
        "wait~head090": "train",
        "pause": "dev",
        "brief": "train",
        "synthetic/gliding_00": "train",
    }
    performances = {clip.info.name: clip.performance for clip in made[0].clips}
    assert performances["bend~slow1.5"] == performances["bend"]
    assert performances["wait~head090"] == performances["wait"]


def test_what_cannot_be_done_is_named(
    made: tuple[Build, Path, dict[str, bool]],
) -> None:
    (reject,) = made[0].rejects
    assert reject.info.name == "wait~head030"


def test_slower_takes_longer_in_the_same_postures(
    made: tuple[Build, Path, dict[str, bool]],
) -> None:
    out = made[1]
    quick = load_clip(out / "train" / "bend.npz")
    slow = load_clip(out / "train" / "bend~slow1.5.npz")
    assert slow.seconds == pytest.approx(1.5 * quick.seconds, abs=0.04)
    assert slow.info.category == "turn"
    assert slowness(slow.info.name) == 1.5
    assert slowness("a/turn~slow1.2~mirror") == 1.2
    assert slowness("a/slow_walk") == 1.0
    # Retargeted anew, not stretched: the nod is the same, its speed is not.
    pitch = [np.ptp(head_heights(clip.qpos)) for clip in (quick, slow)]
    assert pitch[1] == pytest.approx(pitch[0], abs=0.02)
    recording = find_recording(slow, out / "train" / "bend~slow1.5.npz")
    assert recording is not None
    assert len(human_beside(slow, recording)) == slow.num_frames


def test_lowered_clips_go_down_from_standing(
    made: tuple[Build, Path, dict[str, bool]],
) -> None:
    low = load_clip(made[1] / "train" / "wait~head090.npz")
    heads = head_heights(low.qpos)
    assert low.info.category == "squat"
    assert heads[0] > 1.1
    assert np.median(heads[60:]) == pytest.approx(0.9, abs=0.01)


def test_nothing_is_made_twice(made: tuple[Build, Path, dict[str, bool]]) -> None:
    fresh = dict(made[2])
    # What was refused has left nothing in the cache.
    assert fresh.pop("wait~head030")
    assert set(fresh) == {clip.info.name for clip in made[0].clips}
    assert not any(fresh.values())


def test_training_gets_all_of_it(
    made: tuple[Build, Path, dict[str, bool]], tmp_path: Path
) -> None:
    lines: list[str] = []
    clips = library.load_clips(
        made[1], "train", None, tmp_path, lines.append, apart=True
    )
    assert {clip.info.name for clip in clips} == {
        clip.info.name for clip in made[0].clips if clip.split == "train"
    }
    assert not lines
