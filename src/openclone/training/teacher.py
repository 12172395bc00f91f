"""Training the privileged teacher: PPO (section 3.1), then value gradients."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from rsl_rl.algorithms import PPO
from rsl_rl.models import MLPModel
from tensordict import TensorDict
from torch import nn

from openclone.errors import InputError
from openclone.motion.clip import Clip, clip_hash
from openclone.policy.teacher import COMMAND_SIZE, LEGS_SIZE, teacher_size
from openclone.robot import g1
from openclone.training.amp import AmpStyle
from openclone.training.checkpoint import (
    fitting,
    load_checkpoint,
    save_checkpoint,
    trained_so_far,
)
from openclone.training.data import load_reference, make_task
from openclone.training.distributed import joined, team
from openclone.training.hardware import Hardware, keep_memory
from openclone.training.imitation import Imitation, imitate
from openclone.training.pilots import TeacherPilot
from openclone.training.ppo import (
    PpoConfig,
    build_ppo,
    learn,
    mlp_model,
    renew_noise,
    resume_ppo,
)
from openclone.training.presets import TeacherPreset
from openclone.training.progress import Budget, Progress, Trained
from openclone.training.task import TrackingTask
from openclone.training.task_config import TaskConfig
from openclone.training.teacher_view import CRITIC, GROUP, TeacherEnvironment
from openclone.training.value_gradient import SHOWN, Tuner

CHECKPOINT = "teacher.pt"
TUNING = "tuning.pt"
"""What value gradients need to go on; the teacher itself is their average."""


def _new_ppo(task: TrackingTask, config: PpoConfig) -> PPO:
    example = TeacherEnvironment(task).observe()
    actor = mlp_model(example, GROUP, g1.NUM_JOINTS, config)
    critic = mlp_model(example, CRITIC if CRITIC in example else GROUP, 1, config)
    return build_ppo(example, actor, critic, config)


class TeacherTrainer:
    """One run: data, task, networks and what a checkpoint holds."""

    def __init__(
        self,
        clips: list[Clip],
        preset: TeacherPreset,
        seed: int,
        threads: int | None,
        hardware: Hardware | None = None,
    ) -> None:
        """Build task and untrained networks."""
        # Processes that train together begin with the networks of process 0.
        self._seed = seed = team().own_seed(seed)
        self._threads, self._hardware = threads, hardware
        keep_memory()
        torch.manual_seed(seed)
        chosen = preset.select(clips)
        self.preset = preset
        self.data_hash = clip_hash(chosen)
        self.task = make_task(
            load_reference(
                chosen,
                hardware,
                feedback=preset.imitation is not None,
                ground=preset.task.guidance == "feedforward",
            ),
            preset.task,
            seed,
            threads,
            hardware,
        )
        self.ppo = _new_ppo(self.task, preset.ppo)
        self.trained = Trained()
        self.phase = "ppo" if preset.imitation is None else "imitation"
        self.style: AmpStyle | None = None
        if preset.amp is not None:
            self.style = AmpStyle(self.task.reference, preset.amp, seed)
            self.task.style = self.style

    def resume(self, path: Path) -> None:
        """Go on from the checkpoint ``path``."""
        content = load_checkpoint(path)
        _check_view(content, self.preset.task, path)
        with fitting(path):
            resume_ppo(self.ppo, content["ppo"])
            _check_agrees(content, self.preset.task, path)
            if self.style is not None and content.get("amp"):
                self.style.load_state_dict(content["amp"])
            # The failure rates belong to the clips they were counted on.
            starts = self.task.starts
            if content["failures"].shape == starts.failures.shape:
                starts.failures = content["failures"].to(starts.failures)
            self.trained = trained_so_far(content)
            self.phase = content.get("phase", "ppo")

    def begin(self, path: Path) -> None:
        """PPO with the networks of a checkpoint, but with the preset's noise."""
        self.resume(path)
        renew_noise(self.ppo, self.preset.ppo)
        self.enter("ppo")

    def enter(self, phase: str) -> None:
        """Begin ``phase`` with a fresh budget."""
        self.phase, self.trained = phase, Trained(steps=self.trained.steps)

    def save(
        self, path: Path, progress: Progress, network: nn.Module | None = None
    ) -> None:
        """Write everything needed to go on; one process of the team does.

        ``network`` is written instead of the actor's.
        """
        self.trained = trained = progress.trained
        if not team().leads:
            return
        ppo = self.ppo.save()
        for name, value in (network or self.ppo.actor.mlp).state_dict().items():
            ppo["actor_state_dict"][f"mlp.{name}"] = value
        content = {
            "ppo": ppo,
            "hidden": list(self.preset.ppo.hidden),
            "preview": list(self.preset.task.preview),
            "guidance": self.preset.task.guidance,
            "view": self.preset.task.view,
            "phase": self.phase,
            "steps": trained.steps,
            "minutes": trained.minutes,
            "iterations": trained.iterations,
            "failures": self.task.starts.failures,
            "data_hash": self.data_hash,
            "amp": self.style.state_dict() if self.style is not None else {},
        }
        save_checkpoint(path, content)

    def imitate(self, progress: Progress, path: Path) -> None:
        """Copy the feedback, as the preset wants it."""
        config = self.preset.imitation
        assert config is not None
        imitation = Imitation(self.task, self.ppo.actor, GROUP, config, progress)
        imitate(imitation, lambda: self.save(path, progress))
        self.save(path, progress)

    def learn(self, progress: Progress, path: Path) -> None:
        """PPO until the budget is spent, with AMP if the preset wants it."""
        if self.style is not None:
            team().share(self.style.net)
        watchers = (lambda _: self._learn_style(),) if self.style is not None else ()
        learn(
            TeacherEnvironment(self.task, self.preset.guess_errors, self._seed),
            self.ppo,
            self.preset.ppo,
            progress,
            lambda: self.save(path, progress),
            watchers,
        )
        self.save(path, progress)

    def pilot(self) -> TeacherPilot:
        """The teacher in a fresh task, with the settings of value gradients."""
        preset, reference, seed = self.preset, self.task.reference, self._seed
        task = make_task(
            reference, preset.tuning_task, seed, self._threads, self._hardware
        )
        env = TeacherEnvironment(task, preset.guess_errors, seed)
        return TeacherPilot(env, self.ppo.actor)

    def tune(self, progress: Progress, path: Path) -> None:
        """Value gradients until the budget is spent; the average is the teacher."""
        actor, critic, config = self.ppo.actor, self.ppo.critic, self.preset.tuning
        team().share_networks(self.ppo)
        tuner = Tuner(self.pilot(), critic, config, self._seed, progress.folder)
        state = path.with_name(TUNING)
        if progress.iterations:
            content = load_checkpoint(state)
            with fitting(state):
                actor.mlp.load_state_dict(content["newest"])
                tuner.load_state_dict(content["tuner"])

        def save() -> None:
            self.save(path, progress, tuner.average)
            if team().leads:
                newest = actor.mlp.state_dict()
                save_checkpoint(state, {"newest": newest, "tuner": tuner.state_dict()})

        while not team().agree(progress.finished):
            tuner.round(progress)
            if progress.line(30.0, SHOWN):
                save()
        save()

    def _learn_style(self) -> dict[str, float]:
        if self.style is None:
            return {}
        values = self.style.update()
        team().average(parameter.data for parameter in self.style.net.parameters())
        return values


