"""Training the student: DAgger from the teacher, then value gradients."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import nn

from openclone.motion.clip import Clip, clip_hash
from openclone.policy.bundle import g1_info
from openclone.policy.student import StudentModel, export_bundle, import_bundle
from openclone.training.checkpoint import (
    fitting,
    load_checkpoint,
    save_checkpoint,
    trained_so_far,
)
from openclone.training.data import load_reference, make_task
from openclone.training.distillation import Dagger, distill
from openclone.training.distributed import joined, team
from openclone.training.hardware import Hardware, keep_memory
from openclone.training.pilots import StudentPilot
from openclone.training.presets import StudentPreset
from openclone.training.progress import Budget, Progress, Trained
from openclone.training.reference import ReferenceMotions
from openclone.training.student_view import StudentView
from openclone.training.task_config import TaskConfig
from openclone.training.teacher import load_critic, load_teacher
from openclone.training.teacher_view import CRITIC
from openclone.training.value_gradient import SHOWN, Tuner

CHECKPOINT = "student.pt"
BUNDLE = "student.onnx"
KEPT = "bundles"
_KEPT_MINUTES = 1.9
"""Minutes between kept bundles; a little less than two, as lines come in steps."""
_SHOWN = (
    "falls/1000", "error_mm", "reward", "gap", "loss/imitation", "loss/balance",
)  # fmt: skip


class StudentTrainer:
    """Holds what both phases share: data, network, checkpoint, bundle."""

    def __init__(
        self,
        clips: list[Clip],
        preset: StudentPreset,
        out: Path,
        seed: int,
        threads: int | None,
        hardware: Hardware | None = None,
    ) -> None:
        """Build the reference and an untrained student."""
        keep_memory()
        torch.manual_seed(seed)
        chosen = preset.select(clips)
        self.preset, self.out = preset, out
        self.seed = team().own_seed(seed)
        self.threads, self.hardware = threads, hardware or Hardware()
        self.data_hash = clip_hash(chosen)
        guidances = (preset.task.guidance, preset.tuning_task.guidance)
        self.reference: ReferenceMotions = load_reference(
            chosen, self.hardware, ground="feedforward" in guidances
        )
        self.student = StudentModel(preset.network, preset.history).to(
            self.reference.device
        )
        self.trained, self.phase = Trained(), "dagger"
        self._kept_at = 0.0

    def view(self, config: TaskConfig) -> StudentView:
        """A fresh task seen through the student's sensors."""
        task = make_task(self.reference, config, self.seed, self.threads, self.hardware)
        rng = np.random.default_rng(self.seed + 1)
        preset = self.preset
        return StudentView(task, preset.history, preset.noise, rng, preset.faults)

    def save(
        self,
        progress: Progress,
        extra: dict[str, object],
        exported: nn.Module | None = None,
    ) -> None:
        """Write checkpoint and bundle; ``exported`` goes into the bundle instead.

        One process of the team does.
        """
        self.trained = trained = progress.trained
        if not team().leads:
            return
        content = {
            "student": self.student.state_dict(),
            "phase": self.phase,
            "steps": trained.steps,
            "minutes": trained.minutes,
            "iterations": trained.iterations,
            **extra,
        }
        save_checkpoint(self.out / CHECKPOINT, content)
        note = f"{self.phase}, {trained.steps} steps, {trained.minutes:.0f} minutes"
        info = g1_info("student", self.data_hash, note, self.preset.history)
        newest = self.student.mlp
        try:
            self.student.mlp = exported or newest
            export_bundle(self.student, info, self.out / BUNDLE)
        finally:
            self.student.mlp = newest
        self.student.train()
        self._keep(trained.minutes)

    def _keep(self, minutes: float) -> None:
        """Keep a copy of the bundle now and then, to see how the student learned.

        The distances grow with the run, so that a long one leaves about as many.
        """
        if minutes < self._kept_at:  # a new phase
            self._kept_at = 0.0
        written = (self.out / BUNDLE).is_file()
        if written and minutes - self._kept_at >= max(_KEPT_MINUTES, minutes / 20):
            self._kept_at = minutes
            name = "student" if self.phase == "dagger" else f"student_{self.phase}"
            (self.out / KEPT).mkdir(exist_ok=True)
            copy = self.out / KEPT / f"{name}_{minutes:.1f}.onnx"
            shutil.copyfile(self.out / BUNDLE, copy)

    def resume(self, path: Path) -> dict[str, Any]:
        """Load the checkpoint ``path``; returns its content."""
        content = load_checkpoint(path)
        with fitting(path):
            self.student.load_state_dict(content["student"])
            self.trained = trained_so_far(content)
            self.phase = content["phase"]
        return content

    def begin(self, path: Path) -> dict[str, Any]:
        """Start with the student of a checkpoint or bundle, with a fresh budget.

        Returns:
            the checkpoint's content; nothing for a bundle.
        """
        if path.suffix == Path(BUNDLE).suffix:
            with fitting(path):
                import_bundle(self.student, path)
            return {}
        content = self.resume(path)
        self.trained = Trained(steps=self.trained.steps)
        return content


