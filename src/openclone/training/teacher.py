"""Training the privileged teacher with PPO (section 3.1)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import torch
from rsl_rl.algorithms import PPO
from rsl_rl.models import MLPModel
from tensordict import TensorDict

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
from openclone.training.guesses import GuessErrors
from openclone.training.hardware import Hardware, keep_memory
from openclone.training.imitation import Imitation, imitate
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
from openclone.training.task import StepResult, TrackingTask
from openclone.training.task_config import TaskConfig

GROUP = "teacher"
CRITIC = "critic"
"""Observation of the critic, where it is not the teacher's."""
CHECKPOINT = "teacher.pt"


class TeacherEnvironment:
    """The task as the teacher plays it: privileged view, residual actions."""

    def __init__(
        self, task: TrackingTask, guess_errors: float = 0.0, seed: int = 0
    ) -> None:
        """Teachers see what students must guess with so large errors."""
        self.task = task
        self.num_envs = task.num_envs
        self._errors: GuessErrors | None = None
        if guess_errors:
            example = task.teacher_observation()
            self._errors = GuessErrors(example, guess_errors, seed)

    def observe(self) -> TensorDict:
        """Group ``teacher``; and ``critic``, if the teacher does not see it all."""
        seen = self.task.teacher_observation()
        groups = {GROUP: self._errors(seen) if self._errors else seen}
        if self.task.config.view != "reference":
            groups[CRITIC] = self.task.reference_observation()
        return TensorDict(groups, batch_size=[self.num_envs])

    def copy(self, sources: torch.Tensor) -> None:
        """Put every robot where robot ``sources (n,)[robot]`` is, with its past."""
        self.task.copy(sources)
        if self._errors is not None:
            self._errors.copy(sources)

    def step(self, action: torch.Tensor) -> StepResult:
        """Joint targets = what the task's guidance gives + scale x action."""
        return self.task.step(self.task.residual_to_target(action))


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
        self.phase, self.trained = "ppo", Trained(steps=self.trained.steps)

    def save(self, path: Path, progress: Progress) -> None:
        """Write everything needed to go on; one process of the team does."""
        self.trained = trained = progress.trained
        if not team().leads:
            return
        content = {
            "ppo": self.ppo.save(),
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
        minutes: total wall time of PPO instead of the preset's, earlier runs included.
        resume: go on from the checkpoint in ``out``, time included.
        start: begin with the networks of this checkpoint, the preset's noise and a
            fresh budget.
        seed: of all randomness.
        threads: CPU threads; all cores by default.
        hardware: back-end of the physics and device; the CPU by default.
    """
    path = Path(out) / CHECKPOINT
    budget = Budget(preset.minutes if minutes is None else minutes, preset.iterations)
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
            trainer.phase, trainer.trained = "ppo", Trained(trainer.trained.steps)
        _run(trainer, trainer.learn, budget, path)
    return path


def _run(
    trainer: TeacherTrainer,
    phase: Callable[[Progress, Path], None],
    budget: Budget,
    path: Path,
) -> None:
    """One phase, and the checkpoint at its end."""
    progress = Progress(path.parent, budget, trainer.trained)
    try:
        phase(progress, path)
        trainer.save(path, progress)
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
