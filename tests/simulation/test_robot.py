import mujoco
import numpy as np
import pytest

from openclone.robot import g1
from openclone.robot.model import CONTROL_PERIOD, SUBSTEPS, standing_qpos
from openclone.robot.state import key_point_velocities
from openclone.simulation.robot import FallLimits, SimulatedRobot
from openclone.spatial import rotations


@pytest.fixture(scope="module")
def robot() -> SimulatedRobot:
    return SimulatedRobot()


def test_starts_standing_and_stays_up_for_a_moment(robot: SimulatedRobot) -> None:
    robot.reset(standing_qpos())
    for _ in range(10):
        robot.write(g1.DEFAULT_POSE)
        robot.advance()
    assert robot.time == pytest.approx(10 * CONTROL_PERIOD)
    assert not robot.fallen()
    assert abs(robot.qpos[2] - g1.STANDING_HEIGHT) < 0.02


def test_free_fall_obeys_gravity(robot: SimulatedRobot) -> None:
    qpos = standing_qpos()
    qpos[2] = 3.0
    robot.reset(qpos)
    steps = 10
    for _ in range(steps):
        robot.write(g1.DEFAULT_POSE)
        robot.advance()
    t = steps * CONTROL_PERIOD
    mass = robot.model.body_mass.sum()
    com = robot.data.subtree_com[0] if mass else None
    start = SimulatedRobot(robot.model)
    start.reset(qpos)
    fallen = float(start.data.subtree_com[0][2] - com[2])
    # Semi-implicit Euler falls by g t (t + h) / 2.
    expected = 0.5 * 9.81 * t * (t + robot.model.opt.timestep)
    assert fallen == pytest.approx(expected, rel=1e-3)


def test_targets_move_the_joint(robot: SimulatedRobot) -> None:
    robot.reset(standing_qpos())
    target = g1.DEFAULT_POSE.copy()
    elbow = g1.joint_index("left_elbow_joint")
    target[elbow] += 0.3
    for _ in range(15):
        robot.write(target)
        robot.advance()
    moved = robot.reading().joint_angles[elbow] - g1.DEFAULT_POSE[elbow]
    assert moved == pytest.approx(0.3, abs=0.1)


def test_damping_has_no_stiffness(robot: SimulatedRobot) -> None:
    qpos = standing_qpos()
    qpos[2] = 5.0
    robot.reset(qpos)
    robot.write(g1.DEFAULT_POSE + 1.0)
    robot.damp()
    robot.advance()
    # In free fall with limp joints nothing drives them, whatever the last target was.
    assert np.abs(robot.reading().torque).max() < 0.5


def test_sensors_are_those_of_the_current_state(robot: SimulatedRobot) -> None:
    rng = np.random.default_rng(0)
    robot.reset(standing_qpos(), 0.3 * rng.standard_normal(35))
    robot.write(g1.DEFAULT_POSE)
    robot.advance()
    state = robot.true_state()
    fresh = mujoco.MjData(robot.model)
    fresh.qpos[:], fresh.qvel[:] = robot.qpos, robot.qvel
    mujoco.mj_forward(robot.model, fresh)
    for index, name in enumerate(g1.KEY_BODIES):
        np.testing.assert_allclose(
            state.body_position[index], fresh.body(name).xpos, atol=1e-9
        )


def test_the_imu_is_a_physics_step_older(robot: SimulatedRobot) -> None:
    speed = 0.3 * np.random.default_rng(0).standard_normal(35)
    robot.reset(standing_qpos(), speed)
    # The gyroscope measures the base's angular velocity in the pelvis frame.
    np.testing.assert_allclose(robot.reading().angular_velocity_b, speed[3:6])
    robot.write(g1.DEFAULT_POSE)
    before = mujoco.MjData(robot.model)
    before.qpos[:], before.qvel[:] = standing_qpos(), speed
    before.ctrl[:] = g1.DEFAULT_POSE
    for _ in range(SUBSTEPS - 1):
        mujoco.mj_step(robot.model, before)
    robot.advance()
    reading = robot.reading()
    np.testing.assert_allclose(reading.angular_velocity_b, before.qvel[3:6], atol=1e-6)
    np.testing.assert_allclose(reading.base_quat, before.qpos[3:7], atol=1e-9)
    assert np.abs(before.qvel[3:6] - robot.qvel[3:6]).max() > 1e-3


def test_head_velocity_agrees_with_finite_differences(robot: SimulatedRobot) -> None:
    rng = np.random.default_rng(1)
    robot.reset(standing_qpos(), 0.5 * rng.standard_normal(35))
    velocity = robot.head_velocity()
    np.testing.assert_allclose(
        velocity, key_point_velocities(robot.true_state())[0], atol=1e-9
    )
    data, step = mujoco.MjData(robot.model), 1e-6
    positions = []
    for sign in (-1, 1):
        data.qpos[:] = robot.qpos
        mujoco.mj_integratePos(robot.model, data.qpos, robot.qvel, sign * step)
        mujoco.mj_kinematics(robot.model, data)
        positions.append(data.site("head").xpos.copy())
    difference = (positions[1] - positions[0]) / (2 * step)
    np.testing.assert_allclose(velocity, difference, atol=1e-5)


def test_fall_detection(robot: SimulatedRobot) -> None:
    robot.reset(standing_qpos())
    assert not robot.fallen()
    low = standing_qpos()
    low[2] = 0.15
    robot.reset(low)
    assert robot.fallen()
    for pitch_deg, expected in ((55.0, False), (65.0, True)):
        tilted = standing_qpos()
        tilted[3:7] = rotations.from_axis_angle(
            np.array([0.0, 1.0, 0.0]), np.radians(pitch_deg)
        )
        robot.reset(tilted)
        assert robot.fallen() is expected
        assert robot.fallen(FallLimits(max_tilt_deg=90.0)) is False


def test_readings_are_copies(robot: SimulatedRobot) -> None:
    robot.reset(standing_qpos())
    reading, qpos = robot.reading(), robot.qpos
    angles = reading.joint_angles.copy()
    robot.write(g1.DEFAULT_POSE + 0.5)
    robot.advance()
    np.testing.assert_array_equal(reading.joint_angles, angles)
    np.testing.assert_array_equal(qpos, standing_qpos())
