"""What a preset will cost on this machine: steps, memory and time, before it starts.

The rate is measured on this machine with the preset's own networks and settings, for
some seconds a phase, on untrained robots that wave their arms (and soon fall).
"""

from __future__ import annotations

import math
import os
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from rsl_rl.algorithms import PPO
from tensordict import TensorDict
from torch import nn

from openclone.motion.clip import Clip, ClipInfo, clip_from_qpos
from openclone.robot import g1
from openclone.robot.model import SUBSTEPS, build_model, standing_qpos
from openclone.training.demonstrations import round_bytes
from openclone.training.distillation import Dagger, distill
from openclone.training.imitation import Imitation, ImitationConfig
from openclone.training.pilots import Pilot, StudentPilot
from openclone.training.ppo import (
    PpoConfig,
    PpoEnvironment,
    learn,
    mlp_model,
)
from openclone.training.presets import (
    DistillationConfig,
    StudentPreset,
    TeacherPreset,
)
from openclone.training.progress import Budget, Progress
from openclone.training.reference import generalized_velocities
from openclone.training.regulator import DEVIATION_SIZE, Motion, regulate
from openclone.training.student import StudentTrainer
from openclone.training.task_config import TaskConfig
from openclone.training.teacher import TeacherTrainer
from openclone.training.teacher_view import CRITIC, TeacherEnvironment
from openclone.training.teacher_view import GROUP as TEACHER
from openclone.training.terrain import build_training_model
from openclone.training.value_gradient import Tuner

MEASURED_ROBOTS = 256
"""At most so many robots take part in the measurement."""
_FRAME_BYTES = 8 * (36 + 35) + 4 * (2 * 29 + 14 * 13 + 29 + 6) + 16
"""Of the reference tables, per frame."""
_GAIN_BYTES = 2 * g1.NUM_JOINTS * (DEVIATION_SIZE + 1)
"""Of the feedback gains, per frame."""
_WORKER_BYTES = 100 * 2**20
"""A process that computes gains."""
_WORKING_BYTES = 700 * 2**20
"""Python, torch and MuJoCo themselves."""


@dataclass(frozen=True)
class PhasePlan:
    """The cost of one phase.

    Attributes:
        phase: feedback gains; copy or PPO of the teacher; DAgger of the student; value
            gradients of either.
        robots: simulated together.
        steps_per_s: control steps per second, measured; of gains, frames.
        steps: control steps in all.
        iterations: collections and updates in all.
        minutes: wall time.
        memory_mb: of the process.
    """

    phase: str
    robots: int
    steps_per_s: float
    steps: float
    iterations: float
    minutes: float
    memory_mb: float


def plan_gains(motion_minutes: float, threads: int | None) -> PhasePlan:
    """Measure the gains of one short motion.

    They are computed once for all phases; those in the cache cost nothing.
    """
    model, qpos = build_training_model(), waving().qpos
    motion = Motion(qpos, generalized_velocities(model, qpos), qpos[:, 7:])
    start = time.perf_counter()
    regulate(model, motion)
    cores = threads or os.cpu_count() or 1
    rate = cores * len(motion) / (time.perf_counter() - start)
    frames = motion_minutes * 60 * 50
    memory = _WORKING_BYTES + cores * _WORKER_BYTES + frames * _GAIN_BYTES
    minutes = frames / rate / 60
    memory_mb = memory / 2**20
    phase = "feedback gains"
    return PhasePlan(phase, cores, rate, frames, frames, minutes, memory_mb)


def plan_teacher(
    preset: TeacherPreset, seconds: float, motion_minutes: float, threads: int | None
) -> list[PhasePlan]:
    """Measure each phase for ``seconds``; data of ``motion_minutes``."""
    small = replace(
        preset, task=_measured(preset.task), tuning_task=_measured(preset.tuning_task)
    )
    trainer = TeacherTrainer([waving()], small, 0, threads)
    held = _data_bytes(motion_minutes, preset.imitation is not None)
    held += _robot_bytes(preset.task)
    plans: list[PhasePlan] = []
    if preset.imitation is not None:
        plans.append(plan_gains(motion_minutes, threads))
        plans.append(_plan_imitation(trainer, preset, preset.imitation, seconds, held))
    env, config = TeacherEnvironment(trainer.task), preset.ppo
    rate = _ppo_rate(env, trainer.ppo, config, seconds)
    robots = preset.task.num_envs
    memory = held + _ppo_bytes(trainer.ppo, config, robots)
    if trainer.style is not None and preset.amp is not None:
        memory += 4 * preset.amp.replay * 80 + _network_bytes(trainer.style.net)
    bounds = Budget(preset.minutes, preset.iterations)
    plans.append(_phase("teacher, PPO", robots, config.steps, rate, bounds, memory))
    if preset.tuning_minutes > 0:
        pilot = trainer.pilot()
        inputs = pilot.task.teacher_observation().shape[1]
        plans.append(_plan_tuning("teacher", pilot, preset, inputs, seconds, held))
    return plans


