"""Control steps per second of the tracking task, beside its physics and mjlab.

Three rates on the same machine in one run, as ratios:

1. raw ``mujoco.rollout`` on the training model, all cores: what the physics allows;
2. the tracking task (rewards, resets, teacher observation) on top of it;
3. mjlab's G1 velocity task in its CPU mode (MuJoCo Warp on the CPU device).

Run it with ``make bench`` on an idle machine.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import platform
import time
from collections.abc import Callable
from pathlib import Path

import mujoco
import numpy as np
import torch

from openclone.motion.sources.synthetic import default_set
from openclone.robot.model import SUBSTEPS, SensorLayout, build_model
from openclone.training.physics import ThreadedPhysics
from openclone.training.reference import build_reference
from openclone.training.task import TaskConfig, TrackingTask


def steps_per_second(step: Callable[[], object], robots: int, seconds: float) -> float:
    """Median over five windows of ``robots`` control steps per second."""
    step()
    rates = []
    for _ in range(5):
        count, start = 0, time.perf_counter()
        while time.perf_counter() - start < seconds / 5:
            step()
            count += 1
        rates.append(count * robots / (time.perf_counter() - start))
    return float(np.median(rates))


def openclone_rates(robots: int, seconds: float) -> tuple[float, float]:
    """Rates of raw rollout and of the task, both in the states the task visits."""
    model = build_model()
    clips = default_set(0, 1.0)
    reference = build_reference(clips, model)
    physics = ThreadedPhysics(model, robots)
    config = TaskConfig(num_envs=robots)
    task = TrackingTask(reference, physics, SensorLayout.of(model), config, 0)
    noise = torch.Generator().manual_seed(0)

    def task_step() -> None:
        action = 0.3 * torch.randn(robots, 29, generator=noise)
        task.step(task.residual_to_target(action))
        task.teacher_observation()

    task_rate = steps_per_second(task_step, robots, seconds)
    # The same states and controls, held: no task, no resets.
    state = (physics.qpos.copy(), physics.qvel.copy())
    targets = task.residual_to_target(torch.zeros(robots, 29)).numpy()
    ctrl = np.repeat(targets.astype(np.float64)[:, None], SUBSTEPS, axis=1)

    def raw_step() -> None:
        physics.qpos[:], physics.qvel[:] = state
        physics.step(ctrl)

    return steps_per_second(raw_step, robots, seconds), task_rate


def mjlab_rate(robots: int, seconds: float) -> float:
    """Control steps per second of mjlab's flat velocity task on the CPU."""
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
        rate = steps_per_second(lambda: env.step(action), robots, seconds)
        env.close()
    return rate


def main() -> None:
    """Measure, print, and write JSON if asked."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--robots", type=int, default=256)
    parser.add_argument("--mjlab-robots", type=int, default=64)
    parser.add_argument("--seconds", type=float, default=15.0)
    parser.add_argument("--without-mjlab", action="store_true")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    raw, task = openclone_rates(arguments.robots, arguments.seconds)
    result = {
        "machine": f"{platform.processor() or platform.machine()}, "
        f"{os.cpu_count()} cores",
        "versions": f"mujoco {mujoco.__version__}, torch {torch.__version__}",
        "raw_rollout_steps_s": round(raw),
        "task_steps_s": round(task),
        "task_share_of_raw": round(task / raw, 3),
    }
    if not arguments.without_mjlab:
        other = mjlab_rate(arguments.mjlab_robots, arguments.seconds)
        result["mjlab_cpu_steps_s"] = round(other, 1)
        result["task_over_mjlab_cpu"] = round(task / other, 1)
    for name, value in result.items():
        print(f"{name:24} {value}")
    if arguments.json:
        arguments.json.write_text(json.dumps(result, indent=2) + "\n")


if __name__ == "__main__":
    main()
