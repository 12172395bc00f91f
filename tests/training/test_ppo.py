"""What PPO is told about a step."""

import copy
from dataclasses import replace

import pytest
import torch
from tensordict import TensorDict

from openclone.training.ppo import (
    PpoConfig,
    build_ppo,
    mlp_model,
    resume_ppo,
)
from openclone.training.teacher_view import GROUP, TeacherEnvironment

CONFIG = PpoConfig(steps=5, hidden=(16,), initial_std=0.05)


@pytest.fixture
def roll_out(make_task, explore):
    """PPO's storage after one roll-out from the birth of all robots, and the task."""

    def run(**settings):
        env = TeacherEnvironment(make_task(6, failure_share=0.0, **settings))
        env.task.age[:] = 0
        return explore(env, CONFIG), env.task

    return run


def test_without_pushes_credit_flows_through(roll_out):
    storage, _ = roll_out(push_speed=0.0, push_interval=0.02)
    assert not storage.dones.any()


def test_a_push_cuts_credit_but_no_episode(roll_out):
    """The value that PPO expected stands for all that follows."""
    storage, task = roll_out(push_speed=0.1, push_interval=0.02)
    assert storage.dones.all()
    assert (task.age == CONFIG.steps).all()
    torch.testing.assert_close(storage.returns, storage.rewards)
    plain = storage.rewards - CONFIG.discount * storage.values
    assert plain.min() > 0.0
    assert plain.max() < 0.5


def test_steps_say_who_was_pushed(make_task):
    task = make_task(400, push_interval=0.1, push_speed=0.5)
    before = task.robot_state().body_velocity[:, 0]
    result = task.step(task.residual_to_target(torch.zeros(400, 29)))
    assert 40 < int(result.pushed.sum()) < 120
    alive = ~result.done
    change = (task.robot_state().body_velocity[:, 0] - before)[:, :2].norm(dim=-1)
    kicked = change[alive & result.pushed].mean()
    assert kicked > 2.0 * change[alive & ~result.pushed].mean()
    task.config = replace(task.config, push_speed=0.0)
    assert not task.step(task.base_targets()).pushed.any()


def small_ppo(config=CONFIG):
    """PPO on three observations, and these."""
    torch.manual_seed(0)
    seen = TensorDict({GROUP: torch.randn(8, 3)}, batch_size=[8])
    actor, critic = (mlp_model(seen, GROUP, size, config) for size in (29, 1))
    return build_ppo(seen, actor, critic, config), seen


def updated(ppo, seen):
    """``ppo`` after one update."""
    with torch.inference_mode():
        for _ in range(CONFIG.steps):
            ppo.act(seen)
            rewards, dones = torch.randn(8), torch.zeros(8, dtype=torch.bool)
            ppo.process_env_step(seen, rewards, dones, {"time_outs": dones})
        ppo.compute_returns(seen)
    ppo.update()
    return ppo


def test_only_the_actors_rate_follows_the_divergence():
    config = replace(CONFIG, learning_rate=1e-4, critic_rate=2e-3, kl=10.0)
    ppo, seen = small_ppo(config)
    actor, critic = updated(ppo, seen).optimizer.param_groups
    assert actor["lr"] == ppo.learning_rate > 1e-4
    assert critic["lr"] == 2e-3
    assert [id(p) for p in critic["params"]] == [id(p) for p in ppo.critic.parameters()]


def test_checkpoints_with_one_rate_for_both_go_on():
    """So PPO's optimizer was saved once, the packaged teacher's too."""
    ppo, seen = small_ppo()
    nets = (*ppo.actor.parameters(), *ppo.critic.parameters())
    ppo.optimizer = torch.optim.Adam(nets, lr=3e-5)
    content = copy.deepcopy(updated(ppo, seen).save())
    assert len(content["optimizer_state_dict"]["param_groups"]) == 1
    again, _ = small_ppo()
    resume_ppo(again, content)
    for old, new in zip(
        nets, (*again.actor.parameters(), *again.critic.parameters()), strict=True
    ):
        for name in ("exp_avg", "exp_avg_sq", "step"):
            saved, loaded = ppo.optimizer.state[old], again.optimizer.state[new]
            torch.testing.assert_close(loaded[name], saved[name])
    critic = updated(again, seen).optimizer.param_groups[1]
    assert critic["lr"] == CONFIG.critic_rate