def _plan_imitation(
    trainer: TeacherTrainer,
    preset: TeacherPreset,
    config: ImitationConfig,
    seconds: float,
    held: float,
) -> PhasePlan:
    task, robots = trainer.task, preset.task.num_envs
    share = task.num_envs / robots
    few = replace(config, batch=max(1, round(config.batch * share)), kept_rounds=1)

    with tempfile.TemporaryDirectory() as folder:
        log = Progress(Path(folder), Budget(math.inf))
        imitation = Imitation(task, trainer.ppo.actor, TEACHER, few, log)

        def iteration(progress: Progress) -> None:
            before = log.steps
            imitation.collect()
            imitation.update()
            progress.steps += log.steps - before

        rate = _rate(iteration, seconds)
        log.close()
    seen = 4 * (task.teacher_observation().shape[1] + g1.NUM_JOINTS)
    memory = held + seen * robots * config.steps * config.kept_rounds
    memory += _network_bytes(trainer.ppo.actor)
    bounds = Budget(config.minutes, config.iterations)
    return _phase("teacher, copy", robots, config.steps, rate, bounds, memory)


def plan_student(
    preset: StudentPreset, seconds: float, motion_minutes: float, threads: int | None
) -> list[PhasePlan]:
    """Measure DAgger and, if the preset has them, value gradients."""
    small = replace(
        preset, task=_measured(preset.task), tuning_task=_measured(preset.tuning_task)
    )
    with tempfile.TemporaryDirectory() as folder:
        trainer = StudentTrainer([waving()], small, Path(folder), 0, threads)
        data = _data_bytes(motion_minutes)
        plans = [_plan_dagger(trainer, preset, seconds, data, Path(folder))]
        if preset.tuning_minutes > 0:
            view = trainer.view(small.tuning_task)
            pilot, inputs = StudentPilot(view, trainer.student), view.observe().shape[1]
            plans.append(_plan_tuning("student", pilot, preset, inputs, seconds, data))
    return plans


def _plan_dagger(
    trainer: StudentTrainer,
    preset: StudentPreset,
    seconds: float,
    data: float,
    folder: Path,
) -> PhasePlan:
    config = preset.distillation
    view = trainer.view(trainer.preset.task)
    teacher = _untrained_teacher(view.task.config).actor
    rng = np.random.default_rng(0)
    dagger = Dagger(view, teacher, trainer.student, _scaled(preset), rng, folder)
    rate = _rate(lambda progress: distill(dagger, progress), seconds)
    robots = preset.task.num_envs
    memory = config.kept_rounds * round_bytes(robots, config.steps, preset.history)
    memory += 4 * 3 * config.batch * view.observe().shape[1]
    memory += _network_bytes(trainer.student) + _robot_bytes(preset.task) + data
    bounds = Budget(preset.minutes, preset.iterations)
    return _phase("student, DAgger", robots, config.steps, rate, bounds, memory)


def _plan_tuning(
    who: str,
    pilot: Pilot,
    preset: StudentPreset | TeacherPreset,
    inputs: int,
    seconds: float,
    held: float,
) -> PhasePlan:
    """Value gradients of a ``pilot`` that sees ``inputs`` values."""
    config, robots = preset.tuning, preset.tuning_task.num_envs
    privileged = pilot.task.reference_observation()
    seen = TensorDict({CRITIC: privileged}, batch_size=[len(privileged)])
    critic = mlp_model(seen, CRITIC, 1, PpoConfig())
    with tempfile.TemporaryDirectory() as folder:
        ready = replace(config, warm_up=0)
        rate = _rate(Tuner(pilot, critic, ready, 0, Path(folder)).round, seconds)
    # What gradients need on their way back: inputs and hidden layers of all networks.
    each = 4 * inputs + 8 * config.width + privileged.shape[1] + 10_000
    memory = 4.0 * each * robots * config.steps + 4.0 * 165 * config.kept
    memory += _network_bytes(pilot.network) + _robot_bytes(preset.tuning_task) + held
    bounds = Budget(preset.tuning_minutes, preset.tuning_iterations)
    name = f"{who}, value gradients"
    return _phase(name, robots, config.steps, rate, bounds, memory)


