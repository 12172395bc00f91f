"""PPO (rsl_rl) on the tracking task: one loop for teacher and student."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import torch
from rsl_rl.algorithms import PPO
from rsl_rl.models import MLPModel
from rsl_rl.storage import RolloutStorage
from tensordict import TensorDict

from openclone.robot import g1
from openclone.training.progress import Progress
from openclone.training.task import StepResult


@dataclass(frozen=True)
class PpoConfig:
    """PPO settings. Few cores like small batches and a generous KL budget.

    Attributes:
        steps: control steps per robot and iteration.
        epochs, minibatches: passes over the data, pieces per pass.
        learning_rate: initial; adapted to keep the KL divergence near ``kl``.
        slowest, fastest: learning rates at which an update may start.
        kl: target divergence per update.
        discount, trace: γ and λ.
        entropy: weight of the entropy bonus.
        initial_std: exploration noise at the start, units of action.
        hidden: sizes of the MLPs' hidden layers.
    """

    steps: int = 16
    epochs: int = 4
    minibatches: int = 2
    learning_rate: float = 3e-4
    slowest: float = 1e-4
    fastest: float = 1e-3
    kl: float = 0.05
    discount: float = 0.99
    trace: float = 0.95
    entropy: float = 0.003
    initial_std: float = 0.5
    hidden: tuple[int, ...] = (384, 256, 128)


class PpoEnvironment(Protocol):
    """What the loop needs: observations in groups, and a step."""

    num_envs: int

    def observe(self) -> TensorDict:
        """Observation groups, batch size (n,)."""
        ...

    def step(self, action: torch.Tensor) -> StepResult:
        """Apply ``action (n, 29)`` for one control period."""
        ...


def mlp_model(
    example: TensorDict, group: str, outputs: int, config: PpoConfig
) -> MLPModel:
    """An rsl_rl MLP on observation ``group``; a Gaussian actor if it has 29 outputs."""
    actor = outputs == g1.NUM_JOINTS
    distribution = {
        "class_name": "GaussianDistribution",
        "init_std": config.initial_std,
        "std_type": "log",
    }
    model = MLPModel(
        example,
        {"set": [group]},
        "set",
        outputs,
        hidden_dims=config.hidden,
        activation="elu",
        obs_normalization=True,
        distribution_cfg=distribution if actor else None,
    )
    if actor:
        last = [m for m in model.mlp.modules() if isinstance(m, torch.nn.Linear)][-1]
        with torch.no_grad():
            last.weight.mul_(0.01)
            last.bias.zero_()
    return model


def build_ppo(
    example: TensorDict, actor: MLPModel, critic: MLPModel, config: PpoConfig
) -> PPO:
    """rsl_rl's PPO around ``actor`` and ``critic``; ``example`` sizes the storage."""
    storage = RolloutStorage(
        "rl", example.batch_size[0], config.steps, example, [g1.NUM_JOINTS], "cpu"
    )
    return PPO(
        actor,
        critic,
        storage,
        num_learning_epochs=config.epochs,
        num_mini_batches=config.minibatches,
        gamma=config.discount,
        lam=config.trace,
        entropy_coef=config.entropy,
        learning_rate=config.learning_rate,
        desired_kl=config.kl,
    )


def learn(
    env: PpoEnvironment,
    ppo: PPO,
    config: PpoConfig,
    progress: Progress,
    every_line: Callable[[], None],
    line_seconds: float = 30.0,
) -> None:
    """Collect and update until the time is over.

    Args:
        env: the task.
        ppo: the algorithm, new or resumed.
        config: its settings.
        progress: receives values; says when to stop.
        every_line: called after each progress line, e.g. to save a checkpoint.
        line_seconds: seconds between lines.
    """
    ppo.train_mode()
    observations = env.observe()
    while not progress.finished:
        with torch.inference_mode():
            for _ in range(config.steps):
                action = ppo.act(observations)
                result = env.step(action.clamp(-10, 10))
                observations = env.observe()
                ppo.process_env_step(
                    observations,
                    result.reward,
                    result.done,
                    {"time_outs": result.timed_out},
                )
                progress.steps += env.num_envs
                note_step(progress, result)
            ppo.compute_returns(observations)
        losses = ppo.update()
        rate = min(max(ppo.learning_rate, config.slowest), config.fastest)
        ppo.learning_rate = rate
        progress.add(
            **{f"loss/{name}": value for name, value in losses.items()},
            lr=ppo.learning_rate,
            std=ppo.get_policy().output_std.mean().item(),
        )
        shown = ("falls/1000", "error_mm", "reward", "std", "lr", "loss/value")
        if progress.line(line_seconds, shown):
            every_line()


def note_step(progress: Progress, result: StepResult) -> None:
    """Add a step's reward terms, terminations per 1000 steps and body error."""
    terms = {f"reward/{name}": value for name, value in result.terms.items()}
    progress.add(
        **{
            "falls/1000": 1000 * float(result.terminated.float().mean()),
            "error_mm": 1000 * result.error,
            "reward": float(result.reward.mean()) / 0.02,
        },
        **terms,
    )