def train_student(
    clips: list[Clip],
    teacher: Path,
    preset: StudentPreset,
    out: Path,
    *,
    minutes: float | None = None,
    tuning_minutes: float | None = None,
    resume: bool = False,
    start: Path | None = None,
    seed: int = 0,
    threads: int | None = None,
    hardware: Hardware | None = None,
) -> Path:
    """Train a student from the teacher checkpoint and return its bundle.

    Started by torchrun, all its processes train one student together.

    Args:
        clips: the data set; the preset chooses categories and mirrors.
        teacher: checkpoint of `train_teacher`.
        preset: every setting.
        out: folder for checkpoint, bundle, event files and, in ``bundles``, earlier
            bundles by minutes.
        minutes: wall time of DAgger instead of the preset's.
        tuning_minutes: wall time of value gradients instead of the preset's; 0: none.
        resume: go on from the checkpoint in ``out``, time included.
        start: begin with the student of this checkpoint, in its phase, or of this
            bundle, with a fresh budget.
        seed: of all randomness.
        threads: CPU threads; all cores by default.
        hardware: back-end of the physics and device; the CPU by default.
    """
    out = Path(out)
    dagger_minutes = preset.minutes if minutes is None else minutes
    extra = preset.tuning_minutes if tuning_minutes is None else tuning_minutes
    device = (hardware or Hardware()).torch_device()
    with joined(device) as crew:
        trainer = StudentTrainer(clips, preset, out, seed, threads, hardware)
        if crew.leads:
            print(trainer.reference.summary())
        content: dict[str, Any] = {}
        if resume:
            content = trainer.resume(out / CHECKPOINT)
        elif start is not None:
            content = trainer.begin(start)
        if trainer.phase == "dagger":
            _dagger_phase(trainer, teacher, dagger_minutes, content)
            content = {}
        if extra > 0:
            if trainer.phase == "dagger":
                trainer.trained = Trained(steps=trainer.trained.steps)
            trainer.phase = "tuning"
            _tuning_phase(trainer, teacher, extra, content)
    return out / BUNDLE


def _dagger_phase(
    trainer: StudentTrainer, teacher: Path, minutes: float, content: dict[str, Any]
) -> None:
    preset = trainer.preset
    rng = np.random.default_rng(trainer.seed + 2)
    team().share(trainer.student)
    dagger = Dagger(
        trainer.view(preset.task),
        load_teacher(teacher, preset.task).to(trainer.reference.device),
        trainer.student,
        preset.distillation,
        rng,
        trainer.out,
    )
    if content:
        newest = trainer.student.mlp.state_dict()
        dagger.optimizer.load_state_dict(content["optimizer"])
        dagger.rounds = int(content["rounds"])
        dagger.average.load_state_dict(content.get("average", newest))
        dagger.averaged_steps = int(content.get("averaged_steps", 0))
    budget = Budget(minutes, preset.iterations)
    progress = Progress(trainer.out, budget, trainer.trained)

    def save() -> None:
        state = {
            "optimizer": dagger.optimizer.state_dict(),
            "rounds": dagger.rounds,
            "average": dagger.average.state_dict(),
            "averaged_steps": dagger.averaged_steps,
        }
        trainer.save(progress, state, dagger.average)

    try:
        while not team().agree(progress.finished):
            distill(dagger, progress)
            if progress.line(30.0, _SHOWN):
                save()
        save()
    finally:
        progress.close()


def _tuning_phase(
    trainer: StudentTrainer, teacher: Path, minutes: float, content: dict[str, Any]
) -> None:
    """Value gradients; the critic goes on from the teacher's."""
    preset = trainer.preset
    team().share(trainer.student)
    tuner = Tuner(
        StudentPilot(trainer.view(preset.tuning_task), trainer.student),
        load_critic(teacher, CRITIC, preset.tuning_task).to(trainer.reference.device),
        preset.tuning,
        trainer.seed,
        trainer.out,
    )
    if "tuner" in content:
        tuner.load_state_dict(content["tuner"])
    budget = Budget(minutes, preset.tuning_iterations)
    progress = Progress(trainer.out, budget, trainer.trained)

    def save() -> None:
        trainer.save(progress, {"tuner": tuner.state_dict()}, tuner.average)

    try:
        while not team().agree(progress.finished):
            tuner.round(progress)
            if progress.line(30.0, SHOWN):
                save()
        save()
    finally:
        progress.close()
