"""A student's errors in what its teacher sees."""

from dataclasses import replace

import pytest
import torch

from openclone.policy.teacher import COMMAND_SIZE, LEGS_SIZE
from openclone.training.guesses import GuessErrors
from openclone.training.teacher_view import CRITIC, GROUP, TeacherEnvironment

FULL = COMMAND_SIZE + LEGS_SIZE


def series(scale: float, steps: int = 400) -> torch.Tensor:
    """(steps, 200, d): errors of 200 robots."""
    nothing = torch.zeros(200, FULL)
    errors = GuessErrors(nothing, scale, 0)
    return torch.stack([errors(nothing) for _ in range(steps)])


def test_velocity_errors_are_those_of_the_root(make_task):
    """All that moves with the root is wrong by the same, and nothing else is."""
    task = make_task(3, view="command", guidance="pose")
    before = task.teacher_observation()
    state = task.robot_state()
    task._state = replace(
        state, body_velocity=state.body_velocity + torch.tensor([0.0, 0.0, 0.1])
    )
    moved = (task.teacher_observation() - before).abs().amax(0) > 1e-6
    wrong = series(1.0, 1)[0].abs().amax(0) > 0
    (vertical,) = torch.nonzero(moved).T
    assert len(vertical) == 3
    assert wrong[vertical].all()
    assert int(wrong[:COMMAND_SIZE].sum()) == 9


def test_errors_are_as_large_and_as_slow_as_stated():
    values = series(1.0)
    changing = torch.nonzero(values[0, 0])[:, 0]
    root, feet = changing[:3], changing[3:9]
    torch.testing.assert_close(values[..., root], values[..., feet[:3]])
    assert float(values[..., root].std()) == pytest.approx(0.05, rel=0.05)
    assert float(values[..., COMMAND_SIZE : COMMAND_SIZE + 15].std()) == pytest.approx(
        0.07, rel=0.05
    )
    # exp(-0.3 / 0.3) after fifteen control steps.
    now, later = values[:-15, :, root].flatten(), values[15:, :, root].flatten()
    slow = float((now * later).mean() / values[..., root].var())
    assert slow == pytest.approx(0.368, abs=0.04)


def test_the_scale_scales():
    torch.testing.assert_close(series(2.0, 3), 2.0 * series(1.0, 3))


def test_only_the_acting_teacher_errs(make_task):
    task = make_task(3, view="legs", guidance="arms")
    groups = TeacherEnvironment(task, 1.0).observe()
    torch.testing.assert_close(groups[CRITIC], task.reference_observation())
    exact = task.teacher_observation()
    assert float((groups[GROUP] - exact).abs().max()) > 0.01
    torch.testing.assert_close(TeacherEnvironment(task).observe()[GROUP], exact)


def test_a_teacher_that_sees_everything_guesses_nothing(make_task):
    with pytest.raises(ValueError, match="nothing to guess"):
        TeacherEnvironment(make_task(2), 1.0)
