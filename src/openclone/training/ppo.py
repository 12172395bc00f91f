"""PPO (rsl_rl) on the tracking task."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Any, Protocol

import torch
from rsl_rl.algorithms import PPO
from rsl_rl.models import MLPModel
from rsl_rl.modules.distribution import GaussianDistribution
from tensordict import TensorDict

from openclone.policy.linear import quicken
from openclone.policy.normalization import Normalization
from openclone.robot import g1
from openclone.training.distributed import team
from openclone.training.guard import NanGuard, Tensors
from openclone.training.progress import Progress
from openclone.training.storage import Rollouts
from openclone.training.tally import Tally
from openclone.training.task import StepResult, TrackingTask
from openclone.training.twins import bounded, compared, leaders


@dataclass(frozen=True)
class PpoConfig:
    """PPO settings. Few cores like small batches and a generous KL budget.

    Attributes:
        steps: control steps per robot and iteration.
        epochs, minibatches: passes over the data, pieces per pass.
        learning_rate: initial, of the actor; adapted to keep the KL divergence near
            ``kl``.
        critic_rate: learning rate of the critic, which has no divergence to keep and
            need not be as slow as a careful actor.
        slowest, fastest: learning rates at which an update may start.
        kl: target divergence per update.
        final_kl: the target at the end of the run, approached geometrically; None:
            the same.
        discount, trace: γ and λ.
        entropy: weight of the entropy bonus.
        initial_std: exploration noise at the start, units of action.
        final_std: bound on the noise at the end of the run, approached geometrically
            from ``initial_std``; None: the noise is only learned.
        twins: robots that begin each roll-out alike (`training.twins`); 1: none do.
        hidden: sizes of the MLPs' hidden layers.
    """

    steps: int = 16
    epochs: int = 4
    minibatches: int = 2
    learning_rate: float = 3e-4
    critic_rate: float = 5e-4
    slowest: float = 1e-4
    fastest: float = 1e-3
    kl: float = 0.05
    final_kl: float | None = None
    discount: float = 0.99
    trace: float = 0.95
    entropy: float = 0.003
    initial_std: float = 0.5
    final_std: float | None = None
    twins: int = 1
    hidden: tuple[int, ...] = (384, 256, 128)


class PpoEnvironment(Protocol):
    """What the loop needs: observations in groups, and a step."""

    num_envs: int

    @property
    def task(self) -> TrackingTask:
        """The robots behind it."""
        ...

    def observe(self) -> TensorDict:
        """Observation groups, batch size (n,)."""
        ...

    def step(self, action: torch.Tensor) -> StepResult:
        """Apply ``action (n, 29)`` for one control period."""
        ...

    def copy(self, sources: torch.Tensor) -> None:
        """Put every robot where robot ``sources (n,)[robot]`` is, with its past."""
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
    model.obs_normalizer = Normalization(model.obs_dim)
    quicken(model.mlp)
    if actor:
        last = [m for m in model.mlp.modules() if isinstance(m, torch.nn.Linear)][-1]
        with torch.no_grad():
            last.weight.mul_(0.01)
            last.bias.zero_()
    return model


class _TwoRates(torch.optim.Adam):
    """Adam in which the critic keeps its own learning rate.

    PPO sets one rate, the actor's, for all groups before each step.
    """

    def __init__(
        self, actor: torch.nn.Module, critic: torch.nn.Module, config: PpoConfig
    ) -> None:
        groups = [{"params": list(net.parameters())} for net in (actor, critic)]
        super().__init__(groups, lr=config.learning_rate, fused=True)
        self.critic_rate = config.critic_rate

    def step(self, closure: Any = None) -> Any:
        self.param_groups[1]["lr"] = self.critic_rate
        return super().step(closure)

    def load_state_dict(self, state_dict: dict[str, Any]) -> None:
        """Go on; checkpoints of before held actor and critic in one group."""
        groups = state_dict["param_groups"]
        if len(groups) == 1:
            count = len(self.param_groups[0]["params"])
            numbers = groups[0]["params"]
            parts = (numbers[:count], numbers[count:])
            groups = [{**groups[0], "params": part} for part in parts]
        super().load_state_dict({**state_dict, "param_groups": groups})


def build_ppo(
    example: TensorDict, actor: MLPModel, critic: MLPModel, config: PpoConfig
) -> PPO:
    """rsl_rl's PPO around ``actor`` and ``critic``; ``example`` sizes the storage."""
    storage = Rollouts(example, config.steps)
    ppo = PPO(
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
        # Returns span tens of units: within ±0.2 an update could change little.
        use_clipped_value_loss=False,
        device=storage.device,
        multi_gpu_cfg=team().ppo_settings,
    )
    ppo.optimizer = _TwoRates(actor, critic, config)
    return ppo


def fuse(optimizer: torch.optim.Optimizer) -> None:
    """Let Adam take its step in one pass; a loaded state brings other settings."""
    for group in optimizer.param_groups:
        group["fused"], group["foreach"] = True, None


