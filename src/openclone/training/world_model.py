"""A world model: a network that foresees one control step of the robot.

Physics engines give no gradients. A network that has learned what a control step does
gives them everywhere, and those with respect to the joint targets and velocities are
close to MuJoCo's own finite differences after minutes of data
(``benchmarks/world_model.py``). All is seen from the root, so that neither place nor
heading matters, as in SuperTrack (Fussell et al. 2021).
"""

from __future__ import annotations

from typing import Any

import torch
from torch import nn

from openclone.policy.linear import Linear
from openclone.policy.normalization import Normalization
from openclone.policy.observation import gravity_b
from openclone.robot import g1
from openclone.robot.model import CONTROL_PERIOD
from openclone.robot.state import RobotState
from openclone.spatial import rotations
from openclone.training.body_tree import BodyTree, soles
from openclone.training.distributed import team

_DOFS = 6 + g1.NUM_JOINTS
_NEAR = 0.1
"""Metres above the ground beyond which it does not matter how far a sole is."""
_DEPTHS = (0.004, 0.01)
"""Metres over which contact sets in, two scales."""
_HUBER = 0.3
_PARTS = (36, 35, g1.NUM_JOINTS, 36, 35)
"""Of a transition: qpos, qvel, joint targets, and qpos and qvel afterwards."""


def _features(
    bodies: RobotState, qpos: torch.Tensor, qvel: torch.Tensor, targets: torch.Tensor
) -> torch.Tensor:
    """What decides how a robot moves on, ``(n, d)``."""
    corners, moves = soles(bodies)
    turn, height = qpos[:, 3:7], corners[..., 2]
    vectors = torch.cat((qvel[:, None, :3], moves), 1)
    seen = rotations.rotate_inverse(
        turn[:, None].expand(*vectors.shape[:2], 4), vectors
    )
    parts = (
        gravity_b(turn),
        qpos[:, 2:3],
        seen.flatten(1),
        qvel[:, 3:],
        qpos[:, 7:],
        targets - qpos[:, 7:],
        height.clamp(max=_NEAR),
        *(
            torch.sigmoid((place - height) / depth)
            for place, depth in zip((0.0, 0.01), _DEPTHS, strict=True)
        ),
    )
    return torch.cat(parts, 1)


def _own_velocity(qpos: torch.Tensor, qvel: torch.Tensor) -> torch.Tensor:
    """``qvel`` with the root's velocity in the root frame, ``(n, 35)``."""
    return torch.cat(
        (rotations.rotate_inverse(qpos[:, 3:7], qvel[:, :3]), qvel[:, 3:]), 1
    )


def _change(
    qpos: torch.Tensor, qvel: torch.Tensor, qpos2: torch.Tensor, qvel2: torch.Tensor
) -> torch.Tensor:
    """What a step did, ``(n, 70)``, m/s and rad/s, in the root frame before it.

    By how much the mean velocity over the step, and the velocity after it, exceed the
    velocity before.
    """
    turn, own = qpos[:, 3:7], _own_velocity(qpos, qvel)
    turned = rotations.multiply(rotations.conjugate(turn), qpos2[:, 3:7])
    moved = (
        rotations.rotate_inverse(turn, qpos2[:, :3] - qpos[:, :3]),
        rotations.to_rotation_vector(turned),
        qpos2[:, 7:] - qpos[:, 7:],
    )
    after = torch.cat((rotations.rotate_inverse(turn, qvel2[:, :3]), qvel2[:, 3:]), 1)
    return torch.cat((torch.cat(moved, 1) / CONTROL_PERIOD - own, after - own), 1)


def _advance(
    qpos: torch.Tensor, qvel: torch.Tensor, change: torch.Tensor
) -> tuple[torch.Tensor, torch.Tensor]:
    """``qpos`` and ``qvel`` after a step with this `_change`."""
    turn, own = qpos[:, 3:7], _own_velocity(qpos, qvel)
    moved = CONTROL_PERIOD * (own + change[:, :_DOFS])
    after = own + change[:, _DOFS:]
    place = qpos[:, :3] + rotations.rotate(turn, moved[:, :3])
    quat = rotations.multiply(turn, rotations.from_rotation_vector(moved[:, 3:6]))
    velocity = rotations.rotate(turn, after[:, :3])
    return (
        torch.cat((place, quat, qpos[:, 7:] + moved[:, 6:]), 1),
        torch.cat((velocity, after[:, 3:]), 1),
    )


