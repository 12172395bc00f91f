"""Springs between a robot's legs and the reference's."""

from dataclasses import replace

import pytest
import torch

from openclone.training.guidance import guided


@pytest.fixture
def targets(make_task):
    """Targets of a guidance for robots at the reference, moved by so much."""
    task = make_task(2)
    reference = task.next_reference()
    ahead = task.reference.feedforward[task.next_frame()]

    def found(guidance, angles=0.0, velocities=0.0):
        robot = replace(
            reference,
            joint_angles=reference.joint_angles + angles,
            joint_velocities=reference.joint_velocities + velocities,
        )
        return guided(guidance, robot, reference, ahead)

    return found


def test_springs_rest_where_the_legs_are_the_references(targets):
    torch.testing.assert_close(targets("springs"), targets("arms"))


@pytest.mark.parametrize(("kind", "pull"), [("angles", 0.02), ("velocities", 0.001)])
def test_springs_draw_legs_back_and_nothing_else(targets, kind, pull):
    drawn = targets("arms") - targets("springs", **{kind: 0.1})
    torch.testing.assert_close(drawn[:, :12], torch.full((2, 12), pull))
    assert not drawn[:, 12:].any()


def test_gradients_pass_through_springs(targets):
    away = torch.zeros(2, 29, requires_grad=True)
    targets("springs", angles=away).sum().backward()
    assert away.grad is not None
    torch.testing.assert_close(away.grad[:, :12], torch.full((2, 12), -0.2))
    assert not away.grad[:, 12:].any()
