"""Training the student: DAgger from the teacher, then PPO on its own observation."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
from tensordict import TensorDict

from openclone.motion.clip import Clip, clip_hash
from openclone.policy.bundle import g1_info
from openclone.policy.student import GROUP, StudentModel, export_bundle
from openclone.training.checkpoint import load_checkpoint, save_checkpoint
from openclone.training.data import load_reference, make_task, select_clips
from openclone.training.distillation import Dagger, distill
from openclone.training.ppo import build_ppo, learn
from openclone.training.presets import StudentPreset
from openclone.training.progress import Progress
from openclone.training.reference import ReferenceMotions
from openclone.training.student_view import StudentView
from openclone.training.task import StepResult, TaskConfig
from openclone.training.teacher import load_critic, load_teacher

CHECKPOINT = "student.pt"
BUNDLE = "student.onnx"
_CRITIC = "critic"
_SHOWN = (
    "falls/1000", "error_mm", "reward", "gap", "loss/imitation", "loss/balance",
)  # fmt: skip


class StudentEnvironment:
    """The task as the student plays it; the critic also sees the privileged state."""

    def __init__(self, view: StudentView) -> None:
        self.view = view
        self.num_envs = view.task.num_envs

    def observe(self) -> TensorDict:
        """Groups ``student`` and ``critic``."""
        groups = {
            GROUP: self.view.observe(),
            _CRITIC: self.view.task.teacher_observation(),
        }
        return TensorDict(groups, batch_size=[self.num_envs])

    def step(self, action: torch.Tensor) -> StepResult:
        """Joint targets = default pose + scale x action."""
        return self.view.step(action)


class StudentTrainer:
    """Holds what both phases share: data, network, checkpoint, bundle."""

    def __init__(
        self,
        clips: list[Clip],
        preset: StudentPreset,
        out: Path,
        seed: int,
        threads: int | None,
    ) -> None:
        """Build the reference and an untrained student."""
        torch.manual_seed(seed)
        chosen = select_clips(
            clips, preset.categories, preset.mirror, preset.still_seconds
        )
        self.preset, self.out, self.threads, self.seed = preset, out, threads, seed
        self.data_hash = clip_hash(chosen)
        self.reference: ReferenceMotions = load_reference(chosen)
        self.student = StudentModel(preset.moe, preset.ppo.initial_std, preset.history)
        self.steps, self.minutes, self.phase = 0, 0.0, "dagger"
        seconds = self.reference.num_frames / 50
        print(f"{len(chosen)} clips, {seconds / 60:.1f} minutes")

    def view(self, config: TaskConfig) -> StudentView:
        """A fresh task seen through the student's sensors."""
        task = make_task(self.reference, config, self.seed, self.threads)
        rng = np.random.default_rng(self.seed + 1)
        return StudentView(task, self.preset.history, self.preset.noise, rng)

    def save(self, progress: Progress, extra: dict[str, object]) -> None:
        """Write checkpoint and bundle."""
        self.steps, self.minutes = progress.steps, progress.minutes
        content = {
            "student": self.student.state_dict(),
            "phase": self.phase,
            "steps": self.steps,
            "minutes": self.minutes,
            **extra,
        }
        save_checkpoint(self.out / CHECKPOINT, content)
        note = f"{self.phase}, {self.steps} steps, {self.minutes:.0f} minutes"
        info = g1_info("student", self.data_hash, note)
        export_bundle(self.student, info, self.out / BUNDLE)
        self.student.train()

    def resume(self) -> dict[str, object]:
        """Load the checkpoint in ``out``; returns its content."""
        content = load_checkpoint(self.out / CHECKPOINT)
        self.student.load_state_dict(content["student"])
        self.steps, self.minutes = content["steps"], content["minutes"]
        self.phase = content["phase"]
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
    seed: int = 0,
    threads: int | None = None,
) -> Path:
    """Train a student from the teacher checkpoint and return its bundle.

    Args:
        clips: the data set; the preset chooses categories and mirrors.
        teacher: checkpoint of `train_teacher`.
        preset: every setting.
        out: folder for checkpoint, bundle and event files.
        minutes: wall time of DAgger instead of the preset's.
        tuning_minutes: wall time of PPO instead of the preset's; 0 for none.
        resume: go on from the checkpoint in ``out``.
        seed: of all randomness.
        threads: CPU threads; all cores by default.
    """
    trainer = StudentTrainer(clips, preset, out, seed, threads)
    content = trainer.resume() if resume else {}
    dagger_minutes = preset.minutes if minutes is None else minutes
    extra = preset.tuning_minutes if tuning_minutes is None else tuning_minutes
    if trainer.phase == "dagger":
        _dagger_phase(trainer, teacher, dagger_minutes, content)
        content = {}
    if extra > 0:
        if trainer.phase == "dagger":
            trainer.minutes = 0.0
        trainer.phase = "ppo"
        _tuning_phase(trainer, teacher, extra, content)
    return out / BUNDLE


def _dagger_phase(
    trainer: StudentTrainer, teacher: Path, minutes: float, content: dict[str, object]
) -> None:
    preset = trainer.preset
    rng = np.random.default_rng(trainer.seed + 2)
    view = trainer.view(preset.task)
    dagger = Dagger(
        view, load_teacher(teacher), trainer.student, preset.distillation, rng
    )
    if content:
        dagger.optimizer.load_state_dict(content["optimizer"])  # type: ignore[arg-type]
        dagger.rounds = int(content["rounds"])  # type: ignore[call-overload]
    progress = Progress(trainer.out, minutes, trainer.steps, trainer.minutes)

    def save() -> None:
        state = dagger.optimizer.state_dict()
        trainer.save(progress, {"optimizer": state, "rounds": dagger.rounds})

    while not progress.finished:
        distill(dagger, progress)
        if progress.line(30.0, _SHOWN):
            save()
    save()
    progress.close()


def _tuning_phase(
    trainer: StudentTrainer, teacher: Path, minutes: float, content: dict[str, object]
) -> None:
    """PPO on the student; the critic goes on from the teacher's."""
    preset = trainer.preset
    env = StudentEnvironment(trainer.view(preset.tuning_task))
    trainer.student.freeze_routing()
    example = env.observe()
    critic = load_critic(teacher, _CRITIC)
    ppo = build_ppo(example, trainer.student, critic, preset.ppo)
    if "ppo" in content:
        ppo.load(content["ppo"], None, strict=True)  # type: ignore[arg-type]
    progress = Progress(trainer.out, minutes, trainer.steps, trainer.minutes)
    save: Callable[[], None] = lambda: trainer.save(progress, {"ppo": ppo.save()})  # noqa: E731
    learn(env, ppo, preset.ppo, progress, save)
    save()
    progress.close()
