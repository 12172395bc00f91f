"""Presets: every number of a training run in one frozen dataclass."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from typing import TypeVar

from openclone.errors import InputError
from openclone.motion.clip import Clip
from openclone.odometry.faults import REAL, OdometryFaultsConfig
from openclone.odometry.noise import OdometryNoiseConfig
from openclone.policy.mlp import MlpConfig
from openclone.policy.moe import MoeConfig
from openclone.training.amp import AmpConfig
from openclone.training.data_choice import DataChoice
from openclone.training.imitation import ImitationConfig
from openclone.training.ppo import PpoConfig
from openclone.training.reward_table import FAST, PAPER
from openclone.training.task_config import (
    TABLE_A2_TASK,
    TaskConfig,
    TerminationLimits,
)
from openclone.training.value_gradient import ValueGradientConfig

_WALKING = ("stand", "forward", "turn")

_BEFORE_THE_FALL = TerminationLimits(0.4, 1.5, math.inf, 1.5)
"""A robot that lags may catch up: what it learns then, the student needs most."""
_FAST_TASK = TaskConfig(
    num_envs=512,
    episode_steps=300,
    limits=_BEFORE_THE_FALL,
    failure_share=0.5,
    run_up=125,
    push_speed=1.6,
    # Robots that are always recovering learn little of keeping near the reference.
    push_interval=12.0,
    standing_share=0.05,
    displaced_share=0.1,
    born_distance=0.6,
    recorded_weight=5.0,
    view="legs",
    guidance="springs",
)
_STUDENT_TASK = TaskConfig(
    num_envs=512,
    limits=_BEFORE_THE_FALL,
    view="legs",
    guidance="springs",
    failure_share=0.5,
    run_up=125,
    push_speed=1.6,
    push_interval=12.0,
    displaced_share=0.05,
    standing_share=0.08,
    recorded_weight=5.0,
)
_TUNING_TASK = replace(
    _STUDENT_TASK, num_envs=256, push_interval=8.0, standing_share=0.03
)
_EARLIER = replace(
    FAST,
    body_position=4.0,
    body_velocity=2.0,
    leg_distance=0.0,
    correction_rate=0.0,
    velocity_distance=0.0,
    body_distance=0.0,
)
"""What `quickstart` and `feedback` were measured with."""
_QUICKSTART_DATA = DataChoice(categories=_WALKING, commands=False, mirror=False)
# Wide rewards, and an end for those who stay behind: with either alone robots that
# know nothing yet learn to stay up where they are.
_QUICKSTART_TASK = TaskConfig(
    num_envs=512,
    view="command",
    guidance="arms",
    weights=replace(
        _EARLIER,
        widths=replace(FAST.widths, vr_position=0.2**2, extend_body_position=0.26**2),
    ),
    limits=TerminationLimits(0.4, 1.5, math.inf, 0.6),
    failure_share=0.5,
    run_up=75,
    push_speed=0.5,
    displaced_share=0.1,
    standing_share=0.1,
)
_QUICKSTART_TUNING = replace(_TUNING_TASK, view="command", guidance="arms")
# Much noise at first: with little, a step within the KL budget is tiny.
_FAST_PPO = PpoConfig(
    steps=16,
    epochs=2,
    minibatches=4,
    slowest=1e-5,
    kl=0.04,
    final_kl=0.015,
    entropy=0.0,
    initial_std=0.25,
    final_std=0.065,
    hidden=(512, 256, 128),
)
_QUICKSTART_PPO = replace(
    _FAST_PPO, steps=24, initial_std=0.5, final_std=0.1, hidden=(256, 128, 64)
)


@dataclass(frozen=True)
class TeacherPreset:
    """Settings of one teacher run.

    Attributes:
        minutes: wall time of PPO.
        iterations: PPO iterations, if they end it instead.
        data, task, ppo: see there.
        imitation: the copy of linear feedback that comes before PPO; None for none.
        guess_errors: size of the errors, during PPO, in what students must guess; 1:
            those of a student.
        amp: the style reward; None for none.
        tuning_minutes: wall time of value gradients afterwards; 0 for none.
        tuning_iterations: their steps, if they end it instead.
        tuning_task, tuning: their settings; AMP takes no part.
    """

    minutes: float = 60.0
    iterations: int | None = None
    data: DataChoice = field(default_factory=DataChoice)
    task: TaskConfig = _FAST_TASK
    ppo: PpoConfig = _FAST_PPO
    imitation: ImitationConfig | None = None
    guess_errors: float = 0.0
    amp: AmpConfig | None = None
    tuning_minutes: float = 0.0
    tuning_iterations: int | None = None
    tuning_task: TaskConfig = _TUNING_TASK
    tuning: ValueGradientConfig = field(default_factory=ValueGradientConfig)

    def select(self, clips: list[Clip]) -> list[Clip]:
        """The training motions among ``clips``."""
        return self.data.select(clips)


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
        average: share of the old weights in their moving average, per gradient step;
            the average is what the bundle holds. 0: the newest weights.
    """

    steps: int = 20
    kept_rounds: int = 200
    updates: int = 12
    batch: int = 1500
    learning_rate: float = 6e-4
    teacher_share_rounds: int = 60
    balance: float = 0.05
    max_grad_norm: float = 0.5
    average: float = 0.9995


