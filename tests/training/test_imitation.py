"""The copy of linear feedback, before PPO."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from tensordict import TensorDict

from openclone.training.checkpoint import load_checkpoint, save_checkpoint
from openclone.training.feedback import corrections, deviation
from openclone.training.guard import TrainingStopped
from openclone.training.imitation import Imitation, ImitationConfig, imitate
from openclone.training.ppo import PpoConfig, mlp_model
from openclone.training.presets import TEACHERS
from openclone.training.progress import Budget, Progress
from openclone.training.reference import build_reference
from openclone.training.teacher import train_teacher
from openclone.training.teacher_view import GROUP

KIND = {"view": "legs", "guidance": "arms"}
LESSON = ImitationConfig(
    minutes=math.inf, iterations=30, steps=8, batch=256, led_rounds=10, kept_rounds=20
)
SMOKE = TEACHERS["smoke"]


@pytest.fixture(autouse=True)
def own_cache(monkeypatch, tmp_path):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))


def learner(task):
    torch.manual_seed(0)
    seen = TensorDict({GROUP: task.teacher_observation()}, batch_size=[task.num_envs])
    return mlp_model(seen, GROUP, 29, PpoConfig(hidden=(64, 64)))


def gap(task, actor) -> float:
    """Mean distance of the actor from feedback, in actions, on the robots' states."""
    seen = TensorDict({GROUP: task.teacher_observation()}, batch_size=[task.num_envs])
    with torch.no_grad():
        return float((actor.eval()(seen) - task.feedback_action()).abs().mean())


@pytest.mark.parametrize("guidance", ["pose", "arms", "feedforward"])
def test_the_label_gives_the_targets_of_feedback(make_task, guidance):
    task = make_task(8, guidance=guidance)
    targets = task.residual_to_target(task.feedback_action())
    reference = task.reference
    wanted = task.next_reference().joint_angles
    wanted = wanted + reference.feedforward[task.next_frame()]
    away = deviation(task.robot_state(), reference.at(task.frame))
    added = corrections(reference.feedback[task.frame], away)
    assert float(added.abs().max()) > 0.01
    torch.testing.assert_close(targets, wanted + added, atol=1e-5, rtol=1e-4)


def test_labels_of_robots_far_away_are_bounded(make_task):
    task = make_task(4, guidance="pose")
    task.action_scale = task.action_scale * 1e-3
    assert float(task.feedback_action().abs().max()) == pytest.approx(6.0)


def test_the_learner_comes_near_feedback(make_task, tmp_path):
    task = make_task(16, **KIND)
    actor, lines = learner(task), []
    before = gap(task, actor)
    progress = Progress(tmp_path, Budget(math.inf, 30))
    imitation = Imitation(task, actor, GROUP, LESSON, progress)
    imitate(imitation, lambda: lines.append(1), 0.0)
    assert gap(task, actor) < 0.4 * before
    assert progress.steps == 30 * 8 * 16
    assert len(lines) == 30


def test_the_learner_takes_over(make_task, tmp_path, monkeypatch):
    """In the first round feedback acts, after `led_rounds` of them the learner does."""
    task = make_task(8, **KIND)
    config = replace(LESSON, noise=0.0, led_rounds=1)
    progress = Progress(tmp_path, Budget(math.inf, 2))
    imitation = Imitation(task, learner(task), GROUP, config, progress)
    taken = []
    step = task.step

    def watched(targets):
        taken.append((task.feedback_action(), task.base_targets(), targets))
        return step(targets)

    monkeypatch.setattr(task, "step", watched)
    imitation.collect()
    for label, base, targets in taken:
        torch.testing.assert_close(targets, base + task.action_scale * label)
    taken.clear()
    imitation.collect()
    label, base, targets = taken[0]
    assert float((targets - base - task.action_scale * label).abs().max()) > 0.01


def test_a_number_that_is_not_finite_stops_it(make_task, tmp_path):
    task = make_task(4, **KIND)
    progress = Progress(tmp_path, Budget(math.inf, 2))
    imitation = Imitation(task, learner(task), GROUP, LESSON, progress)
    imitation.collect()
    imitation._labels[:] = math.nan
    with pytest.raises(TrainingStopped, match="loss/imitation"):
        imitation.update()
    with np.load(tmp_path / "nan-dump.npz") as dump:
        assert {"batch/seen", "batch/labels", "robots/qpos"} <= set(dump)


def test_without_gains_it_says_so(model, make_clip, make_task):
    task = make_task(2, reference=build_reference([make_clip()], model), **KIND)
    with pytest.raises(ValueError, match="feedback gains"):
        task.feedback_action()


def test_a_run_copies_then_learns_and_resumes_where_it_was(make_clip, tmp_path):
    lesson = replace(LESSON, iterations=2, steps=4, batch=32)
    preset = replace(
        SMOKE, imitation=lesson, amp=None, task=replace(SMOKE.task, **KIND)
    )
    out, clips = tmp_path / "run", [make_clip()]
    path = train_teacher(clips, preset, out, threads=1)
    done = load_checkpoint(path)
    assert (done["phase"], done["iterations"]) == ("ppo", 3)
    assert done["steps"] == (2 * 4 + 3 * 4) * 16
    # As if it had been interrupted within the copy, after one round of it.
    halfway = {**done, "phase": "imitation", "iterations": 1, "steps": 64}
    save_checkpoint(path, halfway)
    again = load_checkpoint(train_teacher(clips, preset, out, resume=True, threads=1))
    assert (again["phase"], again["iterations"]) == ("ppo", 3)
    assert again["steps"] == 64 + (4 + 3 * 4) * 16
    # Networks from elsewhere need no copy.
    other = train_teacher(clips, preset, tmp_path / "on", start=path, threads=1)
    assert load_checkpoint(other)["steps"] == again["steps"] + 3 * 4 * 16
