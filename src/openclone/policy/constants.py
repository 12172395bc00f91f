"""Tables of numbers that live on every device where they are needed."""

from __future__ import annotations

import numpy as np
import torch


class Constant:
    """A constant array, copied to each device once instead of at each use."""

    def __init__(self, values: np.ndarray | float | tuple[float, ...]) -> None:
        self._values = np.asarray(values)
        self._copies: dict[tuple[torch.device, torch.dtype], torch.Tensor] = {}

    def like(self, tensor: torch.Tensor) -> torch.Tensor:
        """The values on the device and in the type of ``tensor``; not to be changed."""
        key = (tensor.device, tensor.dtype)
        if key not in self._copies:
            # Made outside of inference mode, so that gradients may meet it too.
            with torch.inference_mode(False):
                self._copies[key] = torch.as_tensor(
                    self._values, dtype=tensor.dtype, device=tensor.device
                )
        return self._copies[key]