@dataclass(frozen=True)
class StudentPreset:
    """Settings of one student run: DAgger, then value gradients.

    Attributes:
        minutes: wall time of DAgger.
        iterations: rounds of DAgger, if they end it instead.
        tuning_minutes: wall time of value gradients afterwards; 0 for none.
        tuning_iterations: their steps, if they end it instead.
        teacher: name of the teacher preset to train first when no teacher is given;
            empty: a teacher must be given.
        data: see there.
        history: frames of history H.
        network: experts, or the MLP of the baseline.
        noise: Eq. 2.
        faults: what else is wrong with the odometry.
        task: settings during DAgger.
        tuning_task: settings during value gradients.
        distillation, tuning: see there.
    """

    minutes: float = 20.0
    iterations: int | None = None
    tuning_minutes: float = 0.0
    tuning_iterations: int | None = None
    teacher: str = ""
    data: DataChoice = field(default_factory=DataChoice)
    history: int = 25
    network: MoeConfig | MlpConfig = field(default_factory=MoeConfig)
    noise: OdometryNoiseConfig = field(default_factory=OdometryNoiseConfig)
    faults: OdometryFaultsConfig = field(default_factory=OdometryFaultsConfig)
    task: TaskConfig = _STUDENT_TASK
    tuning_task: TaskConfig = _TUNING_TASK
    distillation: DistillationConfig = field(default_factory=DistillationConfig)
    tuning: ValueGradientConfig = field(default_factory=ValueGradientConfig)

    def select(self, clips: list[Clip]) -> list[Clip]:
        """The training motions among ``clips``."""
        return self.data.select(clips)


_PAPER_TASK = replace(
    TABLE_A2_TASK,
    num_envs=8192,
    weights=PAPER,
    limits=TerminationLimits(math.inf, math.inf, math.inf, 1.5),
    lead_frames=0,
    preview=(),
    look_share=0.0,
    guidance="angles",
)
_SMOKE_TASK = TaskConfig(num_envs=16, episode_steps=50)
_SMOKE_PPO = PpoConfig(steps=4, epochs=1, minibatches=1, hidden=(32, 32))
_SMOKE_AMP = AmpConfig(hidden=(32, 16), replay=1000, batch=64, updates=1)
_SMOKE_TUNING = ValueGradientConfig(
    steps=4,
    warm_up=1,
    width=16,
    world_updates=1,
    world_batch=32,
    kept=256,
    warm_up_updates=2,
)

