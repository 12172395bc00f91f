"""Control steps per second of training on the CPU, beside its physics and mjlab.

Four rates on the same machine in one run, as ratios:

1. raw ``mujoco.rollout`` on the training model, all cores: what MuJoCo allows;
2. the same robots in lanes, where there is a C compiler;
3. the tracking task (rewards, resets, teacher observation) on the physics that training
   chooses, lanes by default;
4. PPO end to end on top of that: the ``fast`` preset's collection and updates, in one
   process;
5. mjlab's G1 velocity task in its CPU mode (MuJoCo Warp on the CPU device).

All take turns in short windows, so that a machine that is busy with other things
slows all of them alike. Every round gives one ratio; printed are their medians and, as
``..._low`` and ``..._high``, their extremes. Ratios are given twice: of wall time, and
of CPU time summed over threads, which other processes disturb less but which hides
waiting.

Run it with ``make bench`` on an idle machine.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import platform
import tempfile
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path

import mujoco
import numpy as np
import torch
from mujoco import rollout

from openclone.motion.sources.synthetic import default_set
from openclone.robot.model import SUBSTEPS
from openclone.training.lane_physics import LanePhysics
from openclone.training.native import compiler
from openclone.training.ppo import learn
from openclone.training.presets import TEACHERS
from openclone.training.progress import Budget, Progress
from openclone.training.teacher import TeacherTrainer
from openclone.training.teacher_view import TeacherEnvironment
from openclone.training.terrain import build_training_model

Times = np.ndarray


def timed(work: Callable[[], int]) -> tuple[float, float]:
    """Wall and CPU seconds per control step of ``work``, which returns their count."""
    wall, cpu = time.perf_counter(), time.process_time()
    count = work()
    return (
        (time.perf_counter() - wall) / count,
        (time.process_time() - cpu) / count,
    )


def raw_rollout(trainer: TeacherTrainer, threads: int, steps: int) -> Callable[[], int]:
    """Work that steps the robots from where they are now, with held targets."""
    task, model = trainer.task, build_training_model()
    qpos, qvel, _ = task.physics.read()
    count = task.num_envs
    size = mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS)
    state = np.zeros((count, size))
    state[:, 1 : 1 + model.nq] = qpos
    state[:, 1 + model.nq : 1 + model.nq + model.nv] = qvel
    targets = task.residual_to_target(torch.zeros(count, 29)).double().numpy()
    ctrl = np.repeat(targets[:, None], SUBSTEPS, axis=1)
    states = np.empty((count, SUBSTEPS, size))
    sensors = np.empty((count, SUBSTEPS, model.nsensordata))
    datas = [mujoco.MjData(model) for _ in range(threads)]
    pool = rollout.Rollout(nthread=threads)
    models = [model] * count

    def work() -> int:
        for _ in range(steps):
            pool.rollout(
                models,
                datas,
                state,
                ctrl,
                skip_checks=True,
                nstep=SUBSTEPS,
                state=states,
                sensordata=sensors,
            )
        return steps * count

    return work


def lanes(trainer: TeacherTrainer, threads: int, steps: int) -> Callable[[], int]:
    """The same work as `raw_rollout` in lanes: every call begins at the same states."""
    task, model = trainer.task, build_training_model()
    physics = LanePhysics(model, task.num_envs, threads)
    qpos, qvel, _ = (part.numpy() for part in task.physics.read())
    targets = task.residual_to_target(torch.zeros(task.num_envs, 29))
    ctrl = targets[:, None].repeat(1, SUBSTEPS, 1)
    everyone = np.arange(task.num_envs)

    def work() -> int:
        for _ in range(steps):
            physics.place(everyone, qpos, qvel)
            physics.step(ctrl)
        return steps * task.num_envs

    return work


def task_steps(trainer: TeacherTrainer, steps: int) -> Callable[[], int]:
    """Work that steps the task with noisy actions and observes it."""
    task = trainer.task
    noise = torch.Generator().manual_seed(0)

    def work() -> int:
        with torch.inference_mode():
            for _ in range(steps):
                action = 0.3 * torch.randn(task.num_envs, 29, generator=noise)
                task.step(task.residual_to_target(action))
                task.teacher_observation()
        return steps * task.num_envs

    return work


def ppo_iteration(trainer: TeacherTrainer, folder: Path) -> Callable[[], int]:
    """Work that is one iteration of PPO: collection and updates."""
    config = trainer.preset.ppo
    env = TeacherEnvironment(trainer.task)

    def work() -> int:
        progress = Progress(folder, Budget(float("inf"), 1))
        learn(env, trainer.ppo, config, progress, lambda: None)
        progress.close()
        return config.steps * env.num_envs

    return work


@contextlib.contextmanager
def our_works(robots: int | None, steps: int) -> Iterator[dict[str, Callable[[], int]]]:
    """The first three, by name."""
    threads = os.cpu_count() or 1
    preset = TEACHERS["fast"]
    if robots is not None:
        preset = replace(preset, task=replace(preset.task, num_envs=robots))
    trainer = TeacherTrainer(default_set(0, 1.0), preset, 0, threads)
    with tempfile.TemporaryDirectory() as folder:
        task = task_steps(trainer, steps)
        task()
        works = {"raw_rollout": raw_rollout(trainer, threads, steps)}
        if compiler() is not None:
            works["lanes"] = lanes(trainer, threads, steps)
        yield works | {
            "task": task,
            "ppo": ppo_iteration(trainer, Path(folder)),
        }


@contextlib.contextmanager
def mjlab_work(robots: int) -> Iterator[Callable[[], int]]:
    """Control steps of mjlab's flat velocity task on the CPU."""
    # mjlab and Warp describe themselves at length; the first run also compiles.
    with contextlib.redirect_stdout(io.StringIO()):
        import mjlab.tasks.velocity.config.g1  # noqa: F401  (registers the task)
        from mjlab.envs import ManagerBasedRlEnv
        from mjlab.tasks.registry import load_env_cfg

        config = load_env_cfg("Mjlab-Velocity-Flat-Unitree-G1")
        config.scene.num_envs = robots
        env = ManagerBasedRlEnv(config, device="cpu")
        env.reset()
    action = torch.zeros(robots, env.action_manager.total_action_dim)

    def work() -> int:
        with contextlib.redirect_stdout(io.StringIO()):
            for _ in range(3):
                env.step(action)
        return 3 * robots

    yield work
    env.close()


