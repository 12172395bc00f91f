"""The assembled model against mechanics and MuJoCo's own quantities."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from openclone.robot import g1, model, state
from openclone.robot.kinematics import Kinematics

GRAVITY = 9.81


@pytest.fixture(scope="module")
def robot() -> mujoco.MjModel:
    return model.build_model()


def moving(robot: mujoco.MjModel, seed: int) -> mujoco.MjData:
    """The robot in the air in a random pose, moving and steered at random."""
    rng = np.random.default_rng(seed)
    data = mujoco.MjData(robot)
    data.qpos[:3] = rng.uniform([-1, -1, 2], [1, 1, 4])
    data.qpos[3:7] = Rotation.random(random_state=seed).as_quat()[[3, 0, 1, 2]]
    data.qpos[7:] = rng.uniform(g1.JOINT_LOWER, g1.JOINT_UPPER)
    data.qvel[:] = rng.normal(0, 1, robot.nv)
    data.ctrl[:] = rng.uniform(g1.JOINT_LOWER, g1.JOINT_UPPER)
    mujoco.mj_forward(robot, data)
    return data


def object_velocity(robot: mujoco.MjModel, data: mujoco.MjData, kind, index):
    """Angular and linear velocity in world axes, by MuJoCo."""
    out = np.zeros(6)
    mujoco.mj_objectVelocity(robot, data, kind, index, out, 0)
    return out[:3], out[3:]


def read(robot: mujoco.MjModel, data: mujoco.MjData) -> state.RobotState:
    layout = model.SensorLayout.of(robot)
    return state.read_state(layout, data.qpos, data.qvel, data.sensordata)


def test_layout_covers_every_sensor_once(robot) -> None:
    layout = model.SensorLayout.of(robot)
    parts = list(vars(layout).values())
    indices = np.concatenate([np.arange(part.start, part.stop) for part in parts])
    assert sorted(indices) == list(range(robot.nsensordata))


@pytest.mark.parametrize("seed", [1, 2])
def test_state_equals_mujocos_own_quantities(robot, seed) -> None:
    data = moving(robot, seed)
    found = read(robot, data)
    for place, name in enumerate(g1.KEY_BODIES):
        body = robot.body(name).id
        spin, speed = object_velocity(robot, data, mujoco.mjtObj.mjOBJ_XBODY, body)
        assert np.allclose(found.body_position[place], data.xpos[body])
        assert np.allclose(found.body_quat[place], data.xquat[body])
        assert np.allclose(found.body_velocity[place], speed)
        assert np.allclose(found.body_angular_velocity[place], spin)
    assert np.allclose(found.torque, data.actuator_force)
    assert np.array_equal(found.joint_angles, data.qpos[7:])
    assert np.array_equal(found.joint_velocities, data.qvel[6:])
    assert np.allclose(found.foot_force, 0)


@pytest.mark.parametrize("seed", [3, 4])
def test_key_points_are_the_sites(robot, seed) -> None:
    data = moving(robot, seed)
    found = read(robot, data)
    positions, quats = state.key_point_poses(found.body_position, found.body_quat)
    speeds = state.key_point_velocities(found)
    alone = Kinematics().key_points(data.qpos)
    for place, name in enumerate(("head", "left_hand", "right_hand")):
        site = robot.site(name).id
        _, speed = object_velocity(robot, data, mujoco.mjtObj.mjOBJ_SITE, site)
        matrix = Rotation.from_quat(np.roll(quats[place], -1)).as_matrix()
        assert np.allclose(positions[place], data.site_xpos[site])
        assert np.allclose(matrix.ravel(), data.site_xmat[site])
        assert np.allclose(speeds[place], speed)
    assert np.allclose(alone[0], positions)
    assert np.allclose(alone[1], quats)


def test_motors_are_limited_pd_controllers(robot) -> None:
    data = moving(robot, 5)
    torque = g1.KP * (data.ctrl - data.qpos[7:]) - g1.KD * data.qvel[6:]
    clipped = np.clip(torque, -g1.MAX_TORQUE, g1.MAX_TORQUE)
    assert (clipped != torque).any()
    assert (clipped == torque).any()
    assert np.allclose(read(robot, data).torque, clipped)


def test_imu_measures_turning_and_proper_acceleration(robot) -> None:
    layout = model.SensorLayout.of(robot)
    data = mujoco.MjData(robot)
    data.qpos[:] = model.standing_qpos()
    data.qpos[2] = 3.0
    data.ctrl[:] = g1.DEFAULT_POSE
    data.qvel[3:6] = (0.0, 0.0, 0.7)
    mujoco.mj_forward(robot, data)
    assert np.allclose(data.sensordata[layout.gyro], [0, 0, 0.7], atol=1e-9)
    # An accelerometer shows nothing in free fall.
    data.qvel[:] = 0
    mujoco.mj_forward(robot, data)
    assert np.allclose(data.sensordata[layout.accelerometer], 0, atol=1e-6)


@pytest.fixture(scope="module")
def on_a_rail() -> mujoco.MjModel:
    """The robot with its pelvis on a vertical rail: it stands but cannot tip over."""
    spec = model.build_spec()
    model.add_floor(spec)
    for key in list(spec.keys):
        spec.delete(key)
    base = spec.joint("floating_base_joint")
    base.type = mujoco.mjtJoint.mjJNT_SLIDE
    base.axis = [0, 0, 1]
    return spec.compile()


def test_feet_carry_the_weight(on_a_rail) -> None:
    data = mujoco.MjData(on_a_rail)
    data.qpos[1:] = g1.DEFAULT_POSE
    data.ctrl[:] = g1.DEFAULT_POSE
    mujoco.mj_step(on_a_rail, data, nstep=800)
    layout = model.SensorLayout.of(on_a_rail)
    # The contact sensor reports what the foot does to the ground.
    forces = -data.sensordata[layout.foot_force].reshape(2, 3)
    weight = on_a_rail.body_subtreemass[1] * GRAVITY
    assert forces[:, 2].sum() == pytest.approx(weight, rel=1e-3)
    # The robot is nearly symmetric.
    assert np.allclose(forces[:, 2], weight / 2, rtol=0.03)
    assert np.allclose(data.sensordata[layout.gyro], 0, atol=1e-3)
    accelerometer = data.sensordata[layout.accelerometer]
    assert np.allclose(accelerometer, [0, 0, GRAVITY], atol=0.02)


def test_foot_force_obeys_newton_while_the_robot_lands(robot) -> None:
    """Over the first 0.2 s the feet's impulse explains the momentum gained."""
    data = mujoco.MjData(robot)
    data.qpos[:] = model.standing_qpos()
    data.ctrl[:] = g1.DEFAULT_POSE
    mass = robot.body_subtreemass[1]
    impulse = np.zeros(3)
    for _ in range(40):
        mujoco.mj_step1(robot, data)
        mujoco.mj_step2(robot, data)
        impulse += read(robot, data).foot_force.sum(0) * robot.opt.timestep
    mujoco.mj_forward(robot, data)
    mujoco.mj_subtreeVel(robot, data)
    gravity = np.array([0, 0, -GRAVITY]) * mass * data.time
    momentum = data.subtree_linvel[1] * mass
    assert impulse[2] > 0.5 * mass * GRAVITY * data.time
    assert np.allclose(impulse + gravity, momentum, atol=0.02 * mass * GRAVITY * 0.2)


