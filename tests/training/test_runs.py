"""Whole training runs, seconds long."""

import copy
import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import torch
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator
from tensordict import TensorDict
from torch import nn

from openclone.cli import learning
from openclone.errors import InputError
from openclone.policy.bundle import g1_info, load_bundle
from openclone.policy.mlp import MlpConfig
from openclone.training import student as student_module
from openclone.training.checkpoint import load_checkpoint
from openclone.training.distillation import Dagger
from openclone.training.guard import TrainingStopped
from openclone.training.ppo import PpoConfig, build_ppo, mlp_model, settle
from openclone.training.presets import (
    STUDENTS,
    TEACHERS,
    DistillationConfig,
    teacher_preset,
)
from openclone.training.student import train_student
from openclone.training.teacher import load_teacher, train_teacher
from openclone.training.teacher_view import TeacherEnvironment

TEACHER, STUDENT = TEACHERS["smoke"], STUDENTS["smoke"]
STEPS = 3 * 4 * 16  # iterations, steps, robots of the smoke presets


@pytest.fixture
def no_export(monkeypatch):
    """Writing ONNX takes longer than all the rest; one test of the module does it."""
    monkeypatch.setattr(student_module, "export_bundle", lambda *_: None)


def scalars(folder):
    """All logged values, by name."""
    found = {}
    for path in sorted(folder.glob("events.out.tfevents.*")):
        events = EventAccumulator(str(path))
        events.Reload()
        for tag in events.Tags()["scalars"]:
            found[tag] = [event.value for event in events.Scalars(tag)]
    return found


def test_the_bundle_runs_and_says_what_it_is(trained, make_clip, tmp_path):
    (tmp_path / "student.pt").write_bytes(trained[2].read_bytes())
    # Nothing is left to train, but the bundle is written.
    path = train_student(
        [make_clip()], trained[1], STUDENT, tmp_path, resume=True, threads=1
    )
    bundle = load_bundle(path)
    assert bundle.act(np.zeros((2, 2388))).shape == (2, 29)
    # One roll-out more, the warm-up.
    assert f"tuning, {2 * STEPS + 64} steps" in bundle.info.training
    assert len(bundle.info.data_hash) == 64


def test_the_teacher_checkpoint_is_an_actor(trained):
    actor = load_teacher(trained[1])
    assert not actor.training
    assert sum(p.numel() for p in actor.parameters()) > 1000


def test_tensorboard_has_terms_success_routers_and_amp(trained):
    values = scalars(trained[0])
    names = set(values)
    assert {"reward/vr_position", "reward/slippage", "reward/amp"} <= names
    assert {"success/stand", "falls/1000", "loss/imitation", "loss/value"} <= names
    assert {"amp/loss", "amp/accuracy_real"} <= names
    for layer in (1, 2, 3):
        usage = [values[f"router/layer{layer}/expert{k}"][-1] for k in (1, 2, 3, 4)]
        assert sum(usage) == pytest.approx(1.0, abs=1e-4)
    assert all(0 <= value <= 1 for value in values["success/stand"])


# Resuming ----------------------------------------------------------------------------


