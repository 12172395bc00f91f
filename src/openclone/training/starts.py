"""Where episodes start: more often where robots fail."""

from __future__ import annotations

import torch

from openclone.training.reference import ReferenceMotions

_BIN = 25
"""Frames that share one failure rate: half a second."""
_FORGETTING = 0.9995
"""Share of the old counts that each control step keeps."""


class StartFrames:
    """The failure rate of each half second of the reference, and draws from it.

    Rates live on the reference's device; draws are made on the host, where births are
    prepared.

    Attributes:
        failures: (bins,), failures of late.
    """

    def __init__(
        self, reference: ReferenceMotions, share: float, generator: torch.Generator
    ) -> None:
        """Begin with the same rate everywhere.

        Args:
            reference: the motions.
            share: of starts drawn by failure rate; the rest is uniform.
            generator: of the draws, on the CPU.
        """
        bins = reference.num_frames // _BIN + 1
        device = reference.device
        self.failures = torch.full((bins,), 0.1, device=device)
        self._visits = torch.ones(bins, device=device)
        self._share, self._generator = share, generator
        clip, self._last = reference.clip.cpu(), reference.last.cpu()
        self._first = torch.searchsorted(clip, clip)

    def count(self, frame: torch.Tensor, terminated: torch.Tensor) -> None:
        """Note that robots were at ``frame (n,)`` and which of them failed there."""
        bins = frame // _BIN
        self.failures *= _FORGETTING
        self._visits *= _FORGETTING
        part = self._visits.new_full(bins.shape, 1 / _BIN)
        self._visits.index_add_(0, bins, part)
        self.failures.index_add_(0, bins, terminated.to(self.failures.dtype))

    def draw(self, count: int) -> torch.Tensor:
        """``(count,)`` frames, up to 1 s before the chosen place; on the CPU."""
        rate = (self.failures / (self._visits + 1.0)).clamp(max=0.5) + 0.01
        # Thousands of easy bins would outweigh the few hard ones.
        rate = rate**1.5
        share = self._share
        chance = share * rate / rate.sum() + (1 - share) / len(rate)
        rng = self._generator
        bins = torch.multinomial(chance.cpu(), count, replacement=True, generator=rng)
        offset = torch.randint(-_BIN, _BIN, (count,), generator=rng)
        wanted = (bins * _BIN).clamp(max=len(self._last) - 1)
        latest = torch.maximum(self._first[wanted], self._last[wanted] - _BIN)
        return torch.minimum(
            torch.maximum(wanted + offset, self._first[wanted]), latest
        )
