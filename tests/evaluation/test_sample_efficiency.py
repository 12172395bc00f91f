"""The course of a training run, from its event files and its bundles."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from tensorboard.compat.proto.event_pb2 import Event
from tensorboard.compat.proto.summary_pb2 import Summary
from tensorboard.summary.writer.event_file_writer import EventFileWriter

import sample_efficiency
import training_curve
from openclone.errors import InputError
from openclone.motion.sources.synthetic import generate
from openclone.training.presets import STUDENTS, TEACHERS
from openclone.training.student import train_student
from openclone.training.teacher import train_teacher
from training_curve import Curve, Logged

START = 1_700_000_000


def write_events(
    folder: Path, start: float, lines: list[tuple[float, int, dict[str, float]]]
) -> None:
    """An event file that began at ``start``: seconds after it, step, scalars."""
    writer = EventFileWriter(str(folder))
    for seconds, step, scalars in lines:
        for tag, value in scalars.items():
            summary = Summary(value=[Summary.Value(tag=tag, simple_value=value)])
            event = Event(wall_time=start + seconds, step=step, summary=summary)
            writer.add_event(event)
    writer.close()
    [new] = [f for f in folder.glob("events.out.*") if "done" not in f.name]
    new.rename(folder / f"events.out.tfevents.{start:.0f}.done")


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """Two minutes of teacher, stopped for an hour after the first, then a student."""
    teacher = tmp_path / "teacher"
    teacher.mkdir()
    write_events(teacher, START, [(60, 1000, {"success/stand": 0.5, "reward": 1.0})])
    later = START + 3600
    write_events(
        teacher, later, [(60, 2000, {"success/stand": 0.8, "success/turn": 0.4})]
    )
    write_events(
        tmp_path,
        later + 100,
        [(30, 300, {"success/stand": 0.2}), (90, 900, {"success/stand": 1.0})],
    )
    (tmp_path / "student.pt").touch()
    return tmp_path


def test_steps_and_minutes_go_on_from_the_teacher_and_leave_out_pauses(run):
    curve = training_curve.read_curve(run)
    assert [line.phase for line in curve.logged] == ["teacher"] * 2 + ["student"] * 2
    assert [line.steps for line in curve.logged] == [1000, 2000, 2300, 2900]
    minutes = [line.minutes for line in curve.logged]
    assert minutes == pytest.approx([1.0, 2.0, 2.5, 3.5], abs=1e-3)
    assert [line.mean for line in curve.logged] == pytest.approx([50, 60, 20, 100])
    assert curve.student_from == pytest.approx((2000, 2.0), abs=1e-3)
    assert curve.categories == ("stand", "turn")


def test_figure_table_and_points(run, tmp_path):
    out = tmp_path / "out"
    sample_efficiency.write([training_curve.read_curve(run)], out)
    assert (out / "sample_efficiency.png").read_bytes()[:4] == b"\x89PNG"
    table = (out / "sample_efficiency.md").read_text().splitlines()
    assert table[0] == f"## {run.name}"
    assert table[2] == "| minutes | steps | phase | training's episodes, % |"
    assert table[-1] == "| 4 | 0.00 M | student | 100 |"
    with (out / "sample_efficiency.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert [row["stand"] for row in rows] == ["50.0", "80.0", "20.0", "100.0"]
    assert [row["turn"] for row in rows] == ["", "40.0", "", ""]


def test_a_folder_that_is_no_run_is_refused(tmp_path):
    with pytest.raises(InputError, match="no event file"):
        training_curve.read_curve(tmp_path)


def test_moments_are_spread_over_the_minutes():
    lines = [Logged("student", 0.0, float(m), {"stand": 1.0}) for m in range(101)]
    chosen = sample_efficiency.moments(Curve("x", lines, (0.0, 0.0)), 5)
    assert [line.minutes for line in chosen] == [0, 25, 50, 75, 100]


def test_smoothing_keeps_length_and_mean():
    values = sample_efficiency.smooth([0.0, 3.0, 0.0, 0.0])
    assert values == pytest.approx([1.0, 1.0, 1.0, 0.0])


def test_held_out_motions_are_always_the_same_and_differ_from_each_other():
    first, second = sample_efficiency.held_out(("stand",), 2)
    [again] = sample_efficiency.held_out(("stand",), 1)
    assert np.array_equal(first.qpos, again.qpos)
    short = min(first.num_frames, second.num_frames)
    assert not np.allclose(first.qpos[:short], second.qpos[:short])


def test_a_run_of_the_smoke_presets_from_beginning_to_figure(tmp_path):
    clip = generate("stand", np.random.default_rng(0))
    run = tmp_path / "run"
    teacher = train_teacher([clip], TEACHERS["smoke"], run / "teacher", threads=1)
    bundle = train_student(
        [clip], teacher, STUDENTS["smoke"], run, tuning_minutes=0.0, threads=1
    )
    # 3 iterations of 4 steps of 16 robots; as if one had been kept after 0.1 minutes.
    assert training_curve.trained(bundle)[:2] == ("dagger", 192)
    (run / training_curve.KEPT).mkdir(exist_ok=True)
    kept = run / training_curve.KEPT / "student_0.1.onnx"
    kept.write_bytes(bundle.read_bytes())
    assert training_curve.trained(kept) == ("dagger", 192, 0.1)
    curve = training_curve.read_curve(run)
    assert {line.phase for line in curve.logged} <= {"teacher", "student"}
    assert curve.logged[-1].steps == 2 * 192
    clips = sample_efficiency.held_out(("stand",), 1)
    curve.evaluated.extend(training_curve.evaluate(curve, run, clips, seed=0))
    [done] = curve.evaluated
    assert done.steps == 2 * 192
    assert done.minutes == pytest.approx(curve.student_from[1] + 0.1)
    assert done.report.overall.sr in (0.0, 1.0)
    sample_efficiency.write([curve], tmp_path)
    assert "held-out motions: SR" in (tmp_path / "sample_efficiency.md").read_text()
