"""What PPO is told about a step."""

from dataclasses import replace

import pytest
import torch

from openclone.training.ppo import PpoConfig, build_ppo, collect, mlp_model
from openclone.training.progress import Budget, Progress
from openclone.training.tally import Tally
from openclone.training.teacher import GROUP, TeacherEnvironment

CONFIG = PpoConfig(steps=5, hidden=(16,), initial_std=0.05)


@pytest.fixture
def roll_out(make_task, tmp_path):
    """PPO's storage after one roll-out of an untrained teacher."""

    def run(**settings):
        torch.manual_seed(0)
        env = TeacherEnvironment(make_task(6, failure_share=0.0, **settings))
        env.task.age[:] = 0
        observations = env.observe()
        actor = mlp_model(observations, GROUP, 29, CONFIG)
        critic = mlp_model(observations, GROUP, 1, CONFIG)
        ppo = build_ppo(observations, actor, critic, CONFIG)
        progress = Progress(tmp_path, Budget(1.0))
        collect(env, ppo, CONFIG, progress, Tally(env.task), observations)
        progress.close()
        return ppo.storage, env.task

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