def waving() -> Clip:
    """Two seconds of standing with waving arms: something to track."""
    qpos = np.tile(standing_qpos(), (101, 1))
    swing = 0.3 * np.sin(2 * np.pi * np.arange(101) / 50)
    qpos[:, 7 + g1.joint_index("left_shoulder_pitch_joint")] += swing
    qpos[:, 7 + g1.joint_index("right_elbow_joint")] += swing
    return clip_from_qpos(ClipInfo("plan/waving", "stand", "", "", 50.0), qpos)


def machine_memory_mb() -> float:
    """Memory of this machine."""
    return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE") / 2**20


# Rates -------------------------------------------------------------------------------


def _measured(task: TaskConfig) -> TaskConfig:
    return replace(task, num_envs=min(task.num_envs, MEASURED_ROBOTS))


def _rate(iteration: Callable[[Progress], None], seconds: float) -> float:
    """Control steps per second of ``iteration``, after one to warm up."""
    with tempfile.TemporaryDirectory() as folder:
        progress = Progress(Path(folder), Budget(math.inf))
        iteration(progress)
        before, start = progress.steps, time.perf_counter()
        while time.perf_counter() - start < seconds:
            iteration(progress)
        rate = (progress.steps - before) / (time.perf_counter() - start)
        progress.close()
    return rate


def _ppo_rate(
    env: PpoEnvironment, ppo: PPO, config: PpoConfig, seconds: float
) -> float:
    def iteration(progress: Progress) -> None:
        once = Progress(progress.folder, Budget(math.inf, 1))
        learn(env, ppo, config, once, lambda: None, line_seconds=math.inf)
        once.close()
        progress.steps += once.steps

    return _rate(iteration, seconds)


def _untrained_teacher(task: TaskConfig) -> PPO:
    preset = TeacherPreset(task=task, ppo=PpoConfig())
    return TeacherTrainer([waving()], preset, 0, 1).ppo


def _scaled(preset: StudentPreset) -> DistillationConfig:
    """Batches as small as the measured robots are few: the same work per step."""
    share = min(1.0, MEASURED_ROBOTS / preset.task.num_envs)
    config = preset.distillation
    return replace(config, batch=max(1, round(config.batch * share)))


# Memory ------------------------------------------------------------------------------


def _network_bytes(network: nn.Module) -> float:
    """Weights, gradients and Adam's two moments."""
    return 16 * sum(parameter.numel() for parameter in network.parameters())


def _ppo_bytes(ppo: PPO, config: PpoConfig, robots: int) -> float:
    """Storage for ``robots``, networks, and what one minibatch needs on its way."""
    storage = ppo.storage
    tensors = [v for v in vars(storage).values() if isinstance(v, torch.Tensor)]
    tensors += list(storage.observations.to_dict().values())
    tensors += list(storage.distribution_params or ())
    held = sum(tensor.numel() * tensor.element_size() for tensor in tensors)
    stored = held * robots / storage.num_envs
    batch = 1 / config.minibatches
    widths = 4 * sum(config.hidden) * robots * config.steps * batch
    networks = _network_bytes(ppo.actor) + _network_bytes(ppo.critic)
    return stored * (1 + 2 * batch) + 4 * widths + networks


def _robot_bytes(task: TaskConfig) -> float:
    """States and sensors of all substeps; a model each if robots differ."""
    model = build_model()
    state = 8 * (2 * model.nq + 3 * model.nv + model.nsensordata)
    each = (SUBSTEPS + 2) * state
    if task.randomization.changes_robots:
        each += model.nbuffer
    return task.num_envs * each


def _data_bytes(motion_minutes: float, gains: bool = False) -> float:
    frame = _FRAME_BYTES + gains * _GAIN_BYTES
    return _WORKING_BYTES + motion_minutes * 60 * 50 * frame


def _phase(
    name: str, robots: int, steps: int, rate: float, budget: Budget, memory: float
) -> PhasePlan:
    per_iteration = robots * steps
    minutes = budget.minutes
    if budget.iterations is not None:
        minutes = min(minutes, budget.iterations * per_iteration / rate / 60)
    total = minutes * 60 * rate
    return PhasePlan(
        name, robots, rate, total, total / per_iteration, minutes, memory / 2**20
    )
