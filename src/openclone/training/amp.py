"""Adversarial motion priors for the lower body (section 3.3; Peng et al. 2021).

The command says nothing about the legs. A discriminator learns to tell transitions of
the reference legs from the robot's, and the robot earns -log(1 - D) for looking real.
Sizes and constants follow PHC: 1024-512 ReLU, gradient penalty 5, logit regularization
0.01, replay of 200 000 transitions.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import torch
from torch import nn

from openclone.policy.constants import Constant
from openclone.policy.observation import gravity_b
from openclone.policy.teacher import evenly_spaced
from openclone.robot import g1
from openclone.robot.state import RobotState
from openclone.spatial import rotations
from openclone.training.reference import ReferenceMotions

FEATURES = 2 * 12 + 1 + 3 + 3 + 3 + 6
"""Numbers that describe the lower body at one instant."""
_FEET = evenly_spaced(g1.FEET)
_LEGS = Constant(g1.DEFAULT_POSE[g1.LOWER_BODY])
_MIN_SPREAD = 0.05
_MAX_REWARD = 9.21
"""-log of 1e-4: a discriminator that is fooled completely pays no more than this."""


@dataclass(frozen=True)
class AmpConfig:
    """Settings of the discriminator.

    Attributes:
        hidden: sizes of the hidden layers.
        replay: transitions of the robot kept for training.
        gradient_penalty: weight of the squared gradient at real transitions.
        logit_regularization: weight of the squared weights of the last layer.
        learning_rate: Adam's.
        batch: transitions of either kind per gradient step.
        updates: gradient steps per PPO iteration.
    """

    hidden: tuple[int, ...] = (1024, 512)
    replay: int = 200_000
    gradient_penalty: float = 5.0
    logit_regularization: float = 0.01
    learning_rate: float = 5e-5
    batch: int = 4096
    updates: int = 4


def lower_body(state: RobotState) -> torch.Tensor:
    """``(n, 40)``: legs and root, independent of place and heading.

    Leg angles and velocities; the root's height, gravity, linear and angular velocity
    in its heading frame; the feet relative to the root in the same frame.
    """
    root = g1.ROOT
    heading = rotations.heading(state.body_quat[:, root])
    feet = state.body_position[:, _FEET] - state.body_position[:, root, None]
    default = _LEGS.like(heading)
    parts = (
        state.joint_angles[:, g1.LOWER_BODY] - default,
        state.joint_velocities[:, g1.LOWER_BODY],
        state.body_position[:, root, 2:],
        gravity_b(state.body_quat[:, root]),
        rotations.rotate_inverse(heading, state.body_velocity[:, root]),
        rotations.rotate_inverse(heading, state.body_angular_velocity[:, root]),
        rotations.rotate_inverse(heading[:, None], feet).flatten(1),
    )
    return torch.cat(parts, -1)


class Discriminator(nn.Module):
    """Transition ``(n, inputs)`` to a logit ``(n,)``; D is its sigmoid."""

    def __init__(self, inputs: int, hidden: tuple[int, ...]) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        for size in hidden:
            layers += [nn.Linear(inputs, size), nn.ReLU()]
            inputs = size
        self.body = nn.Sequential(*layers)
        self.logit = nn.Linear(inputs, 1)

    def forward(self, transitions: torch.Tensor) -> torch.Tensor:
        """Logits ``(n,)``."""
        return self.logit(self.body(transitions)).squeeze(-1)

    def reward(self, transitions: torch.Tensor) -> torch.Tensor:
        """-log(1 - D), ``(n,)``, bounded."""
        # 1 - sigmoid(x) = sigmoid(-x), and -log sigmoid(-x) = softplus(x).
        return nn.functional.softplus(self(transitions)).clamp(max=_MAX_REWARD)


def gradient_penalty(net: Discriminator, real: torch.Tensor) -> torch.Tensor:
    """Mean squared length of the logit's gradient at ``real (n, inputs)``."""
    real = real.detach().requires_grad_()
    (slope,) = torch.autograd.grad(net(real).sum(), real, create_graph=True)
    return slope.square().sum(-1).mean()


def discriminator_loss(
    net: Discriminator, real: torch.Tensor, robot: torch.Tensor, config: AmpConfig
) -> tuple[torch.Tensor, dict[str, float]]:
    """Cross entropy with its two regularizers, and its parts for the log."""
    real_logit, robot_logit = net(real), net(robot)
    softplus = nn.functional.softplus
    entropy = 0.5 * (softplus(-real_logit).mean() + softplus(robot_logit).mean())
    slope = gradient_penalty(net, real)
    weights = net.logit.weight.square().sum()
    loss = (
        entropy
        + config.gradient_penalty * slope
        + config.logit_regularization * weights
    )
    return loss, {
        "amp/loss": entropy.item(),
        "amp/gradient": slope.item(),
        "amp/accuracy_real": float((real_logit > 0).float().mean()),
        "amp/accuracy_robot": float((robot_logit < 0).float().mean()),
    }