def train_teacher(
    clips: list[Clip],
    preset: TeacherPreset,
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
    """Train a teacher and return its checkpoint.

    Started by torchrun, all its processes train one teacher together.

    Args:
        clips: the data set; the preset chooses categories and mirrors.
        preset: every setting.
        out: folder for checkpoint and event files.
        minutes: total wall time of PPO instead of the preset's, earlier runs included;
            0: none.
        tuning_minutes: wall time of value gradients instead of the preset's; 0: none.
        resume: go on from the checkpoint in ``out``, time included.
        start: begin with the networks of this checkpoint, the preset's noise and a
            fresh budget.
        seed: of all randomness.
        threads: CPU threads; all cores by default.
        hardware: back-end of the physics and device; the CPU by default.
    """
    path = Path(out) / CHECKPOINT
    budget = Budget(preset.minutes if minutes is None else minutes, preset.iterations)
    extra = preset.tuning_minutes if tuning_minutes is None else tuning_minutes
    hardware = hardware or Hardware()
    with joined(hardware.torch_device()) as crew:
        trainer = TeacherTrainer(clips, preset, seed, threads, hardware)
        if resume:
            trainer.resume(path)
        elif start is not None:
            trainer.begin(start)
        if crew.leads:
            print(trainer.task.reference.summary())
        if preset.imitation is not None and trainer.phase == "imitation":
            lesson = Budget(preset.imitation.minutes, preset.imitation.iterations)
            _run(trainer, trainer.imitate, lesson, path)
            trainer.enter("ppo")
        if trainer.phase == "ppo":
            _run(trainer, trainer.learn, budget, path)
        if extra > 0:
            if trainer.phase == "ppo":
                trainer.enter("tuning")
            _run(trainer, trainer.tune, Budget(extra, preset.tuning_iterations), path)
    return path


def _run(
    trainer: TeacherTrainer,
    phase: Callable[[Progress, Path], None],
    budget: Budget,
    path: Path,
) -> None:
    """One phase, which writes the checkpoint at its end."""
    progress = Progress(path.parent, budget, trainer.trained)
    try:
        phase(progress, path)
    finally:
        progress.close()


def load_teacher(path: Path, task: TaskConfig | None = None) -> MLPModel:
    """The actor of a teacher checkpoint, ready for inference.

    Args:
        path: the checkpoint.
        task: where it will look; None: anywhere.

    Raises:
        InputError: not a teacher's checkpoint, or one of another kind of task.
    """
    return _load(path, "actor_state_dict", GROUP, g1.NUM_JOINTS, task).eval()


def load_critic(path: Path, group: str, task: TaskConfig | None = None) -> MLPModel:
    """The critic of a teacher checkpoint, reading observation ``group``."""
    return _load(path, "critic_state_dict", group, 1, task)


def _load(
    path: Path, part: str, group: str, outputs: int, task: TaskConfig | None
) -> MLPModel:
    content = load_checkpoint(path)
    with fitting(path):
        config = replace(PpoConfig(), hidden=tuple(content["hidden"]))
        size = teacher_size(len(content["preview"]))
        if group == GROUP and _view(content) != "reference":
            size = COMMAND_SIZE + (_view(content) == "legs") * LEGS_SIZE
        example = TensorDict({group: torch.zeros(1, size)}, batch_size=[1])
        model = mlp_model(example, group, outputs, config)
        model.load_state_dict(content["ppo"][part])
    if task is not None:
        _check_agrees(content, task, path)
    return model


def _view(content: dict[str, Any]) -> str:
    """What the teacher of a checkpoint sees; early ones all saw the reference."""
    return content.get("view", "reference")


def _check_view(content: dict[str, Any], task: TaskConfig, path: Path) -> None:
    """Refuse a teacher that saw more or less of the motion than in ``task``."""
    if _view(content) != task.view:
        raise InputError(
            f"the teacher's view is {_view(content)!r}, the task's {task.view!r}",
            where=str(path),
            remedy="give a teacher trained with the same `view`",
        )


def _check_agrees(content: dict[str, Any], task: TaskConfig, path: Path) -> None:
    """Refuse a teacher that saw or did something else than it would in ``task``."""
    _check_view(content, task, path)
    moments = tuple(content["preview"])
    if moments != task.preview:
        raise InputError(
            f"the teacher previews steps {moments}, the task {task.preview}",
            where=str(path),
            remedy="give a teacher trained with the same `preview` as the student's",
        )
    if content["guidance"] != task.guidance:
        raise InputError(
            f"the teacher's guidance is {content['guidance']!r}, "
            f"the task's {task.guidance!r}",
            where=str(path),
            remedy="give a teacher trained with the same `guidance`",
        )