def test_teacher_goes_on_from_its_checkpoint(trained, make_clip, tmp_path):
    before = load_checkpoint(trained[1])
    assert (before["iterations"], before["steps"]) == (3, STEPS)
    copy = tmp_path / "teacher.pt"
    copy.write_bytes(trained[1].read_bytes())
    longer = replace(TEACHER, iterations=5)
    train_teacher([make_clip()], longer, tmp_path, resume=True, threads=1)
    after = load_checkpoint(copy)
    assert (after["iterations"], after["steps"]) == (5, STEPS * 5 // 3)
    assert after["minutes"] > before["minutes"]
    # The optimizers, of PPO and of AMP, went on as well.
    for content, count in ((before, 3), (after, 5)):
        assert content["ppo"]["optimizer_state_dict"]["state"][0]["step"] == count
        assert content["amp"]["optimizer"]["state"][0]["step"] == count


def test_resuming_a_finished_run_changes_nothing(trained, make_clip, tmp_path):
    copy = tmp_path / "teacher.pt"
    copy.write_bytes(trained[1].read_bytes())
    train_teacher([make_clip()], TEACHER, tmp_path, resume=True, threads=1)
    before, after = load_checkpoint(trained[1]), load_checkpoint(copy)
    for part in ("actor_state_dict", "critic_state_dict"):
        for name, value in before["ppo"][part].items():
            assert torch.equal(value, after["ppo"][part][name])


def test_start_takes_the_networks_but_a_fresh_budget(trained, make_clip, tmp_path):
    path = train_teacher(
        [make_clip()], TEACHER, tmp_path, start=trained[1], seed=1, threads=1
    )
    content = load_checkpoint(path)
    assert (content["iterations"], content["steps"]) == (3, 2 * STEPS)
    assert content["ppo"]["optimizer_state_dict"]["state"][0]["step"] == 6


def test_start_explores_as_the_preset_says(trained, make_clip, tmp_path):
    quiet = replace(TEACHER, ppo=replace(TEACHER.ppo, initial_std=0.01), iterations=0)
    path = train_teacher([make_clip()], quiet, tmp_path, start=trained[1], threads=1)
    std = load_checkpoint(path)["ppo"]["actor_state_dict"]["distribution.log_std_param"]
    torch.testing.assert_close(std.exp(), torch.full((29,), 0.01))


def test_a_student_starts_from_a_bundle(trained, make_clip, tmp_path, monkeypatch):
    bundle = tmp_path / "given.onnx"
    model = student_module.StudentModel(STUDENT.network, STUDENT.history)
    student_module.export_bundle(model, g1_info("s", "", "", STUDENT.history), bundle)
    monkeypatch.setattr(student_module, "export_bundle", lambda *_: None)
    still = replace(STUDENT, iterations=0, tuning_minutes=0.0)
    train_student([make_clip()], trained[1], still, tmp_path, start=bundle, threads=1)
    content = load_checkpoint(tmp_path / "student.pt")
    assert (content["steps"], content["phase"]) == (0, "dagger")
    for name, value in model.mlp.state_dict().items():
        torch.testing.assert_close(content["student"]["mlp." + name], value)
    other = replace(still, history=5)
    with pytest.raises(InputError, match="does not fit the preset's networks"):
        train_student(
            [make_clip()], trained[1], other, tmp_path, start=bundle, threads=1
        )


def test_the_average_of_the_weights_is_worked_out_step_by_step():
    dagger = Dagger.__new__(Dagger)
    network = nn.Linear(1, 1, bias=False)
    nn.init.ones_(network.weight)
    dagger.student = SimpleNamespace(mlp=network)
    dagger.average = nn.Linear(1, 1, bias=False)
    nn.init.zeros_(dagger.average.weight)
    dagger.config = DistillationConfig(average=0.2)
    dagger.averaged_steps = 0
    # Old weights count 2/11 in the first step, then 0.2.
    for expected in (9 / 11, 1 - 0.2 * 2 / 11, 1 - 0.04 * 2 / 11):
        dagger._average()
        assert dagger.average.weight.item() == pytest.approx(expected, abs=1e-6)


def test_the_bundle_holds_the_average(trained, make_clip, tmp_path, monkeypatch):
    exported = []
    monkeypatch.setattr(
        student_module,
        "export_bundle",
        lambda student, *_: exported.append(copy.deepcopy(student.mlp.state_dict())),
    )
    train_student(
        [make_clip()], trained[1], STUDENT, tmp_path, tuning_minutes=0, threads=1
    )
    content = load_checkpoint(tmp_path / "student.pt")
    newest = content["student"]["mlp.head.weight"]
    assert torch.equal(exported[-1]["head.weight"], content["average"]["head.weight"])
    assert not torch.equal(exported[-1]["head.weight"], newest)


def test_student_goes_on_in_either_phase(trained, make_clip, tmp_path, no_export):
    teacher, clips = trained[1], [make_clip()]

    def go_on(**settings):
        preset = replace(STUDENT, **settings)
        resume = (tmp_path / "student.pt").exists()
        train_student(clips, teacher, preset, tmp_path, resume=resume, threads=1)
        content = load_checkpoint(tmp_path / "student.pt")
        return content["phase"], content["iterations"], content["steps"], content

    phase, iterations, steps, content = go_on(iterations=2, tuning_minutes=0.0)
    assert (phase, iterations, steps, content["rounds"]) == ("dagger", 2, 128, 2)
    phase, iterations, steps, content = go_on(iterations=3, tuning_minutes=0.0)
    assert (phase, iterations, steps, content["rounds"]) == ("dagger", 3, 192, 3)
    # Two gradient steps a round.
    assert content["optimizer"]["state"][0]["step"] == 6
    phase, iterations, steps, _ = go_on(iterations=3, tuning_iterations=1)
    # One roll-out more, from which the world model alone learns.
    assert (phase, iterations, steps) == ("tuning", 1, 320)
    phase, iterations, steps, content = go_on(iterations=3, tuning_iterations=3)
    assert (phase, iterations, steps) == ("tuning", 3, 512)
    # Two steps in the warm-up of each run, one after every other roll-out.
    assert content["tuner"]["world"]["optimizer"]["state"][0]["step"] == 7


# Seeds and faults --------------------------------------------------------------------


def test_same_seed_same_losses(trained, make_clip, tmp_path, no_export):
    clips, runs = [make_clip()], []
    for name, seed in (("a", 3), ("b", 3), ("c", 4)):
        out = tmp_path / name
        teacher = train_teacher(clips, TEACHER, out / "t", seed=seed, threads=1)
        train_student(clips, teacher, STUDENT, out / "s", seed=seed, threads=1)
        runs.append({**scalars(out / "t"), **scalars(out / "s")})
    names = [n for n in runs[0] if n.partition("/")[0] in ("loss", "reward", "amp")]
    assert len(names) > 15
    for name in names:
        assert runs[0][name] == runs[1][name], name
    assert runs[0]["loss/imitation"] != runs[2]["loss/imitation"]


def test_training_stops_at_a_nan_and_leaves_the_evidence(
    trained, make_clip, tmp_path, monkeypatch
):
    healthy = TeacherEnvironment.step
    count = 0

    def poisoned(self, action):
        nonlocal count
        count += 1
        result = healthy(self, action)
        if count == 6:  # in the second iteration
            result.reward[2] = float("nan")
        return result

    monkeypatch.setattr(TeacherEnvironment, "step", poisoned)
    with pytest.raises(TrainingStopped, match=r"nan-dump\.npz") as error:
        train_teacher([make_clip()], TEACHER, tmp_path, threads=1)
    assert "\n" not in str(error.value)
    assert "after 128 steps" in str(error.value)
    with np.load(tmp_path / "nan-dump.npz", allow_pickle=False) as dump:
        rewards = dump["batch/rewards"]
        assert list(zip(*np.nonzero(np.isnan(rewards[..., 0])), strict=True)) == [
            (1, 2)
        ]
        assert dump["robots/qpos"].shape == (16, 36)
        assert dump["batch/observations/teacher"].shape[:2] == (4, 16)
        assert any(name.startswith("network/actor/") for name in dump)
    # No checkpoint of a broken network.
    assert not (tmp_path / "teacher.pt").exists()


def test_distillation_stops_at_a_nan(trained, make_clip, tmp_path, no_export):
    content = load_checkpoint(trained[1])
    for value in content["ppo"]["actor_state_dict"].values():
        if value.is_floating_point():
            value.fill_(float("nan"))
    broken = tmp_path / "broken.pt"
    torch.save(content, broken)
    with pytest.raises(TrainingStopped, match="observation is not finite"):
        train_student([make_clip()], broken, STUDENT, tmp_path, threads=1)
    assert (tmp_path / "nan-dump.npz").is_file()
    assert not (tmp_path / "student.pt").exists()


# Schedules and kept bundles ----------------------------------------------------------


def test_noise_and_updates_shrink_over_a_run(trained):
    config = PpoConfig(
        kl=0.04, final_kl=0.01, initial_std=0.4, final_std=0.1, hidden=(8,)
    )
    example = TensorDict({"x": torch.zeros(2, 3)}, batch_size=[2])
    actor, critic = (mlp_model(example, "x", count, config) for count in (29, 1))
    ppo = build_ppo(example, actor, critic, config)

    def settled(share):
        settle(ppo, config, share)
        ppo.act(example)
        return ppo.desired_kl, actor.output_std.max().item()

    assert settled(0.0) == pytest.approx((0.04, 0.4))
    assert settled(0.52) == pytest.approx((0.02, 0.2))  # in steps of a twentieth
    # Noise that was learned to be smaller stays so.
    with torch.no_grad():
        actor.distribution.log_std_param.fill_(math.log(0.15))
    assert settled(0.52) == pytest.approx((0.02, 0.15))
    assert settled(1.0) == pytest.approx((0.01, 0.1))


def test_bundles_are_kept_at_growing_distances(make_clip, tmp_path):
    trainer = student_module.StudentTrainer([make_clip()], STUDENT, tmp_path, 0, 1)
    (tmp_path / "student.onnx").write_bytes(b"bundle")
    for half_minutes in range(1, 240):
        trainer._keep(half_minutes / 2)
    kept = {path.stem.partition("_")[2] for path in (tmp_path / "bundles").iterdir()}
    assert {"2.0", "4.0", "36.0"} <= kept
    assert {"3.0", "119.0"}.isdisjoint(kept)
    assert 30 < len(kept) < 45
    trainer.phase = "ppo"
    trainer._keep(2.0)
    assert (tmp_path / "bundles" / "student_ppo_2.0.onnx").read_bytes() == b"bundle"


# Presets -----------------------------------------------------------------------------

ABLATIONS = {
    "mlp": None,
    "other-data": (3, 4, 25),
    "history-5": (3, 4, 5),
    "history-50": (3, 4, 50),
    "layers-1": (1, 4, 25),
    "experts-8": (3, 8, 25),
}


@pytest.mark.parametrize("name", ABLATIONS)
def test_ablations_train(name, trained, make_clip, tmp_path, no_export):
    preset = STUDENTS[name]
    if isinstance(preset.network, MlpConfig):
        network = MlpConfig((16, 8))
    else:
        network = replace(preset.network, width=16)
    small = replace(STUDENT, data=preset.data, history=preset.history, network=network)
    train_student([make_clip()], trained[1], small, tmp_path, threads=1)
    state = load_checkpoint(tmp_path / "student.pt")["student"]
    shape = ABLATIONS[name]
    if shape is None:
        assert [v.shape[0] for k, v in state.items() if "mlp" in k and v.ndim == 2] == [
            16, 8, 29,
        ]  # fmt: skip
        return
    layers, experts, history = shape
    routers = [v for k, v in state.items() if k.endswith("router.weight")]
    assert [v.shape[0] for v in routers] == [experts] * layers
    assert state["mlp.stem.weight"].shape[1] == 63 + 93 * history


def test_other_data_is_recordings_as_they_were(make_clip):
    clips = [make_clip("real/walk"), make_clip("real/walk~mirror")]
    made = make_clip("synthetic/walk")
    clips.append(
        replace(made, info=replace(made.info, source="openclone synthetic generator"))
    )
    chosen = STUDENTS["other-data"].select(clips)
    assert [clip.info.name for clip in chosen] == ["real/walk"]
    with pytest.raises(InputError, match="recordings alone"):
        STUDENTS["other-data"].select(clips[1:])
    assert len(STUDENTS["fast"].select(clips)) == 6


def test_one_command_trains_teacher_and_student(
    make_clip, tmp_path, monkeypatch, no_export, capsys
):
    monkeypatch.setattr(learning, "_training_clips", lambda _: [make_clip()])
    learning.train_student(preset="smoke", out=tmp_path, threads=1)
    teacher = load_checkpoint(tmp_path / "teacher" / "teacher.pt")
    assert teacher["iterations"] == 3
    assert load_checkpoint(tmp_path / "student.pt")["phase"] == "tuning"
    assert "first the teacher" in capsys.readouterr().out
    # Interrupted before the student began: go on with it.
    (tmp_path / "student.pt").unlink()
    learning.train_student(preset="smoke", out=tmp_path, resume=True, threads=1)
    assert load_checkpoint(tmp_path / "student.pt")["phase"] == "tuning"


def test_quickstart_takes_less_than_forty_minutes_by_its_settings():
    student = STUDENTS["quickstart"]
    teacher = TEACHERS[student.teacher]
    assert teacher.minutes + student.minutes + student.tuning_minutes <= 37
    assert teacher.data.categories == student.data.categories


def test_unknown_names_list_the_known_ones(make_clip):
    with pytest.raises(InputError, match="smoke"):
        teacher_preset("nope")
    still = replace(TEACHER, data=replace(TEACHER.data, categories=("stand",)))
    with pytest.raises(InputError, match="categories"):
        train_teacher([make_clip(category="jump")], still, "unused", threads=1)
    with pytest.raises(InputError, match="dance"):
        learning.train_teacher(categories="dance")