def resume_ppo(ppo: PPO, content: dict[str, Any]) -> None:
    """Go on from what `PPO.save` returned."""
    ppo.load(content, None, strict=True)
    fuse(ppo.optimizer)


def _log_std(ppo: PPO) -> torch.Tensor:
    noise = ppo.get_policy().distribution
    assert isinstance(noise, GaussianDistribution)
    return noise.log_std_param


@torch.no_grad()
def renew_noise(ppo: PPO, config: PpoConfig) -> None:
    """Explore as at the start of a run; what has learned has little noise left."""
    _log_std(ppo).fill_(math.log(config.initial_std))


_SCHEDULE_STEPS = 20
"""Targets change in this many steps, so that wall time decides little."""


@torch.no_grad()
def settle(ppo: PPO, config: PpoConfig, share: float) -> None:
    """Small careful updates and little noise towards the end of a run.

    Args:
        ppo: the algorithm.
        config: where its settings begin and end.
        share: of the run that is over.
    """
    share = math.floor(_SCHEDULE_STEPS * share) / _SCHEDULE_STEPS
    if config.final_kl is not None:
        ppo.desired_kl = config.kl * (config.final_kl / config.kl) ** share
    if config.final_std is not None:
        bound = math.log(config.initial_std)
        bound += share * math.log(config.final_std / config.initial_std)
        _log_std(ppo).clamp_(max=bound)


AfterUpdate = Callable[[TensorDict], dict[str, float]]
"""Called with the newest observations after an update; returns values to log."""
_SHOWN = ("falls/1000", "error_mm", "reward", "std", "lr", "loss/value")


def learn(
    env: PpoEnvironment,
    ppo: PPO,
    config: PpoConfig,
    progress: Progress,
    every_line: Callable[[], None],
    after_update: tuple[AfterUpdate, ...] = (),
    line_seconds: float = 30.0,
) -> None:
    """Collect and update until the budget is spent, in all processes of the team.

    Args:
        env: the task.
        ppo: the algorithm, new or resumed.
        config: its settings.
        progress: receives values; says when to stop.
        every_line: called after each progress line, e.g. to save a checkpoint.
        after_update: what else learns or watches, e.g. AMP.
        line_seconds: seconds between lines.

    Raises:
        TrainingStopped: something is not finite; a dump lies beside the checkpoint.
    """
    ppo.train_mode()
    crew = team()
    crew.share_networks(ppo)
    networks = {"actor": ppo.actor, "critic": ppo.critic}
    guard = NanGuard(progress.folder, env.task, networks, lambda: _last_batch(ppo))
    tally = Tally(env.task)
    observations = env.observe()
    while not crew.agree(progress.finished):
        settle(ppo, config, progress.share)
        observations = collect(env, ppo, config, progress, tally, observations)
        guard.check_observations(_observed(ppo), progress.steps)
        losses = {f"loss/{name}": value for name, value in ppo.update().items()}
        for also in after_update:
            losses |= also(observations)
        guard.check(losses, progress.steps)
        crew.average_buffers(ppo.actor, ppo.critic)
        rate = min(max(ppo.learning_rate, config.slowest), config.fastest)
        ppo.learning_rate = rate
        progress.iterations += 1
        progress.add(
            **losses,
            lr=ppo.learning_rate,
            std=ppo.get_policy().output_std.mean().item(),
        )
        if progress.line(line_seconds, _SHOWN):
            every_line()


@torch.inference_mode()
def collect(
    env: PpoEnvironment,
    ppo: PPO,
    config: PpoConfig,
    progress: Progress,
    tally: Tally,
    observations: TensorDict,
) -> TensorDict:
    """Fill the storage with one roll-out; returns the newest observations.

    Raises:
        InputError: the robots cannot form groups of ``config.twins``.
    """
    if config.twins > 1:
        env.copy(leaders(env.num_envs, config.twins, env.task.device))
        observations = env.observe()
    for _ in range(config.steps):
        action = ppo.act(observations)
        result = env.step(action.clamp(-10, 10))
        observations = env.observe()
        # Nothing that was done before a push is to blame for what comes after it.
        cut = result.timed_out | result.pushed
        extras = {"time_outs": cut}
        ppo.process_env_step(observations, result.reward, result.done | cut, extras)
        progress.steps += env.num_envs * team().size
        tally.add(result)
    tally.report(progress)
    ppo.compute_returns(observations)
    if config.twins > 1:
        storage = ppo.storage
        gained = (storage.returns - storage.values)[..., 0]
        gained = compared(gained, storage.dones[..., 0] > 0, config.twins)
        storage.advantages = bounded(gained)[..., None]
    return observations


def _last_batch(ppo: PPO) -> Tensors:
    """The storage's tensors, (steps, n, ...)."""
    storage = ppo.storage
    names = ("actions", "rewards", "dones", "values", "returns", "advantages")
    batch = {name: getattr(storage, name) for name in names}
    groups = {f"observations/{k}": v for k, v in storage.observations.to_dict().items()}
    return {**batch, **groups}


def _observed(ppo: PPO) -> Iterable[torch.Tensor]:
    return ppo.storage.observations.to_dict().values()
