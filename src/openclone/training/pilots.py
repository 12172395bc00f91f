"""Who moves the robots of a roll-out, and what they would do in it once more.

Value gradients go through what a policy sees. Student and teacher see different things,
and differ in nothing else there.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import torch
from rsl_rl.models import MLPModel
from torch import nn

from openclone.policy.command import command_of
from openclone.policy.observation import History
from openclone.policy.student import StudentModel
from openclone.robot.state import RobotState
from openclone.training.student_view import StudentView, sensed_frame, student_input
from openclone.training.task import StepResult, TrackingTask
from openclone.training.teacher_view import TeacherEnvironment


@dataclass(frozen=True)
class Moment:
    """What n robots met before a control step.

    Attributes:
        robot: their states.
        reference: at t + 1.
        frame: (n,), of the reference.
        look: (n,) bool, whether the head's orientation is commanded.
        action: (n, 29), previous action as the task counts it.
        error: (n, ...), `Pilot.error`.
    """

    robot: RobotState
    reference: RobotState
    frame: torch.Tensor
    look: torch.Tensor
    action: torch.Tensor
    error: torch.Tensor


class Recall(Protocol):
    """A pilot that flies a roll-out once more."""

    def act(self, moment: Moment) -> torch.Tensor:
        """Mean actions ``(n, 29)``."""
        ...

    def went(
        self, robot: RobotState, action: torch.Tensor, born: torch.Tensor, /
    ) -> None:
        """Robots after ``action (n, 29)``; those in ``born`` have begun anew."""
        ...


class Pilot(Protocol):
    """A policy at the robots of a task."""

    error: torch.Tensor
    """(n, ...), what was wrong with what it saw last."""

    @property
    def network(self) -> nn.Module:
        """Whose weights learn."""
        ...

    @property
    def task(self) -> TrackingTask:
        """The robots."""
        ...

    def act(self) -> torch.Tensor:
        """Mean actions ``(n, 29)``."""
        ...

    def to_target(self, action: torch.Tensor, base: torch.Tensor, /) -> torch.Tensor:
        """Joint targets ``(n, 29)``, radians.

        Args:
            action: (n, 29).
            base: (n, 29), radians, targets of the task's guidance.
        """
        ...

    def step(self, action: torch.Tensor) -> StepResult:
        """Apply ``action (n, 29)`` for one control period."""
        ...

    def past(self) -> torch.Tensor:
        """What it remembers, (n, ...)."""
        ...

    def recall(self, past: torch.Tensor, /) -> Recall:
        """Begin once more where it remembered ``past``."""
        ...


def smooth(model: MLPModel) -> MLPModel:
    """``model`` for inference whose activations leave their inputs for gradients."""
    for layer in model.mlp:
        if isinstance(layer, nn.ELU):
            layer.inplace = False
    return model.eval()


# The student -------------------------------------------------------------------------


class StudentPilot:
    """A student; its routers stay as they are."""

    def __init__(self, view: StudentView, student: StudentModel) -> None:
        student.freeze_routing()
        self.view, self.student = view, student.eval()
        self.network, self.error = student.mlp, view.error

    @property
    def task(self) -> TrackingTask:
        """The robots."""
        return self.view.task

    def act(self) -> torch.Tensor:
        """Mean actions; the error is that of the odometry, (n, 1, 3), metres."""
        self.error = self.view.error
        return self.student.mean_action(self.view.observe())

    def to_target(self, action: torch.Tensor, _: torch.Tensor) -> torch.Tensor:
        """Joint targets; its actions are offsets to the default pose."""
        return self.view.to_target(action)

    def step(self, action: torch.Tensor) -> StepResult:
        """Apply ``action (n, 29)`` for one control period."""
        return self.view.step(action)

    def past(self) -> torch.Tensor:
        """Frames of history, (n, H, 93)."""
        return self.view.history.frames.clone()

    def recall(self, past: torch.Tensor) -> Recall:
        """Begin once more with the frames ``past``."""
        return _StudentRecall(self.student, past)


class _StudentRecall:
    def __init__(self, student: StudentModel, past: torch.Tensor) -> None:
        self._student, self._history = student, History(past[:, 0], 1)
        self._history.frames = past

    def act(self, moment: Moment) -> torch.Tensor:
        command = command_of(moment.reference, moment.look)
        seen = student_input(moment.robot, command, moment.error, self._history)
        return self._student.mean_action(seen)

    def went(self, robot: RobotState, action: torch.Tensor, born: torch.Tensor) -> None:
        frame = sensed_frame(robot, action)
        self._history.push(frame)
        self._history.refill(born, frame[born])


# The teacher -------------------------------------------------------------------------


class TeacherPilot:
    """A teacher, which remembers nothing."""

    def __init__(self, env: TeacherEnvironment, actor: MLPModel) -> None:
        self._env, self._actor = env, smooth(actor)
        self.network, self.error = actor.mlp, torch.zeros_like(env.task.action)

    @property
    def task(self) -> TrackingTask:
        """The robots."""
        return self._env.task

    def act(self) -> torch.Tensor:
        """Mean actions; the error is that of its guesses, (n, d)."""
        exact = self.task.teacher_observation()
        seen = self._env.guessed(exact)
        self.error = seen - exact
        return self._answer(seen)

    def _answer(self, seen: torch.Tensor) -> torch.Tensor:
        return self._actor.mlp(self._actor.obs_normalizer(seen))

    def to_target(self, action: torch.Tensor, base: torch.Tensor) -> torch.Tensor:
        """Joint targets; its actions are offsets to those of the task's guidance."""
        return base + self.task.action_scale * action

    def step(self, action: torch.Tensor) -> StepResult:
        """Apply ``action (n, 29)`` for one control period."""
        return self._env.step(action)

    def past(self) -> torch.Tensor:
        """Nothing, (n, 0)."""
        return self.error.new_zeros(self.task.num_envs, 0)

    def recall(self, _: torch.Tensor) -> Recall:
        """Begin once more."""
        return _TeacherRecall(self.task, self._answer)


class _TeacherRecall:
    def __init__(
        self, task: TrackingTask, answer: Callable[[torch.Tensor], torch.Tensor]
    ) -> None:
        self._task, self._answer = task, answer

    def act(self, moment: Moment) -> torch.Tensor:
        robot, action = moment.robot, moment.action
        if self._task.config.view == "reference":
            seen = self._task.observe_reference(robot, moment.frame, action)
        else:
            seen = self._task.observe_command(
                robot, moment.reference, moment.look, action
            )
        return self._answer(seen + moment.error)

    def went(self, *_: object) -> None:
        pass
