"""Another back-end of the physics beside MuJoCo's threads: what both have to do."""

import numpy as np
import torch

from openclone.robot import g1
from openclone.robot.model import SUBSTEPS, standing_qpos
from openclone.training.randomization import (
    TABLE_A2,
    RandomizationConfig,
    draw_parameters,
)
from openclone.training.task import TrackingTask
from openclone.training.task_config import TaskConfig
from openclone.training.terrain import build_training_model


def converging_model():
    """Training's model, with a solver that goes on until it has converged.

    Training stops it after 5 iterations; where that is too early, the two solvers stop
    at different points and the joints differ by up to 0.013 rad.
    """
    model = build_training_model()
    model.opt.iterations, model.opt.ls_iterations = 100, 50
    return model


def births(robots):
    rng = np.random.default_rng(0)
    qpos = np.tile(standing_qpos(), (robots, 1))
    qpos[:, 0] = np.arange(robots)
    qpos[:, 7:] += 0.05 * rng.standard_normal((robots, 29))
    return qpos, 0.1 * rng.standard_normal((robots, 35))


def targets(robots, rng):
    noise = 0.04 * rng.standard_normal((robots, 1, 29))
    return torch.from_numpy(g1.DEFAULT_POSE + noise).expand(-1, SUBSTEPS, -1)


def run(physics, steps):
    """qpos, qvel and sensors after each of ``steps``, robot 1 pushed in the tenth."""
    robots = physics.num_envs
    physics.reset(np.arange(robots), *births(robots))
    rng = np.random.default_rng(1)
    states = []
    for step in range(steps):
        if step == 10:
            physics.push(np.array([1]), np.array([[0.3, -0.1, 0.0]]))
        physics.step(targets(robots, rng))
        states.append([part.double().numpy() for part in physics.read()])
    return [np.stack(parts) for parts in zip(*states, strict=True)]


def check_same_trajectory(threaded, other, layout):
    """Over fifty steps, with all sensors while contacts amplify nothing yet."""
    expected, found = run(threaded, 50), run(other, 50)
    qpos = expected[0]
    assert np.abs(qpos[-1] - qpos[0]).max() > 0.05
    # Single against double precision, metres and radians; contacts amplify it.
    np.testing.assert_allclose(found[0][:20], qpos[:20], atol=2e-5)
    np.testing.assert_allclose(found[0], qpos, atol=1e-2)
    tolerances = {
        "position": 2e-4, "quat": 2e-4, "velocity": 2e-4, "angular_velocity": 2e-4,
        "gyro": 2e-4, "torque": 0.5, "foot_force": 0.5, "accelerometer": 0.05,
    }  # fmt: skip
    for part, tolerance in tolerances.items():
        span = getattr(layout, part)
        np.testing.assert_allclose(
            found[2][:5, :, span], expected[2][:5, :, span], atol=tolerance
        )


def check_reset_leaves_others_alone(physics):
    run(physics, 3)
    before = [part.numpy().copy() for part in physics.read()]
    qpos, qvel = births(physics.num_envs)
    physics.reset(np.array([1]), qpos[:1], qvel[:1])
    after = [part.numpy() for part in physics.read()]
    others = np.arange(physics.num_envs) != 1
    for old, new in zip(before, after, strict=True):
        np.testing.assert_array_equal(new[others], old[others])
        assert not np.array_equal(new[1], old[1])
    np.testing.assert_allclose(after[0][1], qpos[0], atol=1e-6)


def check_row_acts_alike(threaded, other, row):
    """A row of Table A2 changes the motion, on both back-ends alike."""
    only = RandomizationConfig(**{row: getattr(TABLE_A2, row)})
    if row == "friction":
        only = RandomizationConfig(friction=(0.05, 0.1))  # slides, so that it matters
    pair, robots = (threaded, other), np.arange(threaded.num_envs)

    def drawn(config):
        rng = np.random.default_rng(3)
        return draw_parameters(config, len(robots), threaded.links, rng)

    plain = run(threaded, 8)[0]
    for physics in pair:
        physics.randomize(robots, drawn(only))
    qpos, found = (run(physics, 8)[0] for physics in pair)
    assert np.abs(plain - qpos).max() > 1e-3
    np.testing.assert_allclose(found, qpos, atol=2e-4)
    for physics in pair:
        physics.randomize(robots, drawn(RandomizationConfig()))


def check_same_task(threaded, other, layout, reference, randomization):
    """The same rewards and observations of the same task, on both back-ends."""

    def play(physics):
        config = TaskConfig(num_envs=physics.num_envs, randomization=randomization)
        task = TrackingTask(reference, physics, layout, config, 0)
        rewards = []
        for _ in range(10):
            still = torch.zeros(physics.num_envs, 29)
            rewards.append(task.step(task.residual_to_target(still)).reward)
        return torch.stack(rewards), task.teacher_observation()

    (rewards, seen), (found, found_seen) = (play(p) for p in (threaded, other))
    assert float(rewards.abs().max()) > 0.01
    torch.testing.assert_close(found, rewards, atol=1e-3, rtol=0)
    torch.testing.assert_close(found_seen, seen, atol=2e-2, rtol=0)


def check_copies_do_alike(physics):
    """Copies move as their source does, and keep their bodies when it gets another."""
    robots, last = np.arange(physics.num_envs), physics.num_envs - 1
    rng = np.random.default_rng(3)

    def rebuild(ids, config):
        bodies = draw_parameters(config, len(ids), physics.links, rng)
        physics.randomize(ids, bodies)

    def step():
        still = torch.from_numpy(np.tile(g1.DEFAULT_POSE, (len(robots), SUBSTEPS, 1)))
        for _ in range(5):
            physics.step(still)
        return physics.read()

    rebuild(robots, TABLE_A2)
    physics.reset(robots, *births(len(robots)))
    before = step()
    sources = np.where(robots == last, last, 0)
    physics.copy(sources)
    for old, new in zip(before, physics.read(), strict=True):
        torch.testing.assert_close(new, old[sources])
    for part in step():
        torch.testing.assert_close(part[:last], part[:1].expand(last, -1))
        assert (part[last] - part[0]).abs().max() > 1e-3
    rebuild(robots[:1], RandomizationConfig(link_mass=(2.0, 2.0)))
    qpos = step()[0]
    assert (qpos[0] - qpos[1]).abs().max() > 1e-4
    torch.testing.assert_close(qpos[1:last], qpos[1:2].expand(last - 1, -1))
    rebuild(robots, RandomizationConfig())
