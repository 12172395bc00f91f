"""Training progress: one line for the terminal, scalars for TensorBoard."""

from __future__ import annotations

import time
from collections import defaultdict
from pathlib import Path

from torch.utils.tensorboard import SummaryWriter


class Progress:
    """Collects values, prints a line with rate and ETA, and logs means.

    Args of the constructor: folder for the event file, minutes until the end, steps
    and minutes already trained before a resume.
    """

    def __init__(
        self, folder: Path, minutes: float, steps: int = 0, trained: float = 0.0
    ) -> None:
        self._writer = SummaryWriter(str(folder))
        self._minutes = minutes
        self._start = self._last_line = time.monotonic()
        self._trained = trained
        self._line_steps = self.steps = steps
        self._values: dict[str, list[float]] = defaultdict(list)

    @property
    def minutes(self) -> float:
        """Minutes trained in total, earlier runs included."""
        return self._trained + (time.monotonic() - self._start) / 60

    @property
    def finished(self) -> bool:
        """Whether the time is over."""
        return self.minutes >= self._minutes

    @property
    def share(self) -> float:
        """Share of the planned time that has passed, 0 to 1."""
        return min(1.0, self.minutes / max(self._minutes, 1e-9))

    def add(self, **values: float) -> None:
        """Note values; their means appear in the next line."""
        for name, value in values.items():
            self._values[name].append(value)

    def line(self, every: float, shown: tuple[str, ...]) -> bool:
        """Print and log if ``every`` seconds have passed since the last line."""
        now = time.monotonic()
        if now - self._last_line < every:
            return False
        rate = (self.steps - self._line_steps) / (now - self._last_line)
        self._last_line, self._line_steps = now, self.steps
        means = {name: sum(v) / len(v) for name, v in self._values.items() if v}
        for name, value in means.items():
            self._writer.add_scalar(name, value, self.steps)
        self._writer.add_scalar("rate/steps_per_s", rate, self.steps)
        self._values.clear()
        text = "  ".join(f"{name} {means[name]:.3g}" for name in shown if name in means)
        left = max(0.0, self._minutes - self.minutes)
        print(
            f"{self.minutes:6.1f} min  {self.steps / 1e6:7.2f} M steps  "
            f"{rate:6.0f}/s  ETA {left:5.1f} min  {text}",
            flush=True,
        )
        return True

    def close(self) -> None:
        """Flush the event file."""
        self._writer.close()
