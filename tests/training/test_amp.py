"""Adversarial motion priors: toy distributions, finite differences, the task."""

import math
from dataclasses import replace

import pytest
import torch

from openclone.robot import g1
from openclone.training.amp import (
    FEATURES,
    AmpConfig,
    AmpStyle,
    Discriminator,
    Replay,
    discriminator_loss,
    gradient_penalty,
    lower_body,
)
from openclone.training.reward_table import RewardWeights

SMALL = AmpConfig(hidden=(32, 16), batch=64, updates=2, learning_rate=1e-3)


def test_constants_of_the_paper_preset():
    config = AmpConfig()
    assert config.hidden == (1024, 512)
    assert config.replay == 200_000
    assert (config.gradient_penalty, config.logit_regularization) == (5.0, 0.01)


def test_reward_is_minus_log_of_one_minus_d():
    net = Discriminator(2, (4,))
    with torch.no_grad():
        net.logit.weight.zero_()
        net.logit.bias.fill_(1.5)
    d = 1 / (1 + math.exp(-1.5))
    got = net.reward(torch.zeros(1, 2)).item()
    assert got == pytest.approx(-math.log(1 - d), rel=1e-5)


def test_reward_stays_finite():
    net = Discriminator(2, (4,))
    with torch.no_grad():
        net.logit.bias.fill_(1e6)
    assert net.reward(torch.zeros(1, 2)).item() == pytest.approx(-math.log(1e-4), 1e-3)
    with torch.no_grad():
        net.logit.bias.fill_(-1e6)
    assert net.reward(torch.zeros(1, 2)).item() == 0.0


def test_gradient_penalty_equals_finite_differences():
    torch.manual_seed(0)
    net = Discriminator(3, (8, 8)).double()
    points = torch.randn(6, 3, dtype=torch.double)
    step = 1e-6
    squares = torch.zeros(6, dtype=torch.double)
    for axis in range(3):
        offset = torch.zeros(3, dtype=torch.double)
        offset[axis] = step
        with torch.no_grad():
            slope = (net(points + offset) - net(points - offset)) / (2 * step)
        squares += slope**2
    got = gradient_penalty(net, points).item()
    assert got == pytest.approx(squares.mean().item(), rel=1e-6)


def test_loss_by_hand():
    net = Discriminator(1, (1,))
    with torch.no_grad():
        net.body[0].weight.fill_(1.0)
        net.body[0].bias.zero_()
        net.logit.weight.fill_(2.0)
        net.logit.bias.zero_()
    # Logits 2 x at x > 0: 2 for the real one, 4 for the robot's; slope 2.
    loss, logs = discriminator_loss(
        net, torch.tensor([[1.0]]), torch.tensor([[2.0]]), AmpConfig()
    )
    entropy = 0.5 * (math.log(1 + math.exp(-2)) + math.log(1 + math.exp(4)))
    assert loss.item() == pytest.approx(entropy + 5 * 4 + 0.01 * 4, rel=1e-5)
    assert (logs["amp/accuracy_real"], logs["amp/accuracy_robot"]) == (1.0, 0.0)


def test_separates_two_toy_distributions():
    rng = torch.Generator().manual_seed(0)
    torch.manual_seed(0)
    net = Discriminator(2, (32, 16))
    config = AmpConfig(gradient_penalty=0.1)
    optimizer = torch.optim.Adam(net.parameters(), 3e-3)

    def draw(centre: float) -> torch.Tensor:
        return centre + 0.5 * torch.randn(256, 2, generator=rng)

    for _ in range(150):
        loss, _ = discriminator_loss(net, draw(1.0), draw(-1.0), config)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    real, robot = net.reward(draw(1.0)), net.reward(draw(-1.0))
    assert (net(draw(1.0)) > 0).float().mean() > 0.95
    assert (net(draw(-1.0)) < 0).float().mean() > 0.95
    assert real.mean() > 3 * robot.mean()


