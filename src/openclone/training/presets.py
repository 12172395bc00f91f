"""Presets: every number of a training run in one frozen dataclass."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TypeVar

from openclone.errors import InputError
from openclone.odometry.noise import OdometryNoiseConfig
from openclone.policy.moe import MoeConfig
from openclone.training.ppo import PpoConfig
from openclone.training.task import TaskConfig, TerminationLimits

LOCOMOTION = (
    "stand", "forward", "backward", "stepside", "turn", "wave", "reach", "squat",
    "transition",
)  # fmt: skip


@dataclass(frozen=True)
class TeacherPreset:
    """Settings of one teacher run.

    Attributes:
        minutes: wall time.
        categories: motion categories to train on; None for all.
        mirror: also train on every clip with left and right swapped.
        still_seconds: hold clips that end at rest for this long.
        task, ppo: see there.
    """

    minutes: float = 60.0
    categories: tuple[str, ...] | None = LOCOMOTION
    mirror: bool = True
    still_seconds: float = 2.0
    task: TaskConfig = field(default_factory=TaskConfig)
    ppo: PpoConfig = field(
        default_factory=lambda: PpoConfig(minibatches=4, entropy=0.0)
    )


@dataclass(frozen=True)
class DistillationConfig:
    """DAgger settings.

    Attributes:
        steps: control steps per robot and round.
        kept_rounds: rounds whose data stay in the buffer.
        updates, batch: gradient steps a round, samples a step.
        learning_rate: Adam's at the start; falls to a fifth at the end.
        teacher_share_rounds: rounds over which control passes from teacher to student.
        balance: weight of Eq. 1.
        max_grad_norm: gradient clipping (OmniH2O: 0.2).
    """

    steps: int = 20
    kept_rounds: int = 8
    updates: int = 12
    batch: int = 1024
    learning_rate: float = 6e-4
    teacher_share_rounds: int = 60
    balance: float = 0.05
    max_grad_norm: float = 0.5


@dataclass(frozen=True)
class StudentPreset:
    """Settings of one student run: DAgger, then PPO on the student itself.

    Attributes:
        minutes: wall time of DAgger.
        tuning_minutes: wall time of PPO afterwards.
        categories, mirror, still_seconds: as in `TeacherPreset`.
        history: frames of history H.
        moe: network shape.
        noise: Eq. 2.
        task: settings during DAgger.
        tuning_task: settings during PPO.
        distillation, ppo: see there.
    """

    minutes: float = 20.0
    tuning_minutes: float = 25.0
    categories: tuple[str, ...] | None = LOCOMOTION
    mirror: bool = True
    still_seconds: float = 4.0
    history: int = 25
    moe: MoeConfig = field(default_factory=MoeConfig)
    noise: OdometryNoiseConfig = field(default_factory=OdometryNoiseConfig)
    task: TaskConfig = field(
        default_factory=lambda: TaskConfig(
            limits=TerminationLimits(0.3, 1.0, 0.35, 1.0), displaced_share=0.1
        )
    )
    tuning_task: TaskConfig = field(
        default_factory=lambda: TaskConfig(
            limits=TerminationLimits(0.35, 1.2, 0.6, 1.2),
            displaced_share=0.1,
            born_distance=0.6,
            standing_share=0.1,
            failure_share=0.85,
        )
    )
    distillation: DistillationConfig = field(default_factory=DistillationConfig)
    ppo: PpoConfig = field(
        default_factory=lambda: PpoConfig(
            kl=0.02, learning_rate=1e-4, initial_std=0.15, entropy=0.0, epochs=3
        )
    )


Preset = TypeVar("Preset")

_SMOKE_TASK = TaskConfig(num_envs=16, episode_steps=50)
_SMOKE_PPO = PpoConfig(steps=4, epochs=1, minibatches=1, hidden=(32, 32))

TEACHERS = {
    "fast": TeacherPreset(),
    "quickstart": TeacherPreset(
        minutes=22.0, categories=("stand", "forward", "turn"), mirror=False
    ),
    "smoke": TeacherPreset(minutes=0.02, task=_SMOKE_TASK, ppo=_SMOKE_PPO),
}
STUDENTS = {
    "fast": StudentPreset(),
    "quickstart": StudentPreset(
        minutes=14.0,
        tuning_minutes=0.0,
        categories=("stand", "forward", "turn"),
        mirror=False,
    ),
    "smoke": StudentPreset(
        minutes=0.02,
        tuning_minutes=0.02,
        moe=MoeConfig(width=16),
        task=_SMOKE_TASK,
        tuning_task=_SMOKE_TASK,
        distillation=DistillationConfig(steps=4, updates=2, batch=32),
        ppo=_SMOKE_PPO,
    ),
}


def teacher_preset(name: str) -> TeacherPreset:
    """Look up a teacher preset; `InputError` names the known ones."""
    return _known(TEACHERS, name)


def student_preset(name: str) -> StudentPreset:
    """Look up a student preset; `InputError` names the known ones."""
    return _known(STUDENTS, name)


def _known(table: dict[str, Preset], name: str) -> Preset:
    if name not in table:
        raise InputError(
            f"unknown preset {name!r}", remedy="use one of " + ", ".join(table)
        )
    return table[name]
