"""Training the privileged teacher with PPO (section 3.1)."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import torch
from rsl_rl.algorithms import PPO
from rsl_rl.models import MLPModel
from tensordict import TensorDict

from openclone.motion.clip import Clip, clip_hash
from openclone.policy.teacher import TEACHER_SIZE
from openclone.robot import g1
from openclone.training.checkpoint import load_checkpoint, save_checkpoint
from openclone.training.data import load_reference, make_task, select_clips
from openclone.training.ppo import PpoConfig, build_ppo, learn, mlp_model
from openclone.training.presets import TeacherPreset
from openclone.training.progress import Progress
from openclone.training.task import StepResult, TrackingTask

GROUP = "teacher"
CHECKPOINT = "teacher.pt"


class TeacherEnvironment:
    """The task as the teacher plays it: privileged view, residual actions."""

    def __init__(self, task: TrackingTask) -> None:
        self.task = task
        self.num_envs = task.num_envs

    def observe(self) -> TensorDict:
        """Observation group ``teacher``."""
        return TensorDict(
            {GROUP: self.task.teacher_observation()}, batch_size=[self.num_envs]
        )

    def step(self, action: torch.Tensor) -> StepResult:
        """Joint targets = reference joint angles + scale x action."""
        return self.task.step(self.task.residual_to_target(action))


def _new_ppo(num_envs: int, config: PpoConfig) -> PPO:
    example = TensorDict(
        {GROUP: torch.zeros(num_envs, TEACHER_SIZE)}, batch_size=[num_envs]
    )
    actor = mlp_model(example, GROUP, g1.NUM_JOINTS, config)
    critic = mlp_model(example, GROUP, 1, config)
    return build_ppo(example, actor, critic, config)


def train_teacher(
    clips: list[Clip],
    preset: TeacherPreset,
    out: Path,
    *,
    minutes: float | None = None,
    resume: bool = False,
    seed: int = 0,
    threads: int | None = None,
) -> Path:
    """Train a teacher and return its checkpoint.

    Args:
        clips: the data set; the preset chooses categories and mirrors.
        preset: every setting.
        out: folder for checkpoint and event files.
        minutes: total wall time instead of the preset's, earlier runs included.
        resume: go on from the checkpoint in ``out``.
        seed: of all randomness.
        threads: CPU threads; all cores by default.
    """
    torch.manual_seed(seed)
    chosen = select_clips(clips, preset.categories, preset.mirror, preset.still_seconds)
    task = make_task(load_reference(chosen), preset.task, seed, threads)
    ppo = _new_ppo(preset.task.num_envs, preset.ppo)
    path = out / CHECKPOINT
    steps, trained = 0, 0.0
    if resume:
        content = load_checkpoint(path)
        ppo.load(content["ppo"], None, strict=True)
        steps, trained = content["steps"], content["minutes"]
        if content["failures"].shape == task.failures.shape:
            task.failures = content["failures"]
    progress = Progress(out, minutes or preset.minutes, steps, trained)

    def save() -> None:
        save_checkpoint(
            path,
            {
                "ppo": ppo.save(),
                "hidden": list(preset.ppo.hidden),
                "steps": progress.steps,
                "minutes": progress.minutes,
                "failures": task.failures,
                "data_hash": clip_hash(chosen),
            },
        )

    print(f"{len(chosen)} clips, {task.reference.num_frames / 50 / 60:.1f} minutes")
    learn(TeacherEnvironment(task), ppo, preset.ppo, progress, save)
    save()
    progress.close()
    return path


def load_teacher(path: Path) -> MLPModel:
    """The actor of a teacher checkpoint, ready for inference."""
    return _load(path, "actor_state_dict", GROUP, g1.NUM_JOINTS).eval()


def load_critic(path: Path, group: str) -> MLPModel:
    """The critic of a teacher checkpoint, reading observation ``group``."""
    return _load(path, "critic_state_dict", group, 1)


def _load(path: Path, part: str, group: str, outputs: int) -> MLPModel:
    content = load_checkpoint(path)
    config = replace(PpoConfig(), hidden=tuple(content["hidden"]))
    example = TensorDict({group: torch.zeros(1, TEACHER_SIZE)}, batch_size=[1])
    model = mlp_model(example, group, outputs, config)
    model.load_state_dict(content["ppo"][part])
    return model
