"""Value gradients: how the return of real roll-outs changes with a policy's weights.

PPO learns from chance: hardly any of an advantage's variance comes from the action. A
world model tells instead how every action changes what follows. The simulation's own
states keep the roll-out true; only their derivatives are the model's (SVG(∞), Heess et
al. 2015; with a critic at the end as in SHAC, Xu et al. 2022). Gradients of two
roll-outs of 128 robots agree by 0.3, where those of PPO with 512 agree by 0.02.
"""

from __future__ import annotations

import copy
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from rsl_rl.models import MLPModel
from torch import nn

from openclone.errors import InputError
from openclone.robot.model import CONTROL_PERIOD
from openclone.robot.state import RobotState
from openclone.training.body_tree import BodyTree, as_sensed, without_value
from openclone.training.distributed import team
from openclone.training.guard import NanGuard, Tensors
from openclone.training.guidance import guided
from openclone.training.muon import Muon
from openclone.training.pilots import Moment, Pilot, smooth
from openclone.training.progress import Progress
from openclone.training.reward_table import total_reward
from openclone.training.rewards import TrackingState
from openclone.training.tally import Tally
from openclone.training.terrain import build_training_model
from openclone.training.windows import Window, each, roll_out
from openclone.training.world_model import WorldLearner, WorldModel

SHOWN = ("falls/1000", "error_mm", "reward", "return", "loss/value", "loss/world")
"""Values for a line of progress."""


@dataclass(frozen=True)
class ValueGradientConfig:
    """Settings of value gradients.

    Attributes:
        steps: control steps of a roll-out T.
        std: exploration noise, units of action, from which the world model learns.
        rate, final_rate: step of each weight, `Muon`, at the beginning and at the end.
        momentum: of these steps.
        average: share of the old weights in their moving average; that is what
            bundle or teacher hold.
        bound: largest gradient of one robot's return with respect to one of its states.
        discount, trace: γ and λ.
        critic_rate: learning rate of the critic.
        warm_up: roll-outs for world model and critic alone before the first step.
        warm_up_updates: gradient steps of the world model after each of them.
        width: hidden units of the world model.
        world_rate, world_updates, world_batch: its learning rate (twice that in the
            warm-up), gradient steps per roll-out, samples a step.
        kept: transitions that it learns from.
    """

    steps: int = 24
    std: float = 0.06
    rate: float = 8e-5
    final_rate: float = 1.2e-5
    momentum: float = 0.9
    average: float = 0.97
    bound: float = 100.0
    discount: float = 0.99
    trace: float = 0.95
    critic_rate: float = 3e-4
    warm_up: int = 20
    warm_up_updates: int = 24
    width: int = 512
    world_rate: float = 5e-4
    world_updates: int = 6
    world_batch: int = 1024
    kept: int = 400_000


