"""Training progress: one line for the terminal, scalars for TensorBoard."""

from __future__ import annotations

import math
import time
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

from torch.utils.tensorboard import SummaryWriter

from openclone.training.distributed import team


@dataclass(frozen=True)
class Budget:
    """How long a run may take, earlier runs included; whatever ends first.

    Attributes:
        minutes: wall time; inf for none.
        iterations: collections and updates; None for no bound.
    """

    minutes: float
    iterations: int | None = None


@dataclass(frozen=True)
class Trained:
    """What earlier runs of the same training have done."""

    steps: int = 0
    minutes: float = 0.0
    iterations: int = 0


class Progress:
    """Collects values, prints a line with rate and ETA, and logs means.

    Args of the constructor: folder for the event file, when to stop, and what has
    already been trained before a resume.
    """

    def __init__(
        self, folder: Path, budget: Budget, trained: Trained | None = None
    ) -> None:
        trained = trained or Trained()
        # Of several processes that train together, one reports.
        self._writer = SummaryWriter(str(folder)) if team().leads else None
        self._budget = budget
        self.folder = folder
        self._start = self._last_line = time.monotonic()
        self._trained = trained
        self._line_steps = self.steps = trained.steps
        self.iterations = trained.iterations
        self._values: dict[str, list[float]] = defaultdict(list)

    @property
    def minutes(self) -> float:
        """Minutes trained in total, earlier runs included."""
        return self._trained.minutes + (time.monotonic() - self._start) / 60

    @property
    def trained(self) -> Trained:
        """Everything trained so far, for the checkpoint."""
        return Trained(self.steps, self.minutes, self.iterations)

    @property
    def finished(self) -> bool:
        """Whether the budget is spent."""
        bound = self._budget.iterations
        over = bound is not None and self.iterations >= bound
        return over or self.minutes >= self._budget.minutes

    @property
    def share(self) -> float:
        """Share of the budget that is spent, 0 to 1."""
        shares = [self.minutes / max(self._budget.minutes, 1e-9)]
        if self._budget.iterations is not None:
            shares.append(self.iterations / max(self._budget.iterations, 1))
        return min(1.0, max(shares))

    def add(self, **values: float) -> None:
        """Note values; their means appear in the next line."""
        for name, value in values.items():
            self._values[name].append(value)

    def add_all(self, name: str, values: list[float]) -> None:
        """Note several values of one quantity at once."""
        self._values[name] += values

    def line(self, every: float, shown: tuple[str, ...]) -> bool:
        """Print and log if ``every`` seconds have passed since the last line."""
        now = time.monotonic()
        if now - self._last_line < every:
            return False
        rate = (self.steps - self._line_steps) / (now - self._last_line)
        self._last_line, self._line_steps = now, self.steps
        self.add(**{"rate/steps_per_s": rate, "rate/minutes": self.minutes})
        means = self._log()
        if self._writer is None:
            return False
        text = "  ".join(f"{name} {means[name]:.3g}" for name in shown if name in means)
        print(
            f"{self.minutes:6.1f} min  {self.steps / 1e6:7.2f} M steps  "
            f"{rate:6.0f}/s  ETA {self._minutes_left():5.1f} min  {text}",
            flush=True,
        )
        return True

    def _log(self) -> dict[str, float]:
        """Write the means of what was noted since the last time; returns them."""
        means = {name: sum(v) / len(v) for name, v in self._values.items() if v}
        self._values.clear()
        if self._writer is not None:
            for name, value in means.items():
                self._writer.add_scalar(name, value, self.steps)
            self._writer.flush()
        return means

    def _minutes_left(self) -> float:
        share = self.share
        spent = self.minutes - self._trained.minutes
        if math.isfinite(self._budget.minutes) or share <= 0:
            return max(0.0, self._budget.minutes - self.minutes)
        done = share - self._trained.iterations / max(self._budget.iterations or 1, 1)
        return spent / max(done, 1e-9) * (1.0 - share)

    def close(self) -> None:
        """Log what is left and close the event file."""
        self._log()
        if self._writer is not None:
            self._writer.close()
