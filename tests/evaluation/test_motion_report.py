"""The report of a data set: every figure and reason stands on the page."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from openclone.errors import OpenCloneError
from openclone.evaluation.contact_sheet import Sheet, write_sheet
from openclone.evaluation.motion_report import figures_of, write_motion_report
from openclone.motion.clip import ClipInfo, clip_from_qpos, save_clip
from openclone.motion.curate import Build, BuildConfig, BuiltClip, Reject
from openclone.motion.quality import ClipQuality
from openclone.robot.model import standing_qpos

GOOD = ClipQuality(
    seconds=1800.0,
    ankle_mm=2.0,
    wrist_mm=12.0,
    lost_share=0.0,
    slide_cm_s=1.5,
    ground_share=0.0,
    self_share=0.0,
    limit_share=0.25,
    limit_joint="waist_pitch_joint",
    peak_speed=9.0,
    speed_ratio=0.4,
    peak_acceleration=300.0,
    spike_share=0.0,
    float_s=0.0,
    air_s=0.4,
    tilt_deg=20.0,
    turn_rad_s=3.0,
)


def info(name: str, category: str) -> ClipInfo:
    return ClipInfo(name, category, f"{name}.bvh", "CC0 <a test>", 50.0)


@pytest.fixture
def made() -> Build:
    """An hour of walking, half an hour of waving held out, and one reject."""
    clips = []
    for name, category, split, wrist in (
        ("a/walk_1", "forward", "train", 10.0),
        ("a/walk_2", "forward", "train", 20.0),
        ("b/wave", "wave", "dev", 60.0),
    ):
        path = f"{split}/{name.replace('/', '__')}.npz"
        quality = replace(GOOD, wrist_mm=wrist)
        clips.append(BuiltClip(info(name, category), split, path, name, "0", quality))
    reject = Reject(info("c/flip", "wave"), ("the body flips over", "it floats"), GOOD)
    return Build(tuple(clips), (reject,), BuildConfig(seed=7), "0123456789abcdef" * 4)


def test_figures(made: Build) -> None:
    figures = figures_of(made)
    assert (figures["accepted"], figures["rejected"]) == (3, 1)
    assert figures["minutes"] == pytest.approx(90)
    assert figures["seconds_by_category"] == {"forward": 3600.0, "wave": 1800.0}
    medians = figures["medians"]
    assert isinstance(medians, dict)
    assert medians["wrist_mm"] == pytest.approx(20)
    assert figures["rejects"] == {"c/flip": ["the body flips over", "it floats"]}


def test_page(made: Build, tmp_path: Path) -> None:
    page, note = write_motion_report(made, tmp_path, pictures=False)
    text = page.read_text()
    assert note == ""
    assert "the body flips over; it floats" in text
    rows = [re.findall(r"<td>(.*?)</td>", row) for row in text.split("<tr>")]
    assert ["forward", "2", "1.000", "0", "0.000", "0"] in rows
    assert ["wave", "1", "0.500", "1", "0.500", "1"] in rows
    assert "data:image/png;base64," in text
    assert "25% waist_pitch" in text
    assert "CC0 &lt;a test&gt;" in text
    assert "<a test>" not in text


def test_an_empty_data_set_has_a_report(made: Build, tmp_path: Path) -> None:
    page, _ = write_motion_report(replace(made, clips=()), tmp_path, pictures=True)
    assert "the body flips over" in page.read_text()
    assert figures_of(replace(made, clips=()))["medians"] == {}


def test_contact_sheet(tmp_path: Path) -> None:
    from matplotlib import image

    qpos = np.tile(standing_qpos(), (5, 1))
    path = tmp_path / "clip.npz"
    save_clip(clip_from_qpos(info("stand", "stand"), qpos), path)
    picture = tmp_path / "sheet.jpg"
    try:
        write_sheet([path], ["stand"], picture, Sheet(moments=2, size=64, columns=1))
    except OpenCloneError as error:
        pytest.skip(str(error))
    pixels = image.imread(picture)
    assert pixels.shape == (64 + 14, 128, 3)
    # The robot stands in the middle of each picture, the ground below it.
    first = pixels[14:, :64].astype(float)
    assert np.abs(first[28:36, 28:36].mean((0, 1)) - first[2, 2]).max() > 20


def test_no_renderer_is_told(
    made: Build, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    qpos = np.tile(standing_qpos(), (5, 1))
    for clip in made.clips:
        save_clip(clip_from_qpos(clip.info, qpos), tmp_path / clip.path)
    monkeypatch.setenv("MUJOCO_GL", "nonsense")
    page, note = write_motion_report(made, tmp_path, pictures=True)
    assert "MUJOCO_GL=nonsense cannot render here" in note
    assert "No pictures." in page.read_text()
