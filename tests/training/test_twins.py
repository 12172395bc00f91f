"""Robots that begin a roll-out alike."""

from dataclasses import replace

import pytest
import torch

from openclone.errors import InputError
from openclone.training.ppo import PpoConfig
from openclone.training.presets import TEACHERS
from openclone.training.randomization import TABLE_A2
from openclone.training.teacher import TeacherTrainer, train_teacher
from openclone.training.teacher_view import GROUP, TeacherEnvironment
from openclone.training.twins import bounded, compared, leaders

COMMAND = {"view": "command", "guidance": "arms"}


def test_groups_are_as_large_as_asked():
    assert leaders(6, 3).tolist() == [0, 1, 0, 1, 0, 1]
    for count, size in ((6, 4), (6, 1), (2, 4)):
        with pytest.raises(InputError, match=f"{count} robots cannot form .* {size}"):
            leaders(count, size)


def test_what_twins_share_is_taken_away():
    """Two groups of two; the second's level and its scatter over time cancel."""
    shared = torch.tensor([[1.0, 50.0], [2.0, -30.0], [-4.0, 10.0]])
    own = torch.tensor([[0.1, -0.2], [0.3, 0.2], [-0.1, 0.1]])
    advantages = torch.cat((shared + own, shared - own), 1)
    gained = compared(advantages, torch.zeros(3, 4, dtype=torch.bool), 2)
    torch.testing.assert_close(gained, 2 * torch.cat((own, -own), 1))


def test_whose_episode_ended_is_no_twin_any_more():
    advantages = torch.tensor([[1.0, 3.0, 5.0], [2.0, 4.0, 9.0], [0.5, 0.2, 0.9]])
    done = torch.zeros(3, 3, dtype=torch.bool)
    done[1, 0] = True  # the step itself still counts
    wanted = torch.tensor([[-3.0, 0.0, 3.0], [-4.5, -1.5, 6.0], [0.5, -0.7, 0.7]])
    torch.testing.assert_close(compared(advantages, done, 3), wanted)


def test_no_advantage_outweighs_all_others():
    advantages = torch.tensor([-90.0, -1.0, 0.0, 1.0])
    found = bounded(advantages)
    torch.testing.assert_close(found.mean(), torch.tensor(0.0), atol=1e-6, rtol=0)
    torch.testing.assert_close(found.std(), torch.tensor(1.0))
    below = advantages.clamp(min=-float(advantages.std()))
    torch.testing.assert_close(found, (below - below.mean()) / below.std())


def test_a_baseline_of_others_adds_no_bias():
    """The mean of action noise times advantage stays; its scatter shrinks."""
    generator = torch.Generator().manual_seed(0)
    noise = torch.randn(50, 4000, generator=generator)
    luck = 10.0 * torch.randn(50, 1000, generator=generator).repeat(1, 4)
    advantages = luck + 0.5 * noise
    gained = bounded(compared(advantages, torch.zeros(50, 4000) > 0, 4))
    plain = (advantages - advantages.mean()) / advantages.std()
    credit, before = (gained * noise).mean(0), (plain * noise).mean(0)
    assert float(credit.mean()) > 10 * float(before.mean()) > 0.0


def test_twins_do_alike(make_task):
    """With delays, bodies, pushes' aftermath and errors of what is guessed."""
    flat = replace(TABLE_A2, terrain=("flat",), torque_injection=0.0)
    task = make_task(4, randomization=flat, push_speed=0.0, look_share=0.5, **COMMAND)
    env = TeacherEnvironment(task, guess_errors=1.0)
    still = torch.zeros(4, 29)
    for _ in range(4):
        env.step(torch.randn(4, 29))
    env.copy(leaders(4, 2))
    for _ in range(4):
        for group in env.observe().values():
            torch.testing.assert_close(group[2:], group[:2])
            assert not torch.allclose(group[0], group[1])
        result = env.step(still)
        torch.testing.assert_close(result.reward[2:], result.reward[:2])
        assert task.age[0] == task.age[2]
    env.step(torch.randn(4, 29))
    assert not torch.allclose(*env.observe()[GROUP][[0, 2]].unbind())


def test_every_roll_out_begins_with_twins(make_task, explore):
    config = PpoConfig(steps=3, hidden=(16,), twins=2)
    env = TeacherEnvironment(make_task(4, push_speed=0.0))
    storage = explore(env, config)
    first = storage.observations[GROUP][0]
    torch.testing.assert_close(first[2:], first[:2])
    raw = (storage.returns - storage.values)[..., 0]
    wanted = bounded(compared(raw, storage.dones[..., 0] > 0, 2))
    torch.testing.assert_close(storage.advantages[..., 0], wanted)


def test_a_teacher_learns_among_twins(make_clip, tmp_path):
    smoke = TEACHERS["smoke"]
    preset = replace(smoke, ppo=replace(smoke.ppo, twins=4), amp=None)
    path = train_teacher([make_clip()], preset, tmp_path, threads=1)
    trainer = TeacherTrainer([make_clip()], preset, 0, 1)
    before = [part.clone() for part in trainer.ppo.actor.parameters()]
    trainer.resume(path)
    after = trainer.ppo.actor.parameters()
    assert any(not torch.equal(a, b) for a, b in zip(after, before, strict=True))
