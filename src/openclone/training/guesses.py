"""Teachers see what students must guess with a student's errors.

A student measures neither the velocity of its root nor the legs of the reference; it
infers them from its history. A teacher that is sure of them answers sharply, and its
student falls where it guesses wrong. Labels for a student are given without errors.
"""

from __future__ import annotations

import math

import numpy as np
import torch

from openclone.policy.constants import Constant
from openclone.policy.observation import TASK_SIZE
from openclone.policy.teacher import COMMAND_SIZE, LEGS_SIZE
from openclone.robot.model import CONTROL_PERIOD

_VELOCITIES = tuple(slice(TASK_SIZE + k, TASK_SIZE + k + 3) for k in (0, 9, 12))
"""Of root and feet, in `policy.teacher.command_observation`."""
_VELOCITY_ERROR = 0.05
"""m/s. A regression from a student's history is off by 0.03 to 0.04 (median)."""
_LEGS_ERROR = Constant(
    np.repeat(
        (
            0.07,  # angles, rad
            0.05 * 0.5,  # their velocities
            0.015,  # knees, m
            0.021,  # feet
            0.5 * 0.09,  # their velocities
            0.03,  # heading of the pelvis
            0.01,  # its height, m
        ),
        (15, 15, 6, 6, 6, 2, 1),
    )
)
"""The same regression on motions that it had not seen: feet 37 mm off on average."""
_CORRELATION = 0.3
"""Seconds."""


class GuessErrors:
    """Errors that change slowly, of each robot its own (Ornstein-Uhlenbeck)."""

    def __init__(self, example: torch.Tensor, scale: float, seed: int) -> None:
        """Begin with errors as they are on average.

        Args:
            example: (n, d), what teachers see: the command, or that and the legs.
            scale: 1 for the errors of a student; 0 for none.
            seed: of the errors.

        Raises:
            ValueError: they see something else.
        """
        count, size = example.shape
        if size not in (COMMAND_SIZE, COMMAND_SIZE + LEGS_SIZE):
            raise ValueError(f"nothing to guess in an observation of {size} values")
        self._random = torch.Generator(example.device).manual_seed(seed)
        self._legs = scale * _LEGS_ERROR.like(example)[: size - COMMAND_SIZE]
        self._velocity = scale * _VELOCITY_ERROR
        self._keep = math.exp(-CONTROL_PERIOD / _CORRELATION)
        self._state = self._draw(example.new_empty(count, 3 + len(self._legs)))
        self._sources: torch.Tensor | None = None

    def copy(self, sources: torch.Tensor) -> None:
        """From now on the errors of every robot are those of ``sources[robot]``."""
        self._sources = sources
        self._state = self._state[sources]

    def _draw(self, like: torch.Tensor) -> torch.Tensor:
        return torch.empty_like(like).normal_(generator=self._random)

    def __call__(self, seen: torch.Tensor) -> torch.Tensor:
        """``seen (n, d)`` with the errors of the next control step."""
        fresh = math.sqrt(1.0 - self._keep**2)
        drawn = self._draw(self._state)
        if self._sources is not None:
            drawn = drawn[self._sources]
        self._state = self._keep * self._state + fresh * drawn
        seen, velocity = seen.clone(), self._velocity * self._state[:, :3]
        for part in _VELOCITIES:
            seen[:, part] += velocity
        seen[:, COMMAND_SIZE:] += self._legs * self._state[:, 3:]
        return seen
