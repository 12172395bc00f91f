"""`openclone motions build` and `motions inspect` as a user types them."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from openclone import cli
from openclone.errors import InputError
from openclone.motion.clip import ClipInfo, clip_from_qpos, save_clip
from openclone.motion.sources import synthetic
from openclone.motion.sources.gliding import Laps, gliding_laps
from openclone.robot.model import standing_qpos


@pytest.fixture
def clips(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A good clip and one that is sunk by 5 cm."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    qpos = np.tile(standing_qpos(), (51, 1))
    for name, depth in (("good", 0.0), ("sunk", 0.05)):
        info = ClipInfo(name, "stand", "a test", "CC0", 50.0)
        low = qpos - np.eye(36)[2] * depth
        save_clip(clip_from_qpos(info, low), tmp_path / "in" / f"{name}.npz")
    return tmp_path / "in"


def test_build(clips: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out, figures = tmp_path / "out", tmp_path / "figures.json"
    words = ["motions", "build", str(clips), "--out", str(out), "--no-pictures"]
    cli.run([*words, "--json", str(figures), "--workers", "1"])
    text = capsys.readouterr().out
    assert "rejected sunk: parts are under the ground in 100.0%" in text
    assert f"1 of 2 motions accepted, in {out}" in text
    assert (out / "report.html").is_file()
    assert (out / "train" / "good.npz").is_file()
    assert json.loads(figures.read_text())["accepted"] == 1


def test_build_with_commands_and_enrichment(
    clips: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Gliding laps pass the gate and are for training; a long stand is also lowered."""
    laps = gliding_laps("synthetic/gliding_00", Laps(0.5, 2.0, 1.0, 0.5, 0.5, 0.0), 4)
    save_clip(laps, clips / "gliding.npz")
    still = ClipInfo("still", "stand", "still.bvh", "CC0", 50.0)
    qpos = np.tile(standing_qpos(), (161, 1))
    save_clip(clip_from_qpos(still, qpos), clips / "still.npz")
    cli.run(["motions", "inspect", str(clips / "gliding.npz"), "--no-view"])
    assert "gate      passed" in capsys.readouterr().out
    out = tmp_path / "out"
    words = ["motions", "build", str(clips), "--out", str(out), "--no-pictures"]
    cli.run([*words, "--enrich", "--workers", "1"])
    names = {path.stem for path in (out / "train").glob("*.npz")}
    assert {"still~head075", "still~head095", "synthetic__gliding_00"} <= names
    assert not {name for name in names if name.startswith(("good~", "synthetic__gli~"))}
    settings = json.loads((out / "build.json").read_text())
    assert settings["config"]["enrichment"]["heads_m"] == [0.65, 0.75, 0.85, 0.95]


def test_synthesize_gliding_laps(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(synthetic, "default_set", lambda *_, **__: [])
    words = ["motions", "synthesize", "--out", str(tmp_path), "--minutes", "0.1"]
    cli.run([*words, "--gliding", "2"])
    found = sorted(path.stem for path in tmp_path.glob("*gliding*.npz"))
    assert found == ["synthetic__gliding_00", "synthetic__gliding_01"]
    with pytest.raises(InputError, match="--gliding is -1"):
        cli.run([*words, "--gliding", "-1"])


def test_inspect_names_the_gate(
    clips: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cli.run(["motions", "inspect", str(clips / "good.npz"), "--no-view"])
    assert "gate      passed" in capsys.readouterr().out
    cli.run(["motions", "inspect", str(clips / "sunk.npz"), "--no-view"])
    assert "under the ground" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--dev-share", "0.9"], "--dev-share is 0.9"),
        (["--workers", "0"], "--workers is 0"),
        (["--category", "dance"], "unknown category 'dance'"),
    ],
)
def test_wrong_options(
    clips: Path, tmp_path: Path, words: list[str], message: str
) -> None:
    base = ["motions", "build", str(clips), "--out", str(tmp_path / "out")]
    with pytest.raises(InputError, match=message):
        cli.run([*base, *words])


def test_nothing_to_build(tmp_path: Path) -> None:
    empty = tmp_path / "empty"
    empty.mkdir()
    words = ["motions", "build", str(empty), "--out", str(tmp_path / "out")]
    with pytest.raises(InputError, match="no recordings found"):
        cli.run(words)