def test_replay_keeps_the_newest():
    replay = Replay(5, 1, torch.device("cpu"))
    rng = torch.Generator().manual_seed(0)
    replay.add(torch.arange(3.0)[:, None])
    assert set(replay.sample(60, rng).flatten().tolist()) == {0.0, 1.0, 2.0}
    replay.add(torch.arange(3.0, 7.0)[:, None])
    assert replay.count == 5
    assert set(replay.sample(200, rng).flatten().tolist()) == {2.0, 3, 4, 5, 6}
    replay.add(torch.arange(10.0, 19.0)[:, None])  # more than fits
    assert set(replay.sample(200, rng).flatten().tolist()) == {14.0, 15, 16, 17, 18}


def test_features_do_not_depend_on_place_heading_or_arms(reference):
    state = reference.at(torch.tensor([40]))
    assert lower_body(state).shape == (1, FEATURES)
    half = math.sqrt(0.5)
    position = state.body_position.clone()
    turned = torch.stack((-position[..., 1], position[..., 0], position[..., 2]), -1)
    velocity, spin = state.body_velocity, state.body_angular_velocity

    def quarter(vector: torch.Tensor) -> torch.Tensor:
        return torch.stack((-vector[..., 1], vector[..., 0], vector[..., 2]), -1)

    w, x, y, z = state.body_quat.unbind(-1)
    quat = half * torch.stack((w - z, x - y, y + x, z + w), -1)
    angles = state.joint_angles.clone()
    angles[:, 20] += 0.5
    moved = replace(
        state,
        body_position=turned + torch.tensor([3.0, -2.0, 0.0]),
        body_quat=quat,
        body_velocity=quarter(velocity),
        body_angular_velocity=quarter(spin),
        joint_angles=angles,
    )
    torch.testing.assert_close(lower_body(moved), lower_body(state))
    knee = g1.joint_index("left_knee_joint")
    angles[:, knee] += 0.5
    assert (lower_body(moved) - lower_body(state)).abs().max() == pytest.approx(0.5)


def test_real_transitions_never_cross_clips(reference):
    style = AmpStyle(reference, SMALL, 0)
    ends = {150, 251}  # last frames of the two clips
    assert not ends & set(style._starts.tolist())
    assert len(style._starts) == 250
    assert style.real(10).shape == (10, 2 * FEATURES)


def test_the_task_pays_style_and_the_discriminator_learns(make_task, reference):
    torch.manual_seed(0)
    task = make_task(8, weights=RewardWeights(amp=2.0, root_position=1.0))
    style = AmpStyle(reference, SMALL, 0)
    task.style = style
    before = [p.clone() for p in style.net.parameters()]
    with torch.inference_mode():
        for _ in range(4):
            state = task.robot_state()
            result = task.step(task.residual_to_target(torch.zeros(8, 29)))
            assert result.terms["amp"] > 0
        last = style._fresh[-1]
        # The two halves of a transition are two instants.
        assert (last[:, :FEATURES] - last[:, FEATURES:]).abs().max() > 1e-3
        first = (lower_body(state) - style._mean) / style._spread
    torch.testing.assert_close(last[:, :FEATURES], first.clamp(-20, 20))
    logs = style.update()
    assert all(math.isfinite(value) for value in logs.values())
    after = style.net.parameters()
    changed = [not torch.equal(a, b) for a, b in zip(before, after, strict=True)]
    assert all(changed)


def test_broken_states_do_not_poison_the_replay(reference):
    style = AmpStyle(reference, SMALL, 0)
    state = reference.at(torch.tensor([0, 1]))
    state.joint_velocities[0] = float("nan")
    state.joint_velocities[1] = 1e30
    reward = style(state, state)
    assert torch.isfinite(reward).all()
    assert all(math.isfinite(value) for value in style.update().values())


def test_state_survives_a_checkpoint(reference):
    style, other = (AmpStyle(reference, SMALL, seed) for seed in (0, 1))
    style(reference.at(torch.arange(4)), reference.at(torch.arange(1, 5)))
    style.update()
    other.load_state_dict(style.state_dict())
    rows = style.real(5)
    assert torch.equal(style.net(rows), other.net(rows))
