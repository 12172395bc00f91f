"""Domain randomization: the rows of Table A2 that change the robot and its motors.

Born distance and heading and the pushes are part of `TaskConfig`; `TABLE_A2_TASK` in
`task` holds the whole table. Every range is off by default.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from openclone.robot import g1
from openclone.robot.model import FOOT_FRICTION, SUBSTEPS, TIMESTEP
from openclone.training.physics import Physics, RobotParameters
from openclone.training.terrain import TerrainKind

Range = tuple[float, float]


@dataclass(frozen=True)
class RandomizationConfig:
    """Ranges of uniform distributions, drawn for each robot.

    Attributes:
        friction: sliding friction of the feet; None: the model's.
        com_offset: metres, largest shift of the base's centre of mass per axis.
        link_mass: factors on each link's mass and inertia.
        p_gain, d_gain: factors on each motor's gains.
        torque_injection: share of the torque limit, largest random torque that a motor
            adds in each physics step (RFI).
        control_delay: seconds, largest delay between a joint target and the motors.
        step_delay: seconds, largest delay of the whole control step: sensing, network
            and transport. The paper does not say more than "global step delay"; here
            it adds to the control delay.
        terrain: kinds of ground; the robots are spread evenly over them.
    """

    friction: Range | None = None
    com_offset: float = 0.0
    link_mass: Range = (1.0, 1.0)
    p_gain: Range = (1.0, 1.0)
    d_gain: Range = (1.0, 1.0)
    torque_injection: float = 0.0
    control_delay: float = 0.0
    step_delay: float = 0.0
    terrain: tuple[TerrainKind, ...] = ("flat",)

    @property
    def changes_robots(self) -> bool:
        """Whether robots differ in the physics itself."""
        return (
            self.friction is not None
            or self.com_offset > 0
            or any(r != (1.0, 1.0) for r in (self.link_mass, self.p_gain, self.d_gain))
        )


TABLE_A2 = RandomizationConfig(
    friction=(0.6, 2.0),
    com_offset=0.04,
    link_mass=(0.7, 1.25),
    p_gain=(0.85, 1.15),
    d_gain=(0.85, 1.15),
    torque_injection=0.05,
    control_delay=0.020,
    step_delay=0.080,
    terrain=("flat", "rough", "obstacles"),
)
"""The printed values."""


def draw_parameters(
    config: RandomizationConfig, count: int, links: int, rng: np.random.Generator
) -> RobotParameters:
    """Bodies and gains of ``count`` robots with ``links`` links each."""
    joints = g1.NUM_JOINTS
    friction = config.friction or (FOOT_FRICTION, FOOT_FRICTION)
    shift = config.com_offset
    return RobotParameters(
        friction=rng.uniform(*friction, count),
        com_offset=rng.uniform(-shift, shift, (count, 3)),
        link_mass=rng.uniform(*config.link_mass, (count, links)),
        p_gain=rng.uniform(*config.p_gain, (count, joints)),
        d_gain=rng.uniform(*config.d_gain, (count, joints)),
    )


class ActionPath:
    """From the policy's joint targets to what the motors follow: delays and RFI.

    A motor turns a target into the torque ``kp (target - angle) - kd velocity``, so a
    torque is injected by moving its target by ``torque / kp``.
    """

    def __init__(
        self, config: RandomizationConfig, count: int, generator: torch.Generator
    ) -> None:
        """Paths of ``count`` robots without delay; `reset` draws them."""
        self._config, self._generator = config, generator
        longest = (config.control_delay + config.step_delay) / TIMESTEP
        self._delayed = longest > 0
        kept = -(-(round(longest) + 1) // SUBSTEPS) + 1
        device = generator.device
        self._history = torch.zeros(count, kept, g1.NUM_JOINTS, device=device)
        self.delay = torch.zeros(count, device=device)
        """(n,) seconds, this episode's."""
        torque = config.torque_injection * g1.MAX_TORQUE / g1.KP
        self._kick = torch.tensor(torque, dtype=torch.float32, device=device)
        self._softness = torch.ones(count, g1.NUM_JOINTS, device=device)
        self._substep = torch.arange(SUBSTEPS, device=device)

    def set_gains(self, ids: torch.Tensor, p_gain: np.ndarray) -> None:
        """Tell the factors ``(len(ids), 29)`` on the motors' P gains."""
        values = torch.from_numpy(1.0 / p_gain).to(self._softness)
        self._softness[ids] = values

    def reset(self, ids: torch.Tensor, joint_angles: torch.Tensor) -> None:
        """Draw delays for new episodes; until then motors hold ``(len(ids), 29)``."""
        if not self._delayed:
            return
        config = self._config
        draws = torch.rand(
            len(ids), 2, generator=self._generator, device=self.delay.device
        )
        limits = draws.new_tensor([config.control_delay, config.step_delay])
        self.delay[ids] = (draws * limits).sum(-1)
        self._history[ids] = joint_angles[:, None]

    def copy(self, sources: torch.Tensor) -> None:
        """Give every robot the delay and the past of ``sources[robot]``."""
        for part in (self._history, self.delay, self._softness):
            part[:] = part[sources]

    def __call__(self, targets: torch.Tensor) -> torch.Tensor:
        """What the motors follow: ``(n, substeps, 29)`` for ``targets (n, 29)``."""
        if self._delayed:
            ctrl = self._late(targets)
        else:
            ctrl = targets[:, None].expand(-1, SUBSTEPS, -1)
        if self._config.torque_injection > 0:
            draws = torch.rand(
                ctrl.shape, generator=self._generator, device=ctrl.device
            )
            kick = (2.0 * draws - 1.0) * self._kick
            ctrl = ctrl + kick * self._softness[:, None]
        return ctrl

    def _late(self, targets: torch.Tensor) -> torch.Tensor:
        """Past targets in each physics step, weighed by how long they are in effect."""
        self._history = torch.cat((targets[:, None], self._history[:, :-1]), 1)
        steps = self.delay / TIMESTEP
        whole = steps.floor()
        part = (steps - whole)[:, None, None]
        late = whole[:, None].long() - self._substep
        return (1.0 - part) * self._past(late) + part * self._past(late + 1)

    def _past(self, late: torch.Tensor) -> torch.Tensor:
        """Targets that were newest ``late (n, substeps)`` physics steps ago."""
        back = ((late + SUBSTEPS - 1) // SUBSTEPS).clamp(min=0)
        rows = torch.arange(len(late), device=late.device)[:, None]
        return self._history[rows, back]


class RobotFactory:
    """Gives robots new bodies, gains and delays."""

    def __init__(
        self,
        config: RandomizationConfig,
        physics: Physics,
        path: ActionPath,
        rng: np.random.Generator,
    ) -> None:
        """Robots of ``physics``, controlled through ``path``; draws from ``rng``."""
        self._config, self._physics, self._path, self._rng = config, physics, path, rng

    def rebuild(self, ids: np.ndarray, joint_angles: torch.Tensor) -> None:
        """Before the episodes of ``ids`` begin at ``joint_angles (len(ids), 29)``."""
        index = torch.from_numpy(ids).to(self._path.delay.device)
        self._path.reset(index, joint_angles.to(self._path.delay))
        if self._config.changes_robots:
            links = self._physics.links
            parameters = draw_parameters(self._config, len(ids), links, self._rng)
            self._physics.randomize(ids, parameters)
            self._path.set_gains(index, parameters.p_gain)
