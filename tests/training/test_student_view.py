"""Decision 1: training and the 50 Hz loop see the same observation."""

import numpy as np
import torch

from openclone.odometry.faults import OdometryFaultsConfig
from openclone.odometry.noise import OdometryNoiseConfig
from openclone.policy.command import Command, KeyPoints
from openclone.policy.controller import StudentController
from openclone.policy.observation import Proprioception, frame
from openclone.robot import g1
from openclone.robot.state import key_point_poses
from openclone.simulation.robot import SimulatedRobot
from openclone.spatial import rotations
from openclone.training.student_view import StudentView, sensed_frame

QUIET = OdometryNoiseConfig(c_vel=1e9, c_min=0.0)


class Scripted:
    """A bundle that replays actions and keeps what it was shown."""

    def __init__(self, info, actions):
        self.info, self.actions, self.seen = info, list(actions), []

    def act(self, observations):
        self.seen.append(observations[0])
        return self.actions.pop(0)[None]


def test_training_and_the_simulated_robot_sense_the_same(make_task):
    """The age of a sensor counts: a gyro 5 ms younger made walkers stray 2 cm more."""
    task = make_task(1, push_speed=0.0, displaced_share=0.0, standing_share=1.0)
    robot = SimulatedRobot()
    none, rng, differences = torch.zeros(1, 29), np.random.default_rng(0), []
    for _ in range(15):
        # Stamping, so that young and old sensors differ.
        targets = g1.DEFAULT_POSE + 0.3 * rng.standard_normal(29)
        robot.data.qpos[:], robot.data.qvel[:], _ = task.physics.read()
        assert not task.step(torch.tensor(targets[None], dtype=torch.float32)).done
        robot.write(targets.astype(np.float32))
        robot.advance()
        reading = robot.reading()
        now = Proprioception(
            joint_angles=reading.joint_angles,
            joint_velocities=reading.joint_velocities,
            angular_velocity_b=reading.angular_velocity_b,
            base_quat=reading.base_quat,
        )
        wanted = sensed_frame(task.robot_state(), none)[0].numpy()
        found = frame(now, np.zeros(29), np.array(g1.DEFAULT_POSE))
        differences.append(np.abs(found - wanted))
    # Now and then the solver ends elsewhere, as one of them knows its last solution.
    assert np.median(differences, axis=0).max() < 1e-4


def test_training_and_loop_agree(make_task):
    from openclone.policy.bundle import g1_info

    task = make_task(2, push_speed=0.0, displaced_share=0.0)
    task.age[:] = 0
    task.jump_to(torch.full((2,), 30))
    view = StudentView(task, 25, QUIET, np.random.default_rng(0))
    rng = np.random.default_rng(1)
    actions = 0.2 * rng.standard_normal((30, 2, 29)).astype(np.float32)
    controller = StudentController(Scripted(g1_info("", "", ""), actions[:, 0]))
    for action in actions:
        inputs = view.observe()
        state = task.robot_state()
        command = view.command()
        own = Command(
            KeyPoints(
                command.target.position[0].double().numpy(),
                command.target.quat[0].double().numpy(),
            ),
            command.velocity[0].double().numpy(),
            float(command.look[0]),
        )
        base = state.body_quat[0, g1.ROOT].double().numpy()
        spin = state.body_angular_velocity[0, g1.ROOT].double().numpy()
        now = Proprioception(
            joint_angles=state.joint_angles[0].double().numpy(),
            joint_velocities=state.joint_velocities[0].double().numpy(),
            angular_velocity_b=rotations.rotate_inverse(base, spin),
            base_quat=base,
        )
        points = key_point_poses(
            state.body_position[0].double().numpy(), state.body_quat[0].double().numpy()
        )
        targets = controller.step(own, now, KeyPoints(*points))
        np.testing.assert_allclose(
            controller._bundle.seen[-1], inputs[0].numpy(), atol=2e-5
        )
        torch.testing.assert_close(
            view.to_target(torch.from_numpy(action))[0].double(),
            torch.from_numpy(targets),
            atol=1e-5,
            rtol=0,
        )
        result = view.step(torch.from_numpy(action))
        assert not result.done.any()


def test_odometry_error_shifts_all_points_alike(make_task):
    task = make_task(3, push_speed=0.0)
    loud = OdometryNoiseConfig(c_vel=1.0, c_min=0.5, max_error=0.1, reset_period=1e9)
    view = StudentView(task, 25, loud, np.random.default_rng(0))
    before = view.observe()[:, :9].reshape(3, 3, 3)
    view.error[:] = torch.tensor([0.0, 0.0, 0.05])
    after = view.observe()[:, :9].reshape(3, 3, 3)
    shift = torch.zeros(3, 3, 3)
    shift[..., 2] = -0.05
    torch.testing.assert_close(after - before, shift, atol=1e-5, rtol=0)


def test_ended_episodes_start_with_a_fresh_history(make_task, reference):
    task = make_task(2, push_speed=0.0)
    view = StudentView(task, 25, QUIET, np.random.default_rng(0))
    task.age[:] = 0
    task.jump_to(torch.tensor([reference.last[0] - 1, 20]))
    view.step(torch.full((2, 29), 0.1))
    frames = view.history.frames
    assert torch.equal(frames[0, 0], frames[0, 24])
    assert not torch.equal(frames[1, 0], frames[1, 1])
    assert float(view.action[0].abs().max()) == 0.0


def test_odometry_faults_reach_the_command_only(make_task):
    held = OdometryFaultsConfig(scan_rate_hz=10.0, propagation=False)
    views = [
        StudentView(
            make_task(3, push_speed=0.0, displaced_share=0.0),
            25,
            QUIET,
            np.random.default_rng(0),
            faults,
        )
        for faults in (None, held)
    ]
    stale = 0.0
    for _ in range(12):
        plain, faulty = (view.observe() for view in views)
        # Nine numbers: target minus measured position of head and hands.
        difference = (faulty - plain)[:, :9].reshape(3, 3, 3)
        torch.testing.assert_close(
            difference, difference[:, :1].expand(-1, 3, -1), atol=1e-5, rtol=0
        )
        assert torch.equal(faulty[:, 9:], plain[:, 9:])
        stale = max(stale, float(difference.abs().max()))
        for view in views:
            view.step(torch.full((3, 29), 0.1))
    assert 1e-3 < stale < 0.1
