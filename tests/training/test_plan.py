"""Cost of a preset: arithmetic by hand, and the command."""

import json
import math
import subprocess
import sys
from dataclasses import replace

import pytest
import torch

from openclone.cli import learning
from openclone.errors import InputError
from openclone.policy.teacher import teacher_size
from openclone.training import plan
from openclone.training.imitation import ImitationConfig
from openclone.training.presets import TEACHERS
from openclone.training.progress import Budget
from openclone.training.teacher import TeacherTrainer

SMOKE = TEACHERS["smoke"]


def test_time_follows_from_the_bound_that_ends_the_run():
    by_time = plan._phase("x", 256, 16, 1000.0, Budget(30.0), 2.0**20)
    assert by_time.steps == 1000 * 60 * 30
    assert by_time.iterations == pytest.approx(1_800_000 / 4096)
    assert (by_time.minutes, by_time.memory_mb) == (30.0, 1.0)
    # The paper's teacher: a million iterations of 8192 robots and 24 steps.
    paper = plan._phase("x", 8192, 24, 4000.0, Budget(math.inf, 1_000_000), 0.0)
    assert paper.steps == pytest.approx(1.966e11, rel=1e-3)
    assert paper.minutes / 525_600 == pytest.approx(1.559, rel=1e-3)


def test_storage_counts_every_tensor_of_a_roll_out():
    trainer = TeacherTrainer([plan.waving()], SMOKE, 0, 1)
    config = replace(SMOKE.ppo, minibatches=1, hidden=())
    got = plan._ppo_bytes(trainer.ppo, config, robots=160)
    # Observation, action, and reward, value, return, advantage, log-probability in
    # 4 bytes each, and a byte for the end; as much again twice for the one minibatch.
    seen = teacher_size(len(SMOKE.task.preview))
    row = 4 * (seen + 29 + 5) + 1
    networks = 16 * sum(
        p.numel()
        for net in (trainer.ppo.actor, trainer.ppo.critic)
        for p in net.parameters()
    )
    assert got - networks == pytest.approx(3 * 4 * 160 * row)


def test_scaled_batches_keep_the_work_per_step():
    from openclone.training.presets import STUDENTS

    paper = STUDENTS["paper"]
    scaled = plan._scaled(paper)
    assert scaled.batch / 256 == paper.distillation.batch / 4096
    fast = STUDENTS["fast"]
    few = replace(fast, task=replace(fast.task, num_envs=plan.MEASURED_ROBOTS))
    assert plan._scaled(few) == fast.distillation


def test_command_prints_and_writes_the_plan(tmp_path, capsys):
    torch.manual_seed(0)
    path = tmp_path / "plan.json"
    learning.train_plan(preset="smoke", seconds=0.05, threads=1, json=path)
    text = capsys.readouterr().out
    for word in (
        "teacher",
        "student, DAgger",
        "student, value gradients",
        "steps/s",
        "MB",
        "all",
    ):
        assert word in text
    figures = json.loads(path.read_text())
    teacher, dagger, tuning = figures["phases"]
    assert teacher["steps"] == pytest.approx(3 * 4 * 16)
    assert [p["iterations"] for p in (dagger, tuning)] == pytest.approx([3, 3])
    for phase in figures["phases"]:
        assert phase["steps_per_s"] > 0
        expected = phase["steps"] / phase["steps_per_s"] / 60
        assert phase["minutes"] == pytest.approx(expected)
        assert 500 < phase["memory_mb"] < 2000


def test_gains_take_four_kilobytes_a_frame():
    one = plan.plan_gains(30.0, 1)
    assert one.steps == 30 * 60 * 50
    assert one.minutes == pytest.approx(one.steps / one.steps_per_s / 60)
    # (29 x 71) halves.
    assert one.memory_mb - 800 == pytest.approx(90_000 * 4118 / 2**20)


def test_a_copy_is_planned_with_its_gains(tmp_path, capsys, monkeypatch):
    lesson = ImitationConfig(minutes=math.inf, iterations=5, steps=4, batch=32)
    copying = replace(SMOKE, imitation=lesson, amp=None)
    monkeypatch.setitem(TEACHERS, "smoke", copying)
    path = tmp_path / "plan.json"
    learning.train_plan(preset="smoke", seconds=0.05, threads=1, json=path)
    assert "feedback gains" in capsys.readouterr().out
    _, copy, ppo, *_ = json.loads(path.read_text())["phases"]
    assert (copy["phase"], ppo["phase"]) == ("teacher, copy", "teacher, PPO")
    assert copy["steps"] == pytest.approx(5 * 4 * 16)


def test_unknown_preset_lists_all():
    with pytest.raises(InputError, match=r"quickstart.*history-50"):
        learning.train_plan(preset="nope")


def test_durations_in_words():
    assert learning._duration(37.0) == "37.0 minutes"
    assert learning._duration(150.0) == "2.5 hours"
    assert learning._duration(1.559 * 525_600) == "1.6 years"


def test_threads_wait_passively_before_torch_is_loaded():
    code = (
        "import os, sys; from openclone.cli import learning;"
        "assert 'torch' not in sys.modules;"
        "learning.wait_passively();"
        "print(os.environ['OMP_WAIT_POLICY'], os.environ['GOMP_SPINCOUNT'])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=120
    )
    assert done.stdout.split() == ["passive", "0"], done.stderr
