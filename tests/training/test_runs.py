"""Whole training runs, seconds long."""

import numpy as np
import pytest
import torch

from openclone.errors import InputError
from openclone.policy.bundle import load_bundle
from openclone.training.checkpoint import load_checkpoint
from openclone.training.presets import STUDENTS, TEACHERS, teacher_preset
from openclone.training.student import train_student
from openclone.training.teacher import load_teacher, train_teacher


@pytest.fixture(scope="module")
def trained(tmp_path_factory, make_clip):
    out = tmp_path_factory.mktemp("run")
    teacher = train_teacher([make_clip()], TEACHERS["smoke"], out, threads=1)
    bundle = train_student([make_clip()], teacher, STUDENTS["smoke"], out, threads=1)
    return out, teacher, bundle


def test_the_bundle_runs_and_says_what_it_is(trained):
    bundle = load_bundle(trained[2])
    assert bundle.act(np.zeros((2, 2376))).shape == (2, 29)
    assert "steps" in bundle.info.training
    assert len(bundle.info.data_hash) == 64


def test_resume_goes_on_from_the_checkpoint(trained, make_clip):
    out, teacher, _ = trained
    before = load_checkpoint(teacher)
    train_teacher(
        [make_clip()], TEACHERS["smoke"], out, resume=True, minutes=0.06, threads=1
    )
    after = load_checkpoint(teacher)
    assert after["steps"] > before["steps"]
    assert after["minutes"] > before["minutes"]


def test_the_teacher_checkpoint_is_an_actor(trained):
    actor = load_teacher(trained[1])
    assert not actor.training
    assert sum(p.numel() for p in actor.parameters()) > 1000


def test_tensorboard_has_reward_terms(trained):
    events = list(trained[0].glob("events.out.tfevents.*"))
    assert events


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


def test_unknown_names_list_the_known_ones(make_clip):
    with pytest.raises(InputError, match="smoke"):
        teacher_preset("nope")
    with pytest.raises(InputError, match="categories"):
        train_teacher(
            [make_clip(category="jump")], TEACHERS["smoke"], "unused", threads=1
        )