class Replay:
    """The last ``size`` transitions in a ring."""

    def __init__(self, size: int, width: int, device: torch.device) -> None:
        """Start empty."""
        self._rows = torch.zeros(size, width, device=device)
        self._next = self.count = 0

    def add(self, rows: torch.Tensor) -> None:
        """Append ``rows (m, width)``; the oldest make room."""
        size = len(self._rows)
        rows = rows[-size:]
        place = torch.arange(len(rows), device=rows.device)
        place = (self._next + place) % size
        self._rows[place] = rows
        self._next = (self._next + len(rows)) % size
        self.count = min(size, self.count + len(rows))

    def sample(self, count: int, rng: torch.Generator) -> torch.Tensor:
        """``(count, width)``, drawn with replacement."""
        return self._rows[_draw(self.count, count, rng)]


def _draw(below: int, count: int, rng: torch.Generator) -> torch.Tensor:
    """``(count,)`` numbers from 0 to ``below`` - 1, on the generator's device."""
    return torch.randint(below, (count,), generator=rng, device=rng.device)


class AmpStyle:
    """Pays the robot for natural legs and trains the discriminator that decides it.

    Called by the task with the states before and after each step; `update` follows
    every PPO iteration.
    """

    def __init__(
        self, reference: ReferenceMotions, config: AmpConfig, seed: int
    ) -> None:
        """Take the reference's legs as real; features are scaled by their spread.

        Everything lives on the reference's device.
        """
        device = reference.device
        self.config = config
        self._real = lower_body(reference.frames)
        frames = torch.arange(reference.num_frames, device=device)
        self._starts = torch.nonzero(frames < reference.last).squeeze(-1)
        self._mean = self._real.mean(0)
        self._spread = self._real.std(0).clamp(min=_MIN_SPREAD)
        self.net = Discriminator(2 * FEATURES, config.hidden).to(device)
        self._optimizer = torch.optim.Adam(self.net.parameters(), config.learning_rate)
        self._replay = Replay(config.replay, 2 * FEATURES, device)
        self._fresh: list[torch.Tensor] = []
        self._rng = torch.Generator(device).manual_seed(seed)

    def _transitions(self, before: torch.Tensor, after: torch.Tensor) -> torch.Tensor:
        pair = ((before - self._mean) / self._spread, (after - self._mean))
        return torch.cat((pair[0], pair[1] / self._spread), -1)

    @torch.no_grad()
    def __call__(self, before: RobotState, after: RobotState) -> torch.Tensor:
        """AMP reward ``(n,)`` of one step; remembers the transitions."""
        rows = self._transitions(lower_body(before), lower_body(after))
        # A diverged simulation must not poison the replay.
        rows = torch.nan_to_num(rows).clamp(-20.0, 20.0)
        self._fresh.append(rows)
        return self.net.reward(rows)

    def real(self, count: int) -> torch.Tensor:
        """``(count, 80)`` transitions of the reference."""
        start = self._starts[_draw(len(self._starts), count, self._rng)]
        return self._transitions(self._real[start], self._real[start + 1])

    def update(self) -> dict[str, float]:
        """Train on half fresh, half replayed transitions; returns values to log."""
        # Collected under inference_mode; the copy may take part in gradients.
        fresh = torch.cat([rows.clone() for rows in self._fresh])
        self._fresh.clear()
        self._replay.add(fresh)
        half = self.config.batch // 2
        logs: dict[str, float] = {}
        for _ in range(self.config.updates):
            index = _draw(len(fresh), half, self._rng)
            robot = torch.cat((fresh[index], self._replay.sample(half, self._rng)))
            loss, logs = discriminator_loss(
                self.net, self.real(2 * half), robot, self.config
            )
            self._optimizer.zero_grad()
            loss.backward()
            self._optimizer.step()
        return logs

    def state_dict(self) -> dict[str, Any]:
        """Discriminator, its optimizer and scaling; the replay fills again."""
        return {
            "net": self.net.state_dict(),
            "optimizer": self._optimizer.state_dict(),
            "mean": self._mean,
            "spread": self._spread,
        }

    def load_state_dict(self, content: dict[str, Any]) -> None:
        """Go on from `state_dict`."""
        self.net.load_state_dict(content["net"])
        self._optimizer.load_state_dict(content["optimizer"])
        self._mean = content["mean"].to(self._mean)
        self._spread = content["spread"].to(self._spread)
