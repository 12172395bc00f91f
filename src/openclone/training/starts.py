"""Where episodes start: more often where robots fail."""

from __future__ import annotations

import torch

from openclone.robot import g1
from openclone.training.reference import ReferenceMotions

_BIN = 25
"""Frames that share one failure rate: half a second."""
_HARDEST = 0.1
"""Failures per visit that count; what always fails would take all the time, in vain."""
_FORGETTING = 0.9995
"""Share of the old counts that each control step keeps."""
_LENGTH_POWER = -0.5
"""Of a motion's length, in the weight of its seconds: between as often as long (0) and
all motions alike (-1)."""
_BURIED = 0.0
"""Metres; an ankle below has its sole under the ground, where no robot can be put."""


class StartFrames:
    """The failure rate of each half second of the reference, and draws from it.

    Rates live on the reference's device; draws are made on the host, where births are
    prepared.

    Attributes:
        failures: (bins,), failures of late.
    """

    def __init__(
        self,
        reference: ReferenceMotions,
        share: float,
        generator: torch.Generator,
        recorded_weight: float = 1.0,
        run_up: int = _BIN,
    ) -> None:
        """Begin with the same rate everywhere.

        Args:
            reference: the motions.
            share: of starts drawn by failure rate; the rest is drawn over all time,
                that of long motions less often.
            generator: of the draws, on the CPU.
            recorded_weight: how many times more often than synthetic ones the rest
                draws motions made from recordings.
            run_up: frames before the chosen place at which episodes may begin.
        """
        bins = reference.num_frames // _BIN + 1
        device = reference.device
        self.failures = torch.full((bins,), 0.1, device=device)
        self._visits = torch.ones(bins, device=device)
        self._share, self._generator = share, generator
        self._run_up = run_up
        clip, self._last = reference.clip.cpu(), reference.last.cpu()
        self._first = torch.searchsorted(clip, clip)
        ankles = reference.frames.body_position[:, list(g1.FEET), 2].amin(1).cpu()
        everywhere = torch.arange(len(clip), device=clip.device)
        self._startable = torch.where(ankles < _BURIED, self._first, everywhere)
        recorded = torch.tensor(reference.recorded, device=clip.device)[clip]
        first = torch.arange(bins, device=clip.device) * _BIN
        self._place = first.clamp(max=len(clip) - 1)
        length = (self._last - self._first + 1).to(torch.float32)
        weight = torch.where(recorded, recorded_weight, 1.0) * length**_LENGTH_POWER
        self._anywhere = weight[self._place] / weight[self._place].sum()

    def count(self, frame: torch.Tensor, terminated: torch.Tensor) -> None:
        """Note that robots were at ``frame (n,)`` and which of them failed there."""
        bins = frame // _BIN
        self.failures *= _FORGETTING
        self._visits *= _FORGETTING
        part = self._visits.new_full(bins.shape, 1 / _BIN)
        self._visits.index_add_(0, bins, part)
        self.failures.index_add_(0, bins, terminated.to(self.failures.dtype))

    def draw(self, count: int) -> torch.Tensor:
        """``(count,)`` frames, near the chosen place or before it; on the CPU.

        Where the reference sinks into the ground, as commands may, it is the first
        frame of the motion instead.
        """
        rate = (self.failures / (self._visits + 1.0)).clamp(max=_HARDEST) + 0.01
        share = self._share
        chance = share * (rate / rate.sum()).cpu() + (1 - share) * self._anywhere
        rng = self._generator
        bins = torch.multinomial(chance, count, replacement=True, generator=rng)
        offset = torch.randint(-self._run_up, _BIN, (count,), generator=rng)
        wanted = self._place[bins]
        latest = torch.maximum(self._first[wanted], self._last[wanted] - _BIN)
        near = torch.maximum(wanted + offset, self._first[wanted])
        return self._startable[torch.minimum(near, latest)]
