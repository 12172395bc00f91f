"""What DAgger keeps gives back what the students saw."""

import numpy as np
import torch

from openclone.policy.observation import FRAME_SIZE, TASK_SIZE, History
from openclone.training.demonstrations import Demonstrations, round_bytes

ROBOTS, STEPS, LENGTH = 3, 4, 5
RNG = np.random.default_rng(0)


class Students:
    """Inputs as a `StudentView` builds them, from random frames."""

    def __init__(self):
        self.random = torch.Generator().manual_seed(0)
        self.history = History(self.frame(), LENGTH)
        self.tasks = self.noise(TASK_SIZE)

    def noise(self, size):
        return torch.randn(ROBOTS, size, generator=self.random)

    def frame(self):
        return self.noise(FRAME_SIZE)

    def observe(self):
        return torch.cat((self.tasks, self.history.flat()), -1)

    def step(self, ended):
        frame = self.frame()
        self.history.push(frame)
        self.history.refill(ended, frame[ended])
        self.tasks = self.noise(TASK_SIZE)


def recorded(rounds, kept):
    students, seen = Students(), []
    demonstrations = Demonstrations(kept, STEPS, students.observe(), RNG)
    ends = {2: [0], 3: [0, 2], 7: [1], 9: [0, 1, 2]}
    for number in range(rounds):
        for step in range(STEPS):
            inputs, labels = students.observe(), students.noise(29)
            ended = torch.tensor(ends.get(number * STEPS + step, []), dtype=torch.long)
            demonstrations.add(inputs, labels, ended)
            seen.append((inputs, labels))
            students.step(ended)
    return demonstrations, seen


def test_every_input_comes_back_as_it_was_seen():
    demonstrations, seen = recorded(rounds=3, kept=3)
    inputs, labels = demonstrations._rows(torch.arange(3 * STEPS * ROBOTS))
    assert torch.equal(inputs, torch.cat([pair[0] for pair in seen]))
    assert torch.equal(labels, torch.cat([pair[1] for pair in seen]))


def test_the_newest_rounds_are_kept():
    demonstrations, seen = recorded(rounds=5, kept=2)
    inputs, labels = demonstrations.draw(200)
    known = {pair[0][robot].numpy().tobytes() for pair in seen[-2 * STEPS :]
             for robot in range(ROBOTS)}  # fmt: skip
    assert {row.numpy().tobytes() for row in inputs} == known
    assert labels.shape == (200, 29)


def test_only_filled_rounds_are_drawn():
    demonstrations, seen = recorded(rounds=1, kept=100)
    drawn = demonstrations.draw(64)[1]
    labels = torch.cat([pair[1] for pair in seen])
    assert (drawn[:, None] == labels).all(-1).any(-1).all()


def test_newest_grows_with_the_round():
    students = Students()
    demonstrations = Demonstrations(2, STEPS, students.observe(), RNG)
    assert demonstrations.newest() == {}
    none = torch.zeros(0, dtype=torch.long)
    demonstrations.add(students.observe(), students.noise(29), none)
    shapes = {k: tuple(v.shape) for k, v in demonstrations.newest().items()}
    assert shapes == {
        "frames": (LENGTH, ROBOTS, FRAME_SIZE),
        "tasks": (1, ROBOTS, TASK_SIZE),
        "labels": (1, ROBOTS, 29),
    }


def test_memory_is_what_is_planned():
    demonstrations, _ = recorded(rounds=1, kept=7)
    held = [v for v in vars(demonstrations).values() if isinstance(v, torch.Tensor)]
    stored = sum(v.numel() * v.element_size() for v in held if v.ndim == 4)
    stored += demonstrations._oldest.numel() * 2
    assert stored == 7 * round_bytes(ROBOTS, STEPS, LENGTH)
