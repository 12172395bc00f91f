"""Mixture-of-Experts layers and the balancing loss (section 3.1, Eq. 1)."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import nn

from openclone.policy.linear import Linear


@dataclass(frozen=True)
class MoeConfig:
    """Shape of the student network; defaults from Appendix C.

    Attributes:
        layers: L, MoE layers.
        experts: N, experts a layer.
        active: k, experts whose outputs are summed.
        width: size of the hidden state.
    """

    layers: int = 3
    experts: int = 4
    active: int = 2
    width: int = 256


class MoeLayer(nn.Module):
    """f = Σ_i w_i E_i(h) over the k experts with the largest routing weights.

    Every expert is one fully connected layer with ELU. All experts are computed as one
    matrix product, which on a CPU is faster than gathering the chosen ones.
    """

    def __init__(self, width: int, experts: int, active: int) -> None:
        super().__init__()
        self.experts, self.active, self.width = experts, active, width
        self.router = Linear(width, experts)
        self.expert = Linear(width, experts * width)
        self.expert.short = True

    def forward(self, hidden: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """Map ``(n, width)`` to the output ``(n, width)`` and weights ``(n, N)``.

        The weights are the router's softmax over all experts, before the choice.
        """
        weights = torch.softmax(self.router(hidden), -1)
        smallest = torch.topk(weights, self.active, dim=-1).values[:, -1:]
        chosen = torch.where(weights >= smallest, weights, torch.zeros_like(weights))
        outputs = nn.functional.elu(self.expert(hidden))
        outputs = outputs.reshape(-1, self.experts, self.width)
        return (chosen[..., None] * outputs).sum(1), weights


class MoeNetwork(nn.Module):
    """Input layer, L MoE layers, output layer."""

    def __init__(self, inputs: int, outputs: int, config: MoeConfig) -> None:
        super().__init__()
        self.stem = Linear(inputs, config.width)
        self.stem.short = True
        self.layers = nn.ModuleList(
            MoeLayer(config.width, config.experts, config.active)
            for _ in range(config.layers)
        )
        self.head = Linear(config.width, outputs)

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """Map ``(n, inputs)`` to ``(n, outputs)``."""
        return self.with_routing(inputs)[0]

    def with_routing(
        self, inputs: torch.Tensor
    ) -> tuple[torch.Tensor, list[torch.Tensor]]:
        """Outputs ``(n, outputs)`` and each layer's routing weights ``(n, N)``."""
        hidden = nn.functional.elu(self.stem(inputs))
        routing = []
        for layer in self.layers:
            hidden, weights = layer(hidden)
            routing.append(weights)
        return self.head(hidden), routing


def balance_loss(routing: list[torch.Tensor], slack: float = 0.25) -> torch.Tensor:
    """Eq. 1: penalty on experts used more or less than uniformly, beyond a slack ε.

        Σ_l Σ_e max(p_e - (1 + ε)/N, 0) + max((1 - ε)/N - p_e, 0)

    with p_e the mean routing weight. The paper prints min in the second term, which
    would reward idle experts; its authors confirm max.

    Args:
        routing: one ``(n, N)`` tensor of weights per layer.
        slack: ε.
    """
    if not routing:  # a network without experts
        return torch.zeros(())
    total = routing[0].new_zeros(())
    for weights in routing:
        usage = weights.mean(0)
        count = weights.shape[-1]
        above = (usage - (1 + slack) / count).clamp(min=0)
        below = ((1 - slack) / count - usage).clamp(min=0)
        total = total + (above + below).sum()
    return total
