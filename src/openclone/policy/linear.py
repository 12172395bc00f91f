"""A linear layer that multiplies with oneDNN on the CPU.

PyTorch hands products of 32-bit matrices to MKL, which leaves half of the vector units
of processors not made by Intel idle: 90 instead of 200 GFLOP/s on one core of an AMD
EPYC. oneDNN, which PyTorch brings along, uses them. Results agree up to rounding.

Where the processor multiplies 16-bit floats (bfloat16) two to six times as fast,
gradients, and in training the outputs of hidden layers, are products of such numbers,
summed in 32 bits: they are off by about one part in 2000, which is nothing beside what
a batch of samples leaves unknown.
"""

from __future__ import annotations

from typing import Any, cast

import torch
from torch import nn

_AVAILABLE = torch.backends.mkldnn.is_available() and hasattr(  # type: ignore[attr-defined]
    torch.ops.mkldnn, "_linear_pointwise"
)

_supports_bfloat16 = getattr(torch.cpu, "_is_avx512_bf16_supported", lambda: False)
SHORT = torch.bfloat16 if _supports_bfloat16() else torch.float32
"""Of the numbers that short products are made of."""


class _Product(torch.autograd.Function):
    """``a (m, k)`` times the transpose of ``b (n, k)``, plus ``bias (n,)`` or None.

    Its gradients are such products again, so that it can be differentiated as often as
    wanted.
    """

    @staticmethod
    def forward(
        ctx: Any,
        a: torch.Tensor,
        b: torch.Tensor,
        bias: torch.Tensor | None,
        short: bool,
    ) -> torch.Tensor:
        if not short:
            ctx.save_for_backward(a, b)
            return torch.ops.mkldnn._linear_pointwise(a, b, bias, "none", [], "")
        a, b = a.to(SHORT), b.to(SHORT)
        ctx.save_for_backward(a, b)
        product = torch.ops.mkldnn._linear_pointwise(a, b, None, "none", [], "").float()
        return product if bias is None else product.add_(bias)

    @staticmethod
    def backward(  # type: ignore[override]
        ctx: Any, slope: torch.Tensor
    ) -> tuple[torch.Tensor | None, ...]:
        a, b = ctx.saved_tensors
        needs_a, needs_b, needs_bias, _ = ctx.needs_input_grad
        short = slope.to(SHORT)

        def product(x: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
            return _Product.apply(x, y, None, True)

        return (
            product(short, b.t()) if needs_a else None,
            product(short.t(), a.t()) if needs_b else None,
            slope.sum(0) if needs_bias else None,
            None,
        )


class Linear(nn.Linear):
    """`torch.nn.Linear`, quicker for batches on the CPU.

    Elsewhere, and while a network is exported, it is `torch.nn.Linear` itself.

    Attributes:
        short: whether, while training, outputs are products of 16-bit floats too. Such
            layers have no second derivatives.
    """

    short: bool = False

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        """Map ``(n, in_features)`` to ``(n, out_features)``."""
        quick = (
            _AVAILABLE
            and inputs.device.type == "cpu"
            and inputs.dtype == self.weight.dtype == torch.float32
            and inputs.ndim == 2
            and not torch.compiler.is_compiling()
        )
        if not quick:
            return super().forward(inputs)
        return _Product.apply(
            inputs, self.weight, self.bias, self.short and self.training
        )


def quicken(layers: nn.Sequential) -> None:
    """Make the layers of an rsl_rl network quick, in place; parameters stay.

    Outputs of all layers but the last become short: their rounding averages out there.
    """
    linear = [layer for layer in layers if type(layer) is nn.Linear]
    for layer in linear:
        # The same object with another `forward`: optimizers keep its parameters.
        layer.__class__ = Linear
        cast(Linear, layer).short = layer is not linear[-1]
    for layer in layers:
        if isinstance(layer, nn.ELU):
            layer.inplace = True
