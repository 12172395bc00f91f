"""What PPO's advantages are made of: critic's errors, exploration, and with twins.

The shipped teacher explores the default motions from the same seed in four ways: hardly
at all, as in training, and in groups of 2 and 4 twins (`training.twins`). Printed are
the variance of its advantages and how far the policy gradients of single roll-outs
agree: the mean product of two of them by their mean square, 1 if all are the same and 0
if they are noise.
"""

from __future__ import annotations

import argparse
import json
import math
import platform
import tempfile
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import torch
from rsl_rl.algorithms import PPO

from openclone.motion.sources.synthetic import default_set
from openclone.training.ppo import collect
from openclone.training.presets import TEACHERS, TeacherPreset
from openclone.training.progress import Budget, Progress
from openclone.training.tally import Tally
from openclone.training.teacher import TeacherTrainer
from openclone.training.teacher_view import GROUP, TeacherEnvironment
from openclone.training.twins import bounded, compared

SHIPPED = Path(str(files("openclone") / "weights" / "teacher.pt"))
WAYS = {
    "hardly any": (1e-3, 1),
    "exploration": (0.11, 1),
    "2 twins": (0.11, 2),
    "4 twins": (0.11, 4),
}
"""Exploration noise and robots that begin alike."""
_FIRST = 10
"""Roll-outs until robots are in the midst of their episodes."""


def preset_for(robots: int, std: float, twins: int) -> TeacherPreset:
    """The shipped teacher's preset, with one roll-out of ``robots`` robots."""
    preset = TEACHERS["fast"]
    ppo = replace(preset.ppo, initial_std=std, final_std=None, twins=twins)
    return replace(preset, ppo=ppo, task=replace(preset.task, num_envs=robots))


def explored(
    teacher: Path, robots: int, roll_outs: int, std: float, twins: int, minutes: float
) -> dict[str, float]:
    """Variance of the advantages, and agreement of the gradients."""
    preset = preset_for(robots, std, twins)
    trainer = TeacherTrainer(default_set(0, minutes), preset, 0, None)
    trainer.begin(teacher)
    ppo = trainer.ppo
    env = TeacherEnvironment(trainer.task, preset.guess_errors, 0)
    seen, variances, gradients = env.observe(), [], []
    with tempfile.TemporaryDirectory() as folder:
        progress = Progress(Path(folder), Budget(math.inf))
        tally = Tally(env.task)
        for index in range(_FIRST + roll_outs):
            seen = collect(env, ppo, preset.ppo, progress, tally, seen)
            storage = ppo.storage
            if index >= _FIRST:
                gained = (storage.returns - storage.values)[..., 0]
                if twins > 1:
                    done = storage.dones[..., 0] > 0
                    gained = compared(gained, done, twins)
                variances.append(float(gained.var()))
                gradients.append(gradient(ppo, bounded(gained), std))
            storage.clear()
        progress.close()
    together = torch.stack(gradients)
    squares = together.square().sum()
    products = together.sum(0).square().sum() - squares
    count = len(gradients)
    agreement = products / (count - 1) / squares
    return {
        "variance": sum(variances) / count,
        "agreement": float(agreement),
    }


def gradient(ppo: PPO, advantages: torch.Tensor, std: float) -> torch.Tensor:
    """The policy gradient of one roll-out, all parameters in a row."""
    storage = ppo.storage
    seen = storage.observations.flatten(0, 1).clone()
    actions = storage.actions.flatten(0, 1).clone()
    mean = ppo.actor(seen.select(GROUP))
    score = (actions - mean.detach()) / std**2
    gain = (advantages.flatten().clone()[:, None] * score * mean).sum(-1).mean()
    parts = torch.autograd.grad(gain, list(ppo.actor.mlp.parameters()))
    return torch.cat([part.flatten() for part in parts])


def main() -> None:
    """Measure all four ways and print them."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--teacher", type=Path, default=SHIPPED)
    parser.add_argument("--robots", type=int, default=512)
    parser.add_argument("--roll-outs", type=int, default=40)
    parser.add_argument("--minutes", type=float, default=5.0, help="of motions")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    print(f"{platform.machine()}, Python {platform.python_version()}, ", end="")
    print(f"PyTorch {torch.__version__}, {options.robots} robots")
    found = {}
    for name, (std, twins) in WAYS.items():
        found[name] = explored(
            options.teacher,
            options.robots,
            options.roll_outs,
            std,
            twins,
            options.minutes,
        )
        values = "  ".join(f"{key} {value:.4f}" for key, value in found[name].items())
        print(f"{name:12s} {values}", flush=True)
    most = found["exploration"]["variance"]
    ratios = {name: row["variance"] / most for name, row in found.items()}
    print("variance by that with exploration alone: ", end="")
    print(", ".join(f"{name} {ratio:.2f}" for name, ratio in ratios.items()))
    if options.json:
        options.json.write_text(json.dumps(found, indent=2))


if __name__ == "__main__":
    main()
