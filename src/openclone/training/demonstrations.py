"""What DAgger has collected: what students saw, and what the teacher says to it."""

from __future__ import annotations

import numpy as np
import torch

from openclone.policy.observation import FRAME_SIZE, TASK_SIZE
from openclone.robot import g1


class Demonstrations:
    """The newest rounds of roll-outs, from which batches are drawn evenly.

    Neighbouring inputs share all but one frame of history, so that keeping frames
    instead of inputs takes an eighth of the memory with rounds of 20 steps.
    """

    def __init__(
        self,
        rounds: int,
        steps: int,
        inputs: torch.Tensor,
        rng: np.random.Generator,
    ) -> None:
        """Make room.

        Args:
            rounds: how many are kept.
            steps: control steps T of a round.
            inputs: (n, 63 + H * 93), an example of what the students see.
            rng: draws the batches.
        """
        robots, size = inputs.shape
        self.history = (size - TASK_SIZE) // FRAME_SIZE
        self.rounds, self.steps, self.robots = rounds, steps, robots
        self.device = inputs.device
        self._rng = rng
        # The history before the first step of a round, then each step's newest frame.
        length = self.history - 1 + steps
        self._frames = inputs.new_empty(rounds, length, robots, FRAME_SIZE)
        self._tasks = inputs.new_empty(rounds, steps, robots, TASK_SIZE)
        self._labels = inputs.new_empty(rounds, steps, robots, g1.NUM_JOINTS)
        # The oldest frame of a step's episode; a history repeats it beyond.
        self._oldest = torch.zeros(
            rounds, steps, robots, dtype=torch.int16, device=self.device
        )
        self._born = torch.zeros_like(self._oldest[0, 0])
        self._begun, self._step = 0, steps

    def _begin(self, inputs: torch.Tensor) -> None:
        """Begin a round in place of the oldest."""
        past = inputs[:, TASK_SIZE + FRAME_SIZE :]
        past = past.reshape(self.robots, self.history - 1, FRAME_SIZE)
        place = self._begun % self.rounds
        self._frames[place, : self.history - 1] = past.flip(1).transpose(0, 1)
        self._born = torch.zeros_like(self._oldest[place, 0])
        self._begun, self._step = self._begun + 1, 0

    def add(
        self, inputs: torch.Tensor, labels: torch.Tensor, ended: torch.Tensor
    ) -> None:
        """Take in a step; after ``steps`` of them a new round begins.

        Args:
            inputs: (n, 63 + H * 93), what the students saw.
            labels: (n, 29), the teacher's actions.
            ended: ids of the robots that begin anew after this step.
        """
        if self._step == self.steps:
            self._begin(inputs)
        place, step = (self._begun - 1) % self.rounds, self._step
        self._tasks[place, step] = inputs[:, :TASK_SIZE]
        newest = self.history - 1 + step
        self._frames[place, newest] = inputs[:, TASK_SIZE : TASK_SIZE + FRAME_SIZE]
        self._labels[place, step] = labels
        self._oldest[place, step] = self._born
        self._born[ended] = newest + 1
        self._step = step + 1

    def newest(self) -> dict[str, torch.Tensor]:
        """The tensors of the newest round, for a look at them; none before any."""
        if not self._begun:
            return {}
        place, done = (self._begun - 1) % self.rounds, self._step
        frames = self._frames[place, : self.history - 1 + done]
        tasks, labels = self._tasks[place, :done], self._labels[place, :done]
        return {"frames": frames, "tasks": tasks, "labels": labels}

    def draw(self, count: int) -> tuple[torch.Tensor, torch.Tensor]:
        """``(count, 63 + H * 93)`` inputs and ``(count, 29)`` labels, evenly drawn."""
        filled = min(self._begun, self.rounds) * self.steps * self.robots
        drawn = torch.from_numpy(self._rng.integers(0, filled, count))
        return self._rows(drawn.to(self.device))

    def _rows(self, index: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
        """What the students saw at the steps ``index``, counted through all rounds."""
        place = index // (self.steps * self.robots)
        step = index // self.robots % self.steps
        robot = index % self.robots
        newest = step[:, None] + self.history - 1
        age = torch.arange(self.history, device=self.device)
        oldest = self._oldest.flatten().index_select(0, index)[:, None]
        row = torch.maximum(newest - age, oldest.long())
        row = (place[:, None] * self._frames.shape[1] + row) * self.robots
        frames = self._frames.flatten(0, 2)
        history = frames.index_select(0, (row + robot[:, None]).flatten())
        tasks = self._tasks.flatten(0, 2).index_select(0, index)
        inputs = torch.cat((tasks, history.reshape(len(index), -1)), -1)
        return inputs, self._labels.flatten(0, 2).index_select(0, index)


def round_bytes(robots: int, steps: int, history: int) -> float:
    """Memory of one round in `Demonstrations`."""
    frames = (history - 1 + steps) * FRAME_SIZE
    return robots * (4 * (frames + steps * (TASK_SIZE + g1.NUM_JOINTS)) + 2 * steps)
