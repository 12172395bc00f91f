"""The teacher's side of the training task: privileged, with a student's doubts."""

from __future__ import annotations

import torch
from tensordict import TensorDict

from openclone.training.guesses import GuessErrors
from openclone.training.task import StepResult, TrackingTask

GROUP = "teacher"
CRITIC = "critic"
"""Observation of the critic, where it is not the teacher's."""


class TeacherEnvironment:
    """The task as the teacher plays it: privileged view, residual actions."""

    def __init__(
        self, task: TrackingTask, guess_errors: float = 0.0, seed: int = 0
    ) -> None:
        """Teachers see what students must guess with so large errors."""
        self.task = task
        self.num_envs = task.num_envs
        self._errors: GuessErrors | None = None
        if guess_errors:
            example = task.teacher_observation()
            self._errors = GuessErrors(example, guess_errors, seed)

    def guessed(self, seen: torch.Tensor) -> torch.Tensor:
        """``seen (n, d)``, as it is, with the errors of the next control step."""
        return self._errors(seen) if self._errors else seen

    def observe(self) -> TensorDict:
        """Group ``teacher``; and ``critic``, if the teacher does not see it all."""
        groups = {GROUP: self.guessed(self.task.teacher_observation())}
        if self.task.config.view != "reference":
            groups[CRITIC] = self.task.reference_observation()
        return TensorDict(groups, batch_size=[self.num_envs])

    def copy(self, sources: torch.Tensor) -> None:
        """Put every robot where robot ``sources (n,)[robot]`` is, with its past."""
        self.task.copy(sources)
        if self._errors is not None:
            self._errors.copy(sources)

    def step(self, action: torch.Tensor) -> StepResult:
        """Joint targets = what the task's guidance gives + scale x action."""
        return self.task.step(self.task.residual_to_target(action))
