"""Control steps per second on a GPU, beside mjlab's tracking task.

The tracking task on MuJoCo Warp with the ``fast`` preset's rewards and the teacher's
observation, for 1024, 4096 and 8192 robots, and mjlab's G1 tracking task with as many.
Without a CUDA device it says so and measures 4 robots on Warp's CPU device instead,
which only shows that the path works.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import torch

from openclone.motion.sources.synthetic import default_set
from openclone.training.data import load_reference, make_task
from openclone.training.hardware import Hardware
from openclone.training.presets import TEACHERS

MJLAB_TASK = "Mjlab-Tracking-Flat-Unitree-G1"
ROBOTS = (1024, 4096, 8192)


def rate(step: Callable[[], None], robots: int, steps: int, device: str) -> float:
    """Control steps of one robot per second; three windows, the median."""

    def wait() -> None:
        if device.startswith("cuda"):
            torch.cuda.synchronize()

    for _ in range(5):
        step()
    rates = []
    for _ in range(3):
        wait()
        start = time.perf_counter()
        for _ in range(steps):
            step()
        wait()
        rates.append(steps * robots / (time.perf_counter() - start))
    return sorted(rates)[1]


def our_rate(robots: int, steps: int, device: str) -> float:
    """The tracking task with noisy actions."""
    hardware = Hardware("warp", device)
    reference = load_reference(default_set(0, 1.0), hardware)
    config = replace(TEACHERS["fast"].task, num_envs=robots)
    task = make_task(reference, config, 0, None, hardware)

    def step() -> None:
        action = 0.3 * torch.randn(robots, 29, device=task.device)
        task.step(task.residual_to_target(action))
        task.teacher_observation()

    with torch.inference_mode():
        return rate(step, robots, steps, device)


def mjlab_rate(robots: int, steps: int, device: str, motion: Path) -> float:
    """The tracking task of mjlab on ``motion``, with the same actions."""
    with contextlib.redirect_stdout(io.StringIO()):
        import mjlab.tasks.tracking.config.g1  # noqa: F401  (registers the task)
        from mjlab.envs import ManagerBasedRlEnv
        from mjlab.tasks.registry import load_env_cfg

        config = load_env_cfg(MJLAB_TASK)
        config.scene.num_envs = robots
        config.commands["motion"].motion_file = str(motion)
        env = ManagerBasedRlEnv(config, device=device)
        env.reset()
    size = env.action_manager.total_action_dim

    def step() -> None:
        env.step(0.3 * torch.randn(robots, size, device=device))

    result = rate(step, robots, steps, device)
    env.close()
    return result


def measured(steps: int, device: str, motion: Path | None) -> dict[str, object]:
    """Rates for every number of robots, and their ratios."""
    figures: dict[str, object] = {"device": torch.cuda.get_device_name(device)}
    for robots in ROBOTS:
        ours = our_rate(robots, steps, device)
        figures[f"openclone_{robots}_steps_s"] = round(ours)
        print(f"{robots} robots: {ours:.0f} control steps/s", flush=True)
        if motion is not None:
            other = mjlab_rate(robots, steps, device, motion)
            figures[f"mjlab_{robots}_steps_s"] = round(other)
            figures[f"over_mjlab_{robots}"] = round(ours / other, 2)
            print(f"  mjlab {other:.0f}, ratio {ours / other:.2f}", flush=True)
    if motion is None:
        print("mjlab's tracking task needs a motion file of its own: --motion FILE.npz")
    return figures


def main() -> None:
    """Measure, print, and write JSON if asked."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", default="cuda:0")
    parser.add_argument("--steps", type=int, default=50, help="per window")
    parser.add_argument(
        "--motion", type=Path, help="for mjlab, as its csv_to_npz makes"
    )
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    if torch.cuda.is_available():
        result = measured(arguments.steps, arguments.device, arguments.motion)
    else:
        print(f"no CUDA device (PyTorch {torch.__version__}): no GPU rate was measured")
        few = our_rate(4, 3, "cpu")
        print(f"MuJoCo Warp on the CPU device, 4 robots: {few:.0f} control steps/s")
        result = {"device": "none", "warp_cpu_4_steps_s": round(few)}
    if arguments.json:
        arguments.json.write_text(json.dumps(result, indent=2) + "\n")


if __name__ == "__main__":
    main()