class Tuner:
    """Policy, critic and world model, and how they learn from roll-outs."""

    def __init__(
        self,
        pilot: Pilot,
        critic: MLPModel,
        config: ValueGradientConfig,
        seed: int,
        folder: Path,
    ) -> None:
        """Prepare tuning of ``pilot``.

        Raises:
            InputError: the ground is not flat; the world model knows no other.
        """
        if pilot.task.config.randomization.terrain != ("flat",):
            raise InputError(
                "value gradients need flat ground",
                remedy="tune with a task whose `terrain` is ('flat',)",
            )
        self.pilot, self.critic = pilot, smooth(critic)
        self.config, device = config, pilot.task.device
        self.tree = BodyTree(build_training_model(), device)
        world = WorldModel(self.tree, config.width).to(device)
        self.learner = WorldLearner(world, config.kept, config.world_batch, seed)
        self._random = torch.Generator(device).manual_seed(seed)
        self._parameters = [p for p in pilot.network.parameters() if p.requires_grad]
        self._muon = Muon(self._parameters, config.rate, config.momentum)
        self._adam = torch.optim.Adam(critic.mlp.parameters(), config.critic_rate)
        self.average = copy.deepcopy(pilot.network)
        networks = {"policy": pilot.network, "critic": critic, "world": world}
        self._newest: Tensors = {}
        self._guard = NanGuard(folder, pilot.task, networks, lambda: self._newest)
        self._tally = Tally(pilot.task)
        self.warm = 0

    def act(self) -> Window:
        """One roll-out."""
        config, random = self.config, self._random
        return roll_out(self.pilot, config.steps, config.std, random, self._tally)

    def round(self, progress: Progress) -> None:
        """One roll-out, and what all three learn from it."""
        window = self.act()
        self._newest = {"action": window.action, "past": window.past}
        self._guard.check_observations(self._newest.values(), progress.steps)
        progress.steps += window.reward.numel() * team().size
        self._tally.report(progress)
        losses = {
            "loss/world": self.learn_physics(window),
            "loss/value": self._learn_value(window),
        }
        if self.warm < self.config.warm_up:
            self.warm += 1
        else:
            losses |= self._improve(window, progress.share)
            progress.iterations += 1
        self._guard.check(losses, progress.steps)
        progress.add(**losses)

    def learn_physics(self, window: Window) -> float:
        """Teach the world model what happened in ``window``; its loss."""
        straight = ~window.cut.flatten()
        parts = (
            window.qpos[:-1],
            window.qvel[:-1],
            window.targets,
            window.qpos[1:],
            window.qvel[1:],
        )
        found = torch.cat([part.flatten(0, 1)[straight] for part in parts], 1)
        self.learner.add(found)
        config = self.config
        if self.warm < config.warm_up:
            return self.learner.learn(config.warm_up_updates, 2 * config.world_rate)
        return self.learner.learn(config.world_updates, config.world_rate)

    def value(self, privileged: torch.Tensor) -> torch.Tensor:
        """What the critic expects, ``(n, d) -> (n,)``."""
        critic = self.critic
        return critic.mlp(critic.obs_normalizer(privileged))[:, 0]

    def _learn_value(self, window: Window) -> float:
        returns = self._returns(window)
        seen = window.privileged[:-1].flatten(0, 1)
        total, wanted = 0.0, returns.flatten()
        order = torch.randperm(len(seen), generator=self._random, device=seen.device)
        parts = order.chunk(4)
        for rows in parts:
            loss = (self.value(seen[rows]) - wanted[rows]).square().mean()
            self._adam.zero_grad()
            loss.backward()
            team().average_gradients(self.critic.mlp)
            nn.utils.clip_grad_norm_(self.critic.mlp.parameters(), 1.0)
            self._adam.step()
            total += loss.item()
        return total / len(parts)

    @torch.no_grad()
    def _returns(self, window: Window) -> torch.Tensor:
        """TD(λ) returns, ``(T, n)``."""
        config = self.config
        flat = window.privileged.flatten(0, 1)
        values = self.value(flat).view(window.frame.shape)
        returns, ahead = torch.empty_like(window.reward), torch.zeros_like(values[0])
        for step in reversed(range(config.steps)):
            cut = window.cut[step]
            # Where the roll-out goes on elsewhere, all was as good as just before.
            following = torch.where(cut, values[step], values[step + 1])
            following = following * ~window.terminated[step]
            error = window.reward[step] + config.discount * following - values[step]
            ahead = error + config.discount * config.trace * ahead * ~cut
            returns[step] = values[step] + ahead
        return returns

    def _improve(self, window: Window, share: float) -> dict[str, float]:
        config = self.config
        self._muon.zero_grad()
        gained = Repetition(self, window).gain()
        (-gained).backward()
        for param in self._parameters:
            if param.grad is not None:
                param.grad.nan_to_num_()
        team().average_gradients(self.pilot.network)
        size = nn.utils.get_total_norm(
            [p.grad for p in self._parameters if p.grad is not None]
        )
        rate = config.rate * (config.final_rate / config.rate) ** share
        for group in self._muon.param_groups:
            group["lr"] = rate
        self._muon.step()
        with torch.no_grad():
            newest = self.pilot.network.parameters()
            for old, new in zip(self.average.parameters(), newest, strict=True):
                old.lerp_(new, 1.0 - config.average)
        return {"return": gained.item(), "gradient": size.item(), "lr": rate}

    def state_dict(self) -> dict[str, Any]:
        """What a checkpoint holds beside the policy."""
        return {
            "average": self.average.state_dict(),
            "muon": self._muon.state_dict(),
            "critic": self.critic.state_dict(),
            "adam": self._adam.state_dict(),
            "world": self.learner.state_dict(),
        }

    def load_state_dict(self, content: dict[str, Any]) -> None:
        """Go on from `state_dict`; the policy comes from elsewhere."""
        self.average.load_state_dict(content["average"])
        self._muon.load_state_dict(content["muon"])
        self.critic.load_state_dict(content["critic"])
        self._adam.load_state_dict(content["adam"])
        self.learner.load_state_dict(content["world"])