@pytest.mark.parametrize("feet", ["spheres", "capsules"])
def test_soles_lie_at_the_stated_height(feet) -> None:
    robot = model.build_model(feet=feet)
    data = mujoco.MjData(robot)
    mujoco.mj_forward(robot, data)
    for side in ("left", "right"):
        ankle = robot.body(f"{side}_ankle_roll_link").id
        geoms = [
            index
            for index in range(robot.ngeom)
            if robot.geom(index).name.startswith(f"{side}_foot")
        ]
        assert len(geoms) == (4 if feet == "spheres" else 7)
        lowest = np.inf
        for index in geoms:
            radius, half = robot.geom_size[index][:2]
            along = data.geom_xmat[index].reshape(3, 3)[2, 2] * half
            height = data.geom_xpos[index][2] - radius - abs(along)
            lowest = min(lowest, height - data.xpos[ankle][2])
        assert lowest == pytest.approx(model.SOLE_Z, abs=1e-6)


def test_standing_pose_touches_the_ground(robot) -> None:
    data = mujoco.MjData(robot)
    data.qpos[:] = model.standing_qpos()
    mujoco.mj_forward(robot, data)
    for side in ("left", "right"):
        ankle = robot.body(f"{side}_ankle_roll_link").id
        corners = data.xmat[ankle].reshape(3, 3) @ model.SOLE_CORNERS.T
        height = data.xpos[ankle][2] + corners[2]
        assert np.abs(height).max() < 0.01


@pytest.mark.parametrize("self_collision", [False, True])
def test_links_collide_only_when_asked(self_collision) -> None:
    robot = model.build_model(self_collision=self_collision)
    data = mujoco.MjData(robot)
    data.qpos[:] = model.standing_qpos()
    data.qpos[2] = 3.0
    # Both hands at the belly: the forearms run into each other and the torso.
    for side, sign in (("left", 1), ("right", -1)):
        data.qpos[7 + g1.joint_index(f"{side}_shoulder_roll_joint")] = -0.3 * sign
        data.qpos[7 + g1.joint_index(f"{side}_shoulder_yaw_joint")] = -1.2 * sign
    mujoco.mj_forward(robot, data)
    assert (data.ncon > 0) == self_collision
    # The ground is felt either way.
    data.qpos[2] = 0.2
    mujoco.mj_forward(robot, data)
    floor = robot.geom("floor").id
    assert (data.contact.geom == floor).any()


def test_lidar_hangs_upside_down(robot) -> None:
    data = mujoco.MjData(robot)
    data.qpos[3] = 1
    mujoco.mj_forward(robot, data)
    found = data.site_xmat[robot.site("lidar").id].reshape(3, 3)
    # ROS and URDF write roll, pitch, yaw about fixed axes.
    expected = Rotation.from_euler("xyz", g1.LIDAR_RPY).as_matrix()
    assert np.allclose(found, expected, atol=1e-9)
    assert found[2, 2] < -0.99
