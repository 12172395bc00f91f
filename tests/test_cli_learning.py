"""What the training commands learn from."""

from __future__ import annotations

from pathlib import Path

import pytest

from openclone.cli.learning import _training_clips
from openclone.motion.clip import ClipInfo, clip_from_qpos, save_clip
from openclone.robot.model import standing_qpos


def test_takes_of_held_out_performances_are_not_trained_on(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = ["split\tcategory\tpath\tformat\tseconds\tlicence"]
    for split, name in (("train", "walk_1"), ("dev", "walk_2"), ("train", "nod")):
        info = ClipInfo(name, "stand", "a test", "CC0", 50.0)
        clip = clip_from_qpos(info, standing_qpos()[None].repeat(60, axis=0))
        save_clip(clip, tmp_path / f"{name}.npz")
        lines.append(f"{split}\tstand\t{name}.npz\tclip\t1.2\tCC0")
    (tmp_path / "manifest.tsv").write_text("\n".join([*lines, ""]))
    clips = _training_clips((tmp_path,))
    assert [clip.info.name for clip in clips] == ["nod"]
    told = capsys.readouterr().out.splitlines()
    assert len(told) == 1
    assert "held out: walk_1" in told[0]
