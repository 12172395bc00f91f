"""Sums over control steps, kept where the robots are until they are asked for."""

from __future__ import annotations

import torch

from openclone.robot.model import CONTROL_PERIOD
from openclone.training.progress import Progress
from openclone.training.task import StepResult, TrackingTask


class Tally:
    """Reward terms, terminations, body error and episodes that ended.

    On a GPU, asking for a number waits for everything before it; so one transfer
    follows a whole roll-out instead of twenty a step.
    """

    def __init__(self, task: TrackingTask) -> None:
        """Begin at zero, on the device of ``task``."""
        self._categories = task.reference.category_names
        self._episodes = torch.zeros(2, len(self._categories), device=task.device)
        self._names: tuple[str, ...] = ()
        self._sums: torch.Tensor | None = None
        self._steps = 0

    def add(self, result: StepResult, **more: torch.Tensor) -> None:
        """Take in a step and other scalars of it."""
        values = {
            "falls/1000": 1000.0 * result.terminated.float().mean(),
            "error_mm": 1000.0 * result.error,
            "reward": result.reward.mean() / CONTROL_PERIOD,
            **more,
            **{f"reward/{name}": value for name, value in result.terms.items()},
        }
        newest = torch.stack(tuple(values.values()))
        self._sums = newest if self._sums is None else self._sums + newest
        self._names, self._steps = tuple(values), self._steps + 1
        ended = torch.stack((result.timed_out, result.done)).float()
        self._episodes.index_add_(1, result.category, ended)

    def report(self, progress: Progress) -> None:
        """Give the means to ``progress`` and begin again.

        ``success/<category>`` is the share of a category's episodes that came to their
        end without failure, from the starts that training draws, with exploration.
        """
        if self._sums is None:
            return
        means = (self._sums / self._steps).cpu().tolist()
        progress.add(**dict(zip(self._names, means, strict=True)))
        survived, ended = self._episodes.cpu().tolist()
        for name, good, all_ in zip(self._categories, survived, ended, strict=True):
            outcomes = [1.0] * round(good) + [0.0] * round(all_ - good)
            progress.add_all(f"success/{name}", outcomes)
        self._sums, self._steps = None, 0
        self._episodes = torch.zeros_like(self._episodes)