_TEACHER = TeacherPreset(
    guess_errors=1.0, ppo=replace(_FAST_PPO, epochs=1, twins=4), tuning_minutes=20.0
)
TEACHERS = {
    "fast": _TEACHER,
    "fast-amp": replace(
        _TEACHER,
        task=replace(_FAST_TASK, weights=replace(FAST, amp=0.5)),
        amp=AmpConfig(hidden=(256, 128), batch=2048, learning_rate=1e-4),
        tuning_minutes=0.0,  # AMP would take no part
    ),
    "other-data": replace(_TEACHER, data=DataChoice(recorded_only=True, mirror=False)),
    "paper": TeacherPreset(
        minutes=math.inf,
        iterations=1_000_000,
        task=_PAPER_TASK,
        ppo=PpoConfig(
            steps=24,
            epochs=5,
            minibatches=4,
            learning_rate=1e-3,
            slowest=1e-5,
            fastest=1e-2,
            kl=0.01,
            entropy=0.005,
            hidden=(512, 256, 128),
        ),
        amp=AmpConfig(),
    ),
    "quickstart": TeacherPreset(
        minutes=17.0,
        data=_QUICKSTART_DATA,
        task=_QUICKSTART_TASK,
        ppo=_QUICKSTART_PPO,
        guess_errors=0.5,
        tuning_task=_QUICKSTART_TUNING,
    ),
    # Nearest of all to the reference's legs, and little else: for experiments.
    "feedback": TeacherPreset(
        minutes=8.0,
        data=_QUICKSTART_DATA,
        task=replace(
            _QUICKSTART_TASK, view="legs", weights=_EARLIER, limits=_BEFORE_THE_FALL
        ),
        ppo=replace(_QUICKSTART_PPO, steps=16, initial_std=0.2),
        imitation=ImitationConfig(),
        guess_errors=1.0,
    ),
    "smoke": TeacherPreset(
        minutes=math.inf,
        iterations=3,
        task=replace(_SMOKE_TASK, weights=replace(FAST, amp=0.5)),
        ppo=_SMOKE_PPO,
        amp=_SMOKE_AMP,
        tuning_task=_SMOKE_TASK,
        tuning=_SMOKE_TUNING,
    ),
}

_STUDENT = StudentPreset()
STUDENTS = {
    "fast": replace(_STUDENT, tuning_minutes=15.0),
    "mlp": replace(_STUDENT, network=MlpConfig()),
    "other-data": replace(
        _STUDENT,
        data=DataChoice(recorded_only=True, mirror=False),
    ),
    "history-5": replace(_STUDENT, history=5),
    "history-50": replace(_STUDENT, history=50),
    "layers-1": replace(_STUDENT, network=MoeConfig(layers=1)),
    "real-odometry": replace(_STUDENT, tuning_minutes=15.0, faults=REAL),
    "experts-8": replace(_STUDENT, network=MoeConfig(experts=8)),
    "paper": StudentPreset(
        minutes=math.inf,
        iterations=600_000,
        tuning_minutes=0.0,
        task=replace(_PAPER_TASK, num_envs=4096),
        distillation=DistillationConfig(
            steps=24,
            kept_rounds=1,
            updates=20,
            batch=24 * 4096 // 4,
            learning_rate=5e-4,
            teacher_share_rounds=1,
            max_grad_norm=0.2,
        ),
    ),
    "quickstart": StudentPreset(
        minutes=18.0,
        tuning_minutes=0.0,
        teacher="quickstart",
        task=replace(
            _STUDENT_TASK,
            view="command",
            guidance="arms",
            failure_share=0.3,
            push_speed=0.5,
            push_interval=5.0,
        ),
        tuning_task=_QUICKSTART_TUNING,
        data=_QUICKSTART_DATA,
    ),
    "smoke": StudentPreset(
        minutes=math.inf,
        iterations=3,
        tuning_minutes=math.inf,
        tuning_iterations=3,
        teacher="smoke",
        network=MoeConfig(width=16),
        task=_SMOKE_TASK,
        tuning_task=_SMOKE_TASK,
        distillation=DistillationConfig(steps=4, updates=2, batch=32),
        tuning=_SMOKE_TUNING,
    ),
}
"""``mlp`` is the paper's CLONE†, ``other-data`` its CLONE*; ``history-*``, ``layers-1``
and ``experts-8`` are the rows of its Table 2."""


def teacher_preset(name: str) -> TeacherPreset:
    """Look up a teacher preset; `InputError` names the known ones."""
    return _known(TEACHERS, name)


def student_preset(name: str) -> StudentPreset:
    """Look up a student preset; `InputError` names the known ones."""
    return _known(STUDENTS, name)


Preset = TypeVar("Preset")


def _known(table: dict[str, Preset], name: str) -> Preset:
    if name not in table:
        raise InputError(
            f"unknown preset {name!r}", remedy="use one of " + ", ".join(table)
        )
    return table[name]
