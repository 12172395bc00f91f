"""Forward kinematics of the key bodies in PyTorch: gradients pass through it."""

from __future__ import annotations

from dataclasses import dataclass, replace

import mujoco
import torch

from openclone.policy.constants import Constant
from openclone.policy.teacher import evenly_spaced
from openclone.robot import g1
from openclone.robot.model import SOLE_CORNERS
from openclone.robot.state import RobotState
from openclone.spatial import rotations

_FEET = evenly_spaced(g1.FEET)
_SOLE_CORNERS = Constant(SOLE_CORNERS)
_SENSED = ("body_position", "body_quat", "body_velocity", "body_angular_velocity")


@dataclass(frozen=True)
class _Level:
    """Bodies equally far from the root, k of them: computed at once."""

    bodies: list[int]
    parents: list[int]
    joints: list[int]
    axis: torch.Tensor
    position: torch.Tensor
    quat: torch.Tensor


class BodyTree:
    """The links of a robot and the hinges between them."""

    def __init__(self, model: mujoco.MjModel, device: torch.device) -> None:
        """Keep the part of ``model``'s tree that carries the key bodies."""
        self.device = device
        self._key = [model.body(name).id for name in g1.KEY_BODIES]
        self._root = self._key[g1.ROOT]
        depth: dict[int, int] = {self._root: 0}
        for body in self._key:
            path = []
            while body not in depth:
                path.append(body)
                body = int(model.body_parentid[body])
            for child in reversed(path):
                depth[child] = depth[int(model.body_parentid[child])] + 1

        def rows(table: object, chosen: list[int]) -> torch.Tensor:
            return torch.tensor(table[chosen], dtype=torch.float32, device=device)  # type: ignore[index]

        self._levels = []
        for level in range(1, max(depth.values()) + 1):
            bodies = sorted(body for body, at in depth.items() if at == level)
            hinges = [int(model.body_jntadr[body]) for body in bodies]
            self._levels.append(
                _Level(
                    bodies=bodies,
                    parents=[int(model.body_parentid[body]) for body in bodies],
                    joints=[int(model.jnt_qposadr[hinge]) - 7 for hinge in hinges],
                    axis=rows(model.jnt_axis, hinges),
                    position=rows(model.body_pos, bodies),
                    quat=rows(model.body_quat, bodies),
                )
            )

    def __call__(self, qpos: torch.Tensor, qvel: torch.Tensor) -> RobotState:
        """States of robots at ``qpos (n, 36)`` and ``qvel (n, 35)``; no forces."""
        turn = qpos[:, 3:7]
        place, quat = {self._root: qpos[:, :3]}, {self._root: turn}
        velocity = {self._root: qvel[:, :3]}
        spin = {self._root: rotations.rotate(turn, qvel[:, 3:6])}
        joints, rates = qpos[:, 7:], qvel[:, 6:]
        for level in self._levels:
            above = [
                torch.stack([known[body] for body in level.parents], 1)
                for known in (place, quat, velocity, spin)
            ]
            offset = rotations.rotate(above[1], level.position.expand_as(above[0]))
            half = 0.5 * joints[:, level.joints, None]
            hinge = torch.cat((half.cos(), half.sin() * level.axis), -1)
            fixed = rotations.multiply(above[1], level.quat.expand_as(above[1]))
            turned = rotations.multiply(fixed, hinge)
            axis = rotations.rotate(turned, level.axis.expand_as(above[0]))
            below = (
                above[0] + offset,
                turned,
                above[2] + rotations.cross(above[3], offset),
                above[3] + axis * rates[:, level.joints, None],
            )
            for known, found in zip((place, quat, velocity, spin), below, strict=True):
                known.update(zip(level.bodies, found.unbind(1), strict=True))
        position, quats, velocities, spins = (
            torch.stack([known[body] for body in self._key], 1)
            for known in (place, quat, velocity, spin)
        )
        return RobotState(
            joint_angles=joints,
            joint_velocities=rates,
            body_position=position,
            body_quat=quats,
            body_velocity=velocities,
            body_angular_velocity=spins,
            torque=torch.zeros_like(rates),
            foot_force=qpos.new_zeros(len(qpos), 2, 3),
        )


def soles(state: RobotState) -> tuple[torch.Tensor, torch.Tensor]:
    """Places and velocities of the soles' corners, ``(n, 8, 3)`` each, world."""
    quat = state.body_quat[:, _FEET, None].expand(-1, -1, len(SOLE_CORNERS), -1)
    corners = _SOLE_CORNERS.like(quat).expand(*quat.shape[:-1], 3)
    offset = rotations.rotate(quat, corners)
    spin = state.body_angular_velocity[:, _FEET, None]
    place = state.body_position[:, _FEET, None] + offset
    velocity = state.body_velocity[:, _FEET, None] + rotations.cross(spin, offset)
    return place.flatten(1, 2), velocity.flatten(1, 2)


def as_sensed(moving: RobotState, sensed: RobotState) -> RobotState:
    """The values of ``sensed`` with the gradients of ``moving``.

    Sensors report where bodies were one physics step before.
    """
    quat = moving.body_quat
    same = (quat.detach() * sensed.body_quat).sum(-1, keepdim=True) >= 0
    moving = replace(moving, body_quat=torch.where(same, quat, -quat))
    found = {
        name: getattr(sensed, name) + without_value(getattr(moving, name))
        for name in _SENSED
    }
    return replace(moving, **found, torque=sensed.torque, foot_force=sensed.foot_force)


def without_value(tensor: torch.Tensor) -> torch.Tensor:
    """Zeros with the gradients of ``tensor``."""
    return tensor - tensor.detach()
