"""The teacher's first lesson: it copies linear feedback on its own roll-outs.

PPO from nothing does not find the first step of a walk: standing pays until the command
is out of reach. Feedback (`training.feedback`) takes it untrained, but sees all of the
motion and answers from a table; what the teacher sees tells it most of that. Labels for
the states into which the learner itself comes are DAgger (Ross et al. 2011).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import torch
from rsl_rl.models import MLPModel
from tensordict import TensorDict
from torch import nn

from openclone.robot import g1
from openclone.training.distributed import team
from openclone.training.guard import NanGuard
from openclone.training.progress import Progress
from openclone.training.tally import Tally
from openclone.training.task import TrackingTask

_UNIT = 0.45
"""Radians; typical action scale, makes the loss comparable to actions squared."""
_KNEE = 0.1
"""Actions; smaller errors count by their squares, larger ones by their size.

A tenth of the samples made more than half of the squared errors.
"""
_RATE_STEPS = 20
"""The learning rate falls in this many steps, so that wall time decides little."""
_SHOWN = ("falls/1000", "error_mm", "reward", "gap", "loss/imitation")


def action_weight(task: TrackingTask) -> torch.Tensor:
    """What errors of actions count, joint by joint, ``(29,)``."""
    return task.action_scale / _UNIT


def imitation_loss(error: torch.Tensor) -> torch.Tensor:
    """Mean L2 norm (as OmniH2O) of weighted errors of actions ``(n, 29)``."""
    return (error.square().sum(-1) + _KNEE**2).sqrt().mean()


def slow_down(optimizer: torch.optim.Optimizer, rate: float, over: float) -> None:
    """Let the learning rate fall from ``rate`` to a fifth of it.

    Args:
        optimizer: to be changed.
        rate: at the start of the run.
        over: share of the run that is over, 0 to 1; all processes take the leader's.
    """
    over = math.floor(_RATE_STEPS * team().same(over)) / _RATE_STEPS
    for group in optimizer.param_groups:
        group["lr"] = rate * (1.0 - 0.8 * over)


@dataclass(frozen=True)
class ImitationConfig:
    """Settings of the copy.

    Attributes:
        minutes: wall time.
        iterations: rounds, if they end it instead.
        steps: control steps per robot and round.
        kept_rounds: rounds whose data stay in the buffer.
        updates, batch: gradient steps a round, samples a step.
        learning_rate: Adam's at the start; falls to a fifth at the end.
        led_rounds: rounds over which control passes from feedback to the learner.
        noise: spread of the actions of every other robot, which so learns to recover.
        max_grad_norm: gradient clipping.
    """

    minutes: float = 4.0
    iterations: int | None = None
    steps: int = 20
    kept_rounds: int = 100
    updates: int = 16
    batch: int = 4096
    learning_rate: float = 1e-3
    led_rounds: int = 30
    noise: float = 0.1
    max_grad_norm: float = 0.5


class Imitation:
    """The learner acts; feedback says what it would have done."""

    def __init__(
        self,
        task: TrackingTask,
        actor: MLPModel,
        group: str,
        config: ImitationConfig,
        progress: Progress,
    ) -> None:
        """Start with an empty buffer.

        Args:
            task: with feedback gains.
            actor: the learner.
            group: the observation that it reads.
            config: settings.
            progress: of the run, which names the folder for a dump if it breaks.
        """
        self.task, self.actor, self.config = task, actor, config
        self.progress, self._group = progress, group
        self.rounds = 0
        self.optimizer = torch.optim.Adam(actor.mlp.parameters(), config.learning_rate)
        shape = (config.kept_rounds, config.steps, task.num_envs)
        seen = task.teacher_observation()
        self._seen = seen.new_zeros(*shape, seen.shape[1])
        self._labels = seen.new_zeros(*shape, g1.NUM_JOINTS)
        self._weight = action_weight(task)
        odd = torch.arange(task.num_envs, device=task.device) % 2
        self._noise = config.noise * odd[:, None].to(seen)
        self._tally = Tally(task)
        self._guard = NanGuard(progress.folder, task, {"actor": actor}, self._newest)

    def _newest(self) -> dict[str, torch.Tensor]:
        place = (self.rounds - 1) % self.config.kept_rounds
        return {"seen": self._seen[place], "labels": self._labels[place]}

    @torch.no_grad()
    def collect(self) -> None:
        """One round of roll-outs; the share of feedback in control falls to zero."""
        task, place = self.task, self.rounds % self.config.kept_rounds
        share = max(0.0, 1.0 - self.rounds / self.config.led_rounds)
        self.actor.train()
        for step in range(self.config.steps):
            seen, label = task.teacher_observation(), task.feedback_action()
            groups = TensorDict({self._group: seen}, batch_size=[task.num_envs])
            self.actor.update_normalization(groups)
            own = self.actor(groups)
            self._seen[place, step], self._labels[place, step] = seen, label
            led = torch.rand_like(own[:, :1]) < share
            action = torch.where(led, label, own)
            action = action + self._noise * torch.randn_like(action)
            result = task.step(task.residual_to_target(action))
            self.progress.steps += task.num_envs * team().size
            gap = (self._weight * (own - label)).abs().mean()
            self._tally.add(result, gap=gap)
        self.rounds += 1
        self._tally.report(self.progress)
        team().average_buffers(self.actor)
        self._guard.check_observations(self._newest().values(), self.progress.steps)

    def update(self) -> None:
        """Gradient steps on the buffer."""
        config, network = self.config, self.actor.mlp
        slow_down(self.optimizer, config.learning_rate, self.progress.share)
        filled = min(self.rounds, config.kept_rounds)
        seen = self._seen[:filled].flatten(0, 2)
        labels = self._labels[:filled].flatten(0, 2)
        losses: dict[str, float] = {}
        for _ in range(config.updates):
            drawn = torch.randint(len(seen), (config.batch,), device=seen.device)
            own = network(self.actor.obs_normalizer(seen[drawn]))
            loss = imitation_loss(self._weight * (own - labels[drawn]))
            self.optimizer.zero_grad()
            loss.backward()
            team().average_gradients(network)
            nn.utils.clip_grad_norm_(network.parameters(), config.max_grad_norm)
            self.optimizer.step()
            losses = {"loss/imitation": loss.item()}
            self.progress.add(**losses)
        self._guard.check(losses, self.progress.steps)
        self.progress.iterations += 1


def imitate(
    imitation: Imitation, every_line: Callable[[], None], line_seconds: float = 30.0
) -> None:
    """Copy until the budget is spent, in all processes of the team.

    Args:
        imitation: new; its progress says when to stop.
        every_line: called after each progress line, e.g. to save a checkpoint.
        line_seconds: seconds between lines.

    Raises:
        TrainingStopped: something is not finite; a dump lies beside the checkpoint.
    """
    progress = imitation.progress
    team().share(imitation.actor)
    while not team().agree(progress.finished):
        imitation.collect()
        imitation.update()
        if progress.line(line_seconds, _SHOWN):
            every_line()
