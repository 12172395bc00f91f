"""Roll-outs of the student with all that it takes to repeat them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields

import torch

from openclone.policy.student import StudentModel
from openclone.robot.state import RobotState
from openclone.training.student_view import StudentView
from openclone.training.tally import Tally


@dataclass(frozen=True)
class Window:
    """A roll-out of n robots over T steps, and what it takes to repeat it.

    Attributes:
        qpos, qvel: (T + 1, n, 36) and (T + 1, n, 35).
        sensed: states as sensed, (T + 1, n, ...).
        frame: (T + 1, n), reference frame of the next step.
        look: (T + 1, n), whether the head's orientation is commanded.
        base: (T + 1, n, 29), radians, targets of the task's guidance.
        task_action, own_action: (T + 1, n, 29), previous actions as the task and as
            the student count them.
        error: (T + 1, n, 1, 3), metres, of the odometry.
        privileged: (T + 1, n, d), the critic's observation.
        history: (n, H, 93), frames at the beginning.
        action: (T, n, 29), what the student did, noise included.
        targets: (T, n, 29), radians, joint targets of that.
        reward: (T, n).
        cut: (T, n) bool, the step led elsewhere: an episode's end or a push.
        ended, terminated: (T, n) bool, an episode's end, and that by failure.
    """

    qpos: torch.Tensor
    qvel: torch.Tensor
    sensed: RobotState
    frame: torch.Tensor
    look: torch.Tensor
    base: torch.Tensor
    task_action: torch.Tensor
    own_action: torch.Tensor
    error: torch.Tensor
    privileged: torch.Tensor
    history: torch.Tensor
    action: torch.Tensor
    targets: torch.Tensor
    reward: torch.Tensor
    cut: torch.Tensor
    ended: torch.Tensor
    terminated: torch.Tensor

    def sensed_at(self, step: int) -> RobotState:
        """States as sensed before ``step``."""
        return each(self.sensed, lambda part: part[step])


def each(state: RobotState, work: Callable[[torch.Tensor], torch.Tensor]) -> RobotState:
    """``work`` done on every part of ``state``."""
    return RobotState(*(work(getattr(state, f.name)) for f in fields(RobotState)))


_MOMENT = (
    "qpos", "qvel", "frame", "look", "base", "task_action", "own_action", "error",
    "privileged",
)  # fmt: skip


@torch.no_grad()
def roll_out(
    view: StudentView,
    student: StudentModel,
    steps: int,
    std: float,
    random: torch.Generator,
    tally: Tally,
) -> Window:
    """Let the student act for ``steps`` steps, with noise of deviation ``std``."""
    task = view.task
    kept: dict[str, list[torch.Tensor]] = {name: [] for name in _MOMENT}
    done: dict[str, list[torch.Tensor]] = {
        name: []
        for name in ("action", "targets", "reward", "cut", "ended", "terminated")
    }
    sensed: list[RobotState] = []
    history = view.history.frames.clone()
    for step in range(steps + 1):
        qpos, qvel, _ = task.physics.read()
        moment = (
            qpos, qvel, task.next_frame(), task.look, task.base_targets(),
            task.action, view.action, view.error, task.reference_observation(),
        )  # fmt: skip
        for name, part in zip(_MOMENT, moment, strict=True):
            kept[name].append(part.clone())
        sensed.append(task.robot_state())
        if step == steps:
            break
        action = student.mean_action(view.observe())
        noise = torch.empty_like(action).normal_(generator=random)
        action = action + std * noise
        result = view.step(action)
        tally.add(result)
        results = (
            action, view.to_target(action), result.reward,
            result.done | result.pushed, result.done, result.terminated,
        )  # fmt: skip
        for name, part in zip(done, results, strict=True):
            done[name].append(part)
    stacked = {name: torch.stack(parts) for name, parts in {**kept, **done}.items()}
    states = RobotState(
        **{
            f.name: torch.stack([getattr(state, f.name) for state in sensed])
            for f in fields(RobotState)
        }
    )
    return Window(**stacked, sensed=states, history=history)