def take_turns(works: dict[str, Callable[[], int]], rounds: int) -> dict[str, Times]:
    """Wall and CPU seconds per control step, ``(rounds, 2)``, of every work."""
    for work in works.values():
        work()
    rows: dict[str, list[tuple[float, float]]] = {name: [] for name in works}
    for _ in range(rounds):
        for name, work in works.items():
            rows[name].append(timed(work))
    return {name: np.array(times) for name, times in rows.items()}


def ratios(times: dict[str, Times]) -> dict[str, float]:
    """Median rates, and for each ratio its median and its extremes, by name."""
    figures = {
        f"{name}_steps_s": round(float(1 / np.median(rows[:, 0])), 1)
        for name, rows in times.items()
    }
    pairs = [
        ("lanes_over_raw", "raw_rollout", "lanes"),
        ("task_share_of_raw", "raw_rollout", "task"),
        ("ppo_share_of_raw", "raw_rollout", "ppo"),
    ]
    if "mjlab_cpu" in times:
        pairs += [
            ("task_over_mjlab", "mjlab_cpu", "task"),
            ("ppo_over_mjlab", "mjlab_cpu", "ppo"),
        ]
    for name, slow, fast in pairs:
        if fast not in times:
            continue
        for index, clock in enumerate(("wall", "cpu")):
            values = times[slow][:, index] / times[fast][:, index]
            key = f"{name}_{clock}"
            figures[key] = round(float(np.median(values)), 3)
            figures[f"{key}_low"] = round(float(values.min()), 3)
            figures[f"{key}_high"] = round(float(values.max()), 3)
    return figures


def main() -> None:
    """Measure, print, and write JSON if asked."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", type=int, help="default: the fast preset's")
    parser.add_argument("--mjlab-robots", type=int, default=64)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--steps", type=int, default=24, help="per window")
    parser.add_argument("--without-mjlab", action="store_true")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    with contextlib.ExitStack() as stack:
        works = dict(stack.enter_context(our_works(arguments.robots, arguments.steps)))
        if not arguments.without_mjlab:
            mjlab = mjlab_work(arguments.mjlab_robots)
            works["mjlab_cpu"] = stack.enter_context(mjlab)
        times = take_turns(works, arguments.rounds)
    result = {
        "machine": f"{platform.processor() or platform.machine()}, "
        f"{os.cpu_count()} cores",
        "versions": f"mujoco {mujoco.__version__}, torch {torch.__version__}",
        "robots": arguments.robots or TEACHERS["fast"].task.num_envs,
        **ratios(times),
    }
    for name, value in result.items():
        print(f"{name:28} {value}")
    if arguments.json:
        arguments.json.write_text(json.dumps(result, indent=2) + "\n")


if __name__ == "__main__":
    main()
