"""Distilling the student from the teacher: DAgger with the balance loss (Eq. 1)."""

from __future__ import annotations

import copy
from pathlib import Path

import numpy as np
import torch
from rsl_rl.models import MLPModel
from tensordict import TensorDict
from torch import nn

from openclone.policy.moe import balance_loss
from openclone.policy.student import StudentModel
from openclone.training.demonstrations import Demonstrations
from openclone.training.distributed import team
from openclone.training.guard import NanGuard
from openclone.training.imitation import action_weight, imitation_loss, slow_down
from openclone.training.presets import DistillationConfig
from openclone.training.progress import Progress
from openclone.training.student_view import StudentView
from openclone.training.tally import Tally
from openclone.training.teacher_view import GROUP as TEACHER


def router_usage(routing: list[torch.Tensor]) -> dict[str, float]:
    """Mean routing weight of every expert, for the log; none without experts."""
    return {
        f"router/layer{layer}/expert{expert}": float(share)
        for layer, weights in enumerate(routing, 1)
        for expert, share in enumerate(weights.detach().mean(0), 1)
    }


class Dagger:
    """The student acts; the teacher says what it would have done."""

    def __init__(
        self,
        view: StudentView,
        teacher: MLPModel,
        student: StudentModel,
        config: DistillationConfig,
        rng: np.random.Generator,
        folder: Path,
    ) -> None:
        """Start with an empty buffer; ``folder`` takes a dump if training breaks."""
        self.view, self.teacher, self.student = view, teacher, student
        self.config = config
        self.rounds = 0
        self.optimizer = torch.optim.Adam(
            student.mlp.parameters(), config.learning_rate
        )
        self.average = copy.deepcopy(student.mlp).requires_grad_(False)
        self.averaged_steps = 0
        self.demonstrations = Demonstrations(
            config.kept_rounds, config.steps, view.observe(), rng
        )
        self._rng = rng
        networks, dump = {"student": student.mlp}, self.demonstrations.newest
        self._guard = NanGuard(folder, view.task, networks, dump)
        self._weight = action_weight(view.task)
        self._tally = Tally(view.task)

    def label(self) -> torch.Tensor:
        """The teacher's joint targets as student actions, ``(n, 29)``."""
        task = self.view.task
        group = TensorDict(
            {TEACHER: task.teacher_observation()}, batch_size=[task.num_envs]
        )
        return self.view.to_action(task.residual_to_target(self.teacher(group)))

    @torch.no_grad()
    def collect(self, progress: Progress) -> None:
        """One round of roll-outs; the teacher's share of control falls to zero."""
        share = max(0.0, 1.0 - self.rounds / self.config.teacher_share_rounds)
        self.student.train()
        count, device = self.view.task.num_envs, self.view.task.device
        for _ in range(self.config.steps):
            inputs, label = self.view.observe(), self.label()
            self.student.obs_normalizer.update(inputs)  # type: ignore[operator]
            own = self.student.mean_action(inputs)
            by_teacher = torch.from_numpy(self._rng.random((count, 1)) < share)
            action = torch.where(by_teacher.to(device), label, own)
            result = self.view.step(action)
            self.demonstrations.add(inputs, label, result.ended.to(device))
            progress.steps += count * team().size
            self._tally.add(result, gap=(self._weight * (own - label)).abs().mean())
        self._tally.report(progress)
        team().average_buffers(self.student.obs_normalizer)
        newest = self.demonstrations.newest().values()
        self._guard.check_observations(newest, progress.steps)
        self.rounds += 1

    def update(self, progress: Progress) -> None:
        """Gradient steps on the buffer: mean L2 norm (as OmniH2O) plus Eq. 1."""
        config = self.config
        slow_down(self.optimizer, config.learning_rate, progress.share)
        losses: dict[str, float] = {}
        for _ in range(config.updates):
            inputs, labels = self.demonstrations.draw(config.batch)
            own, routing = self.student.with_routing(inputs)
            imitation = imitation_loss(self._weight * (own - labels))
            balance = balance_loss(routing)
            loss = imitation + config.balance * balance
            self.optimizer.zero_grad()
            loss.backward()
            team().average_gradients(self.student.mlp)
            nn.utils.clip_grad_norm_(
                self.student.mlp.parameters(), config.max_grad_norm
            )
            self.optimizer.step()
            self._average()
            losses = {
                "loss/imitation": imitation.item(),
                "loss/balance": balance.item(),
            }
            progress.add(**losses, **router_usage(routing))
        self._guard.check(losses, progress.steps)
        progress.iterations += 1

    @torch.no_grad()
    def _average(self) -> None:
        """Moving average of the weights: what is shipped forgets less than the newest.

        The first steps weigh more, so that a new network is not averaged with noise.
        """
        self.averaged_steps += 1
        n = self.averaged_steps
        keep = min(self.config.average, (1.0 + n) / (10.0 + n))
        newest = self.student.mlp.parameters()
        for old, new in zip(self.average.parameters(), newest, strict=True):
            old.lerp_(new, 1.0 - keep)


def distill(dagger: Dagger, progress: Progress) -> None:
    """One round of DAgger: collect, then learn."""
    dagger.collect(progress)
    dagger.update(progress)
