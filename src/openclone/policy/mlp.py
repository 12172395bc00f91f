"""A plain multilayer perceptron in place of the experts: the baseline CLONE†."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import nn

from openclone.policy.linear import Linear


@dataclass(frozen=True)
class MlpConfig:
    """Shape of the baseline; OmniH2O's sizes.

    Attributes:
        hidden: sizes of the hidden layers.
    """

    hidden: tuple[int, ...] = (512, 256, 128)


class MlpNetwork(nn.Module):
    """Fully connected layers with ELU; answers like `MoeNetwork`, without routing."""

    def __init__(self, inputs: int, outputs: int, config: MlpConfig) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        for size in config.hidden:
            layers += [Linear(inputs, size), nn.ELU()]
            inputs = size
        self.body = nn.Sequential(*layers)
        self.head = Linear(inputs, outputs)

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """Map ``(n, inputs)`` to ``(n, outputs)``."""
        return self.head(self.body(inputs))

    def with_routing(
        self, inputs: torch.Tensor
    ) -> tuple[torch.Tensor, list[torch.Tensor]]:
        """Outputs ``(n, outputs)`` and no routing weights."""
        return self(inputs), []
