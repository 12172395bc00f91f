"""Checkpoints that do not fit are refused in one line."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from openclone.errors import InputError
from openclone.training.presets import STUDENTS, TEACHERS
from openclone.training.student import train_student
from openclone.training.teacher import load_teacher, train_teacher

TEACHER, STUDENT = TEACHERS["smoke"], STUDENTS["smoke"]


def test_checkpoints_of_other_networks_are_refused(trained, make_clip, tmp_path):
    clips = [make_clip()]
    wider = replace(TEACHER, ppo=replace(TEACHER.ppo, hidden=(64, 32)))
    with pytest.raises(InputError, match="does not fit the preset's networks") as error:
        train_teacher(clips, wider, tmp_path, start=trained[1], threads=1)
    assert "\n" not in str(error.value)
    with pytest.raises(InputError, match="no 'ppo'"):
        train_teacher(clips, TEACHER, tmp_path, start=_student_file(tmp_path))
    other = replace(STUDENT, history=5)
    with pytest.raises(InputError, match="does not fit the preset's networks"):
        train_student(
            clips,
            trained[1],
            other,
            tmp_path,
            start=trained[2],
            threads=1,
        )


def _student_file(folder):
    path = folder / "student.pt"
    torch.save({"student": {}, "hidden": [8], "phase": "dagger"}, path)
    return path


def test_foreign_checkpoints_are_refused(tmp_path):
    path = tmp_path / "teacher.pt"
    with pytest.raises(InputError, match="no such checkpoint"):
        load_teacher(path)
    path.write_bytes(b"not a checkpoint")
    with pytest.raises(InputError, match="not a readable checkpoint"):
        load_teacher(path)
    torch.save({"x": np.float64}, path)  # a class: needs unpickling of globals
    with pytest.raises(InputError):
        load_teacher(path)


def test_a_teacher_of_another_task_is_refused(trained, make_clip, tmp_path):
    for steps in ((), (1, 2, 3, 4)):
        other = replace(STUDENT, task=replace(STUDENT.task, preview=steps))
        with pytest.raises(InputError, match=r"previews steps \(5, 10, 20, 40\), the"):
            train_student([make_clip()], trained[1], other, tmp_path, threads=1)
    bare = replace(TEACHER, task=replace(TEACHER.task, guidance="angles"))
    with pytest.raises(InputError, match="guidance is 'feedforward', the"):
        train_teacher([make_clip()], bare, tmp_path, start=trained[1], threads=1)
