"""Roll-outs of a policy with all that it takes to repeat them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields

import torch

from openclone.robot.state import RobotState
from openclone.training.pilots import Pilot
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
        task_action: (T + 1, n, 29), previous actions as the task counts them.
        privileged: (T + 1, n, d), the critic's observation.
        past: (n, ...), what the pilot remembered at the beginning.
        error: (T, n, ...), what was wrong with what it saw.
        action: (T, n, 29), what it did, noise included.
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
    privileged: torch.Tensor
    past: torch.Tensor
    error: torch.Tensor
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


_STATES = ("qpos", "qvel", "frame", "look", "base", "task_action", "privileged")
_STEPS = (
    "error", "action", "targets", "reward", "cut", "ended", "terminated",
)  # fmt: skip


@torch.no_grad()
def roll_out(
    pilot: Pilot, steps: int, std: float, random: torch.Generator, tally: Tally
) -> Window:
    """Let ``pilot`` act for ``steps`` steps, with noise of deviation ``std``."""
    task, past = pilot.task, pilot.past()
    kept: dict[str, list[torch.Tensor]] = {name: [] for name in _STATES + _STEPS}
    sensed: list[RobotState] = []
    for step in range(steps + 1):
        qpos, qvel, _ = task.physics.read()
        base = task.base_targets()
        state = (
            qpos, qvel, task.next_frame(), task.look, base, task.action,
            task.reference_observation(),
        )  # fmt: skip
        for name, part in zip(_STATES, state, strict=True):
            kept[name].append(part.clone())
        sensed.append(task.robot_state())
        if step == steps:
            break
        action = pilot.act()
        noise = torch.empty_like(action).normal_(generator=random)
        action, error = action + std * noise, pilot.error.clone()
        result = pilot.step(action)
        tally.add(result)
        done = (
            error, action, pilot.to_target(action, base), result.reward,
            result.done | result.pushed, result.done, result.terminated,
        )  # fmt: skip
        for name, part in zip(_STEPS, done, strict=True):
            kept[name].append(part)
    stacked = {name: torch.stack(parts) for name, parts in kept.items()}
    states = RobotState(
        **{
            f.name: torch.stack([getattr(state, f.name) for state in sensed])
            for f in fields(RobotState)
        }
    )
    return Window(**stacked, sensed=states, past=past)