class Repetition:
    """A roll-out once more, with its values and with gradients."""

    def __init__(self, tuner: Tuner, window: Window) -> None:
        """Begin where ``window`` began."""
        self._tuner, self._window = tuner, window
        self._task = tuner.pilot.task
        self._qpos, self._qvel = window.qpos[0], window.qvel[0]
        self._place(0)
        self._task_action = window.task_action[0]
        self._recall = tuner.pilot.recall(window.past)

    def _place(self, step: int) -> None:
        """Bodies where they are before ``step``, and as they are sensed."""
        self._bodies = self._tuner.tree(self._qpos, self._qvel)
        self._robot = as_sensed(self._bodies, self._window.sensed_at(step))

    def gain(self) -> torch.Tensor:
        """Mean return of the robots, bootstrapped by the critic: a scalar.

        A roll-out that goes on elsewhere counts as two.
        """
        window, config = self._window, self._tuner.config
        total = window.reward.new_zeros(())
        weight = torch.ones_like(window.reward[0])
        for step in range(config.steps):
            cut = window.cut[step]
            leaving = torch.nonzero(cut)[:, 0]
            if len(leaving):
                value = self._value(step, leaving)
                total = total + (weight[leaving] * value).sum()
            reward = self._step(step)
            total = total + (weight * reward * ~cut).sum()
            weight = torch.where(cut, torch.ones_like(weight), config.discount * weight)
        everyone = torch.arange(len(weight), device=weight.device)
        total = total + (weight * self._value(config.steps, everyone)).sum()
        return total / len(weight)

    def _value(self, step: int, robots: torch.Tensor) -> torch.Tensor:
        """What the critic expects of ``robots`` from ``step`` on."""
        seen = self._task.observe_reference(
            each(self._robot, lambda part: part[robots]),
            self._window.frame[step, robots],
            self._task_action[robots],
        )
        return self._tuner.value(seen)

    def _act(self, step: int, reference: RobotState) -> torch.Tensor:
        """What the policy did, with the gradients of what it would do."""
        window = self._window
        moment = Moment(
            robot=self._robot,
            reference=reference,
            frame=window.frame[step],
            look=window.look[step],
            action=self._task_action,
            error=window.error[step],
        )
        return window.action[step] + without_value(self._recall.act(moment))

    def _base(self, step: int, reference: RobotState) -> torch.Tensor:
        """Targets of the task's guidance, with the gradients of where robots are."""
        task = self._task
        ahead = task.reference.feedforward[self._window.frame[step]]
        found = guided(task.config.guidance, self._robot, reference, ahead)
        return self._window.base[step] + without_value(found)

    def _step(self, step: int) -> torch.Tensor:
        """Act, and go where the robots went; the rewards, ``(n,)``."""
        window, task = self._window, self._task
        reference = task.reference.at(window.frame[step])
        own = self._act(step, reference)
        base = self._base(step, reference)
        targets = self._tuner.pilot.to_target(own, base)
        action = (targets - base) / task.action_scale
        foreseen = self._tuner.learner.model(
            self._qpos, self._qvel, targets, self._bodies
        )
        live = ~window.cut[step][:, None]
        before, previous = self._qvel, self._task_action
        self._qpos, self._qvel = (
            self._went(real, found, live)
            for real, found in zip(
                (window.qpos[step + 1], window.qvel[step + 1]), foreseen, strict=True
            )
        )
        self._task_action = window.task_action[step + 1] + without_value(action) * live
        self._place(step + 1)
        born = window.ended[step]
        own = window.action[step] * ~born[:, None] + without_value(own) * live
        self._recall.went(self._robot, own, torch.nonzero(born)[:, 0])
        idle = torch.zeros_like(window.cut[step])
        tracking = TrackingState(
            robot=self._robot,
            reference=reference,
            action=action,
            previous_action=previous,
            previous_velocities=before[:, 6:],
            terminated=idle,
            air_time=window.reward.new_zeros(len(idle), 2),
            style=window.reward.new_zeros(len(idle)),
            period=CONTROL_PERIOD,
        )
        return total_reward(tracking, task.config.weights)[0] * CONTROL_PERIOD

    def _went(
        self, real: torch.Tensor, foreseen: torch.Tensor, live: torch.Tensor
    ) -> torch.Tensor:
        """The values of ``real``, and bounded gradients of ``foreseen`` where live."""
        moving = without_value(foreseen) * live
        bound = self._tuner.config.bound / len(real)

        def bounded(slope: torch.Tensor) -> torch.Tensor:
            slope = slope.nan_to_num()
            return slope * (bound / slope.norm(dim=1, keepdim=True).clamp(min=bound))

        if moving.requires_grad:
            moving.register_hook(bounded)
        return real + moving
