"""The table of a tracking evaluation: means over seeds, and nothing left unsaid."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from openclone.cli.measuring import _left_out
from openclone.evaluation.metrics import Metrics
from openclone.evaluation.report import Report, write_report
from openclone.evaluation.tracking import ClipResult, TrackingReport, over_seeds
from openclone.evaluation.tracking_table import (
    KEYS,
    TrackingSetup,
    category_rows,
    figures,
    success_of_all,
    table_row,
    text_table,
)
from openclone.motion.clip import CATEGORIES


def result(category: str, sr: float, mpkpe: float, frames: int = 3) -> ClipResult:
    line, pose = np.zeros((frames, 3)), np.zeros((frames, 36))
    metrics = Metrics(sr, mpkpe, 30.0, 200.0, 3.0, 10.0, 70.0, 20.0, 2.0)
    return ClipResult(category, metrics, np.ones(frames), line, line, pose, pose)


def report(*values: tuple[str, str, float, float]) -> TrackingReport:
    return TrackingReport({name: result(c, sr, e) for name, c, sr, e in values})


@pytest.fixture
def three_seeds() -> TrackingReport:
    return over_seeds(
        [
            report(("a", "stand", 1.0, 40.0), ("b", "turn", 1.0, 100.0)),
            report(("a", "stand", 1.0, 50.0), ("b", "turn", 0.0, 130.0)),
            report(("a", "stand", 1.0, 60.0), ("b", "turn", 0.0, 160.0)),
        ]
    )


def test_means_and_spread_over_seeds_by_hand(three_seeds):
    assert three_seeds.clips["b"].metrics.sr == pytest.approx(1 / 3)
    assert three_seeds.clips["b"].metrics.mpkpe_mm == pytest.approx(130.0)
    assert three_seeds.overall.sr == pytest.approx(2 / 3)
    assert three_seeds.overall.mpkpe_mm == pytest.approx(90.0)
    # Means of the seeds are 70, 90 and 110 mm; successes 1, 1/2 and 1/2.
    assert three_seeds.spread is not None
    assert three_seeds.spread.mpkpe_mm == pytest.approx(20.0)
    assert three_seeds.spread.sr == pytest.approx(np.sqrt(1 / 12))
    data: dict[str, Any] = three_seeds.to_json()
    assert data["num_seeds"] == 3
    assert data["sr"] == pytest.approx(200 / 3)
    assert data["spread"]["sr"] == pytest.approx(100 * np.sqrt(1 / 12))
    assert [seed["mpkpe_mm"] for seed in data["by_seed"]] == [70.0, 90.0, 110.0]
    assert data["categories"]["turn"]["spread"]["mpkpe_mm"] == pytest.approx(30.0)


def test_the_failed_run_of_a_clip_is_the_one_that_is_drawn():
    shown = over_seeds(
        [
            TrackingReport({"a": result("stand", 1.0, 40.0, frames=9)}),
            TrackingReport({"a": result("stand", 0.0, 90.0, frames=4)}),
        ]
    )
    assert len(shown.clips["a"].error_mm) == 4


def test_one_seed_has_no_spread():
    single = report(("a", "stand", 1.0, 40.0))
    assert over_seeds([single]) is single
    assert single.spread is None
    assert "spread" not in single.to_json()
    assert table_row(single.overall) == ("100", "40.0", "30.0", "200", "3.00")


def test_every_category_has_a_row_and_refused_recordings_are_counted(three_seeds):
    setup = TrackingSetup("dev", left_out={"x": "wave", "y": "turn"})
    rows = {row[0]: row[1:] for row in category_rows(three_seeds, setup)}
    assert list(rows) == [*CATEGORIES, "all"]
    assert rows["turn"][:3] == ("1", "1", "33 ± 58")
    assert rows["wave"][:3] == ("0", "1", "-")
    assert rows["jump"][:3] == ("0", "0", "-")
    assert rows["all"][:2] == ("2", "2")
    # 1 + 1/3 successes among four recordings.
    assert success_of_all(three_seeds, setup) == pytest.approx(100 / 3)


def test_text_says_how_it_was_measured_beside_paper_and_target(three_seeds):
    text = text_table(three_seeds, TrackingSetup("train"))
    assert text.splitlines()[-1].endswith("70 mm/s, reference 20")
    for word in ("Eq. 2, 3 seeds", "randomization off", "head and hands only"):
        assert word in text.splitlines()[0]
    assert text.splitlines()[-3].split()[-5:] == ["100", "87.8", "33.3", "227", "3.61"]
    assert text.splitlines()[-2].split()[3::2] == ["98", "80", "33", "227", "3.6"]
    assert "its place alone" not in text
    free = text_table(three_seeds, TrackingSetup(look=False))
    assert "of the head its place alone" in free
    plain = text_table(three_seeds, TrackingSetup(noise=False))
    assert "odometry noise off" in plain
    assert "target" not in plain


def test_figures_for_json(three_seeds, tmp_path):
    setup = TrackingSetup("dev", left_out={"x": "wave"})
    data: dict[str, Any] = figures(three_seeds, setup)
    assert set(KEYS) <= data.keys()
    assert data["categories"]["wave"] == {"num_clips": 0, "num_left_out": 1}
    assert data["categories"]["turn"]["num_clips"] == 1
    assert data["domain_randomization"] is False
    assert data["paper"]["mpkpe_mm"] == 87.84
    assert data["target"]["sr"] == 95.0
    page = write_report(Report("t", "i", three_seeds, setup=setup), tmp_path)
    text = page.read_text()
    assert "target (dev)" in text
    assert "jump" in text
    assert "retargeting could not" in text


def test_what_the_manifest_lists_but_was_not_run_is_left_out(tmp_path: Path):
    rows = [
        ("split", "category", "path", "format", "seconds", "licence"),
        ("dev", "wave", "a/one.bvh", "bvh", "1", "x"),
        ("dev", "turn", "a/two.bvh", "bvh", "1", "x"),
        ("train", "turn", "a/three.bvh", "bvh", "1", "x"),
    ]
    (tmp_path / "manifest.tsv").write_text(
        "".join("\t".join(row) + "\n" for row in rows)
    )
    assert _left_out(tmp_path, "dev", "", {"a/one"}) == {"a/two": "turn"}
    assert _left_out(tmp_path, "dev", "wave", {"a/one"}) == {}
    assert _left_out(tmp_path / "a", "dev", "", set()) == {}
