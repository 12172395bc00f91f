"""Running mean and spread of observations."""

from __future__ import annotations

import torch
from rsl_rl.modules import EmpiricalNormalization


class Normalization(EmpiricalNormalization):
    """rsl_rl's normalization with a variance that takes a tenth of the time.

    `torch.var` along the first axis of a batch is slow on the CPU (0.8 ms for 512
    observations of the teacher, 6 ms for the student's).
    """

    @torch.no_grad()
    def update(self, x: torch.Tensor) -> None:
        """Take in the batch ``x (n, d)``, in training mode only."""
        if not self.training:
            return
        self.count += len(x)
        rate = len(x) / self.count
        mean = x.mean(0, keepdim=True)
        variance = (x - mean).square_().mean(0, keepdim=True)
        step = mean - self._mean
        self._mean += rate * step
        self._var += rate * (variance - self._var + step * (mean - self._mean))
        torch.sqrt(self._var, out=self._std)

    @torch.no_grad()
    def assume(self, mean: torch.Tensor, spread: torch.Tensor, count: int) -> None:
        """Go on as after ``count`` observations.

        Args:
            mean: (1, d), what is taken off.
            spread: (1, d), what is then divided by: deviation + ``eps``.
            count: observations seen.
        """
        deviation = spread - self.eps
        state = {
            "_mean": mean,
            "_std": deviation,
            "_var": deviation.square(),
            "count": torch.full_like(self.count, count),
        }
        self.load_state_dict(state)