class WorldModel(nn.Module):
    """From a robot's state and joint targets to its state 20 ms later."""

    scale: torch.Tensor

    def __init__(self, tree: BodyTree, width: int) -> None:
        """An untrained model whose hidden layers have ``width`` units."""
        super().__init__()
        self._tree = tree
        example = torch.zeros(1, 36, device=tree.device)
        example[:, 3] = 1.0
        size = _features(
            tree(example, example[:, :35]), example, example[:, :35], example[:, 7:]
        ).shape[1]
        self.normalization = Normalization(size)
        layers: list[nn.Module] = []
        inputs = size
        for _ in range(3):
            layers += [Linear(inputs, width), nn.ELU()]
            inputs = width
        self.deep = nn.Sequential(*layers, Linear(width, 2 * _DOFS))
        self.direct = Linear(size, 2 * _DOFS)
        self.register_buffer("scale", torch.ones(2 * _DOFS, device=tree.device))
        self.eval()

    def _scaled(
        self,
        qpos: torch.Tensor,
        qvel: torch.Tensor,
        targets: torch.Tensor,
        bodies: RobotState | None = None,
    ) -> torch.Tensor:
        bodies = bodies or self._tree(qpos, qvel)
        seen = self.normalization(_features(bodies, qpos, qvel, targets))
        return self.deep(seen) + self.direct(seen)

    def forward(
        self,
        qpos: torch.Tensor,
        qvel: torch.Tensor,
        targets: torch.Tensor,
        bodies: RobotState | None = None,
    ) -> tuple[torch.Tensor, torch.Tensor]:
        """``qpos (n, 36)`` and ``qvel (n, 35)`` after a step to ``targets (n, 29)``.

        ``bodies`` are those of the tree before the step, if they are known.
        """
        change = self.scale * self._scaled(qpos, qvel, targets, bodies)
        return _advance(qpos, qvel, change)

    def errors(self, transitions: torch.Tensor) -> torch.Tensor:
        """(n, 70): errors of the foreseen changes, in their standard deviations."""
        qpos, qvel, targets, *after = transitions.split(_PARTS, 1)
        found = _change(qpos, qvel, *after) / self.scale
        return self._scaled(qpos, qvel, targets) - found

    @torch.no_grad()
    def measure(self, transitions: torch.Tensor) -> None:
        """Learn the spread of what comes in and of what comes out."""
        qpos, qvel, targets, *after = transitions.split(_PARTS, 1)
        seen = _features(self._tree(qpos, qvel), qpos, qvel, targets)
        spread = seen.std(0, keepdim=True) + self.normalization.eps
        self.normalization.assume(seen.mean(0, keepdim=True), spread, len(seen))
        self.scale.copy_(_change(qpos, qvel, *after).std(0) + 1e-6)


class WorldLearner:
    """Keeps transitions and teaches them to a world model."""

    def __init__(self, model: WorldModel, kept: int, batch: int, seed: int) -> None:
        """Learn from the last ``kept`` transitions, ``batch`` at a time."""
        self.model, self._kept, self._batch = model, kept, batch
        self._optimizer = torch.optim.Adam(model.parameters())
        device = model.scale.device
        self._random = torch.Generator(device).manual_seed(seed)
        self._buffer = torch.empty(0, sum(_PARTS), device=device)
        self._next = 0
        self.measured = False

    def add(self, transitions: torch.Tensor) -> None:
        """Keep ``transitions (n, d)``; the oldest go.

        Rows of qpos, qvel, joint targets, and qpos and qvel after the step.
        """
        if not self.measured:
            self.model.measure(transitions)
            team().share(self.model)
            self.measured = True
        room = self._kept - len(self._buffer)
        self._buffer = torch.cat((self._buffer, transitions[:room]))
        rest = transitions[max(room, 0) :]
        if len(rest):
            rows = (
                torch.arange(len(rest), device=rest.device) + self._next
            ) % self._kept
            self._buffer[rows] = rest
            self._next = (self._next + len(rest)) % self._kept

    def learn(self, updates: int, rate: float) -> float:
        """So many gradient steps with this learning rate; the mean loss."""
        for group in self._optimizer.param_groups:
            group["lr"] = rate
        total, model = 0.0, self.model
        for _ in range(updates):
            rows = torch.randint(
                len(self._buffer),
                (self._batch,),
                generator=self._random,
                device=self._random.device,
            )
            errors = model.errors(self._buffer[rows])
            loss = nn.functional.huber_loss(
                errors, torch.zeros_like(errors), delta=_HUBER
            )
            self._optimizer.zero_grad()
            loss.backward()
            team().average_gradients(model)
            nn.utils.clip_grad_norm_(model.parameters(), 1.0)
            self._optimizer.step()
            total += loss.item()
        return total / max(updates, 1)

    def state_dict(self) -> dict[str, Any]:
        """What a checkpoint holds; the transitions are collected anew."""
        return {
            "model": self.model.state_dict(),
            "optimizer": self._optimizer.state_dict(),
        }

    def load_state_dict(self, content: dict[str, Any]) -> None:
        """Go on from `state_dict`."""
        self.model.load_state_dict(content["model"])
        self._optimizer.load_state_dict(content["optimizer"])
        self.measured = True
