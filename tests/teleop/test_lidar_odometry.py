from __future__ import annotations

import os
import time

import mujoco
import numpy as np
import pytest

from openclone.errors import OpenCloneError
from openclone.odometry.protocol import OdometryHealth
from openclone.policy.bundle import Bundle
from openclone.robot import g1
from openclone.robot.model import standing_qpos
from openclone.simulation.robot import SimulatedRobot
from openclone.simulation.sensors import HeadSensors, imu_pose
from openclone.simulation.worlds import World, build_world
from openclone.spatial import rotations
from openclone.spatial.poses import Pose
from openclone.teleop.lidar_odometry import LidarOdometry
from openclone.teleop.messages import OperatorRecording
from openclone.teleop.realtime import realtime_priority
from openclone.teleop.session import run_teleop

TICK_NS = 20_000_000
LOOP_START_NS = 777_000_000_000
# The odometry's world need not be the robot's: this one is shifted and turned.
ODOMETRY_FROM_WORLD = Pose(
    np.array([3.0, -1.0, 0.4]),
    rotations.from_euler(np.array([1.0, 0.02, -0.01]), "ZYX"),
)


class Oracle:
    """A `SensorOdometry` that knows the truth and notes what it is fed."""

    def __init__(self, robot: SimulatedRobot) -> None:
        self._robot = robot
        self._data = mujoco.MjData(robot.model)
        self.tracking = True
        self.failing = False
        self.imu_ns: list[int] = []
        self.scans: list[tuple[int, int]] = []
        self.asked_ns = 0
        self.priorities: list[int] = []

    def add_imu(self, stamp_ns: int, gyro: np.ndarray, accel: np.ndarray) -> None:
        self.imu_ns.append(stamp_ns)

    def add_scan(self, points: np.ndarray, stamps_ns: np.ndarray) -> None:
        if self.failing:
            raise RuntimeError("broken")
        assert points.shape == (20_000, 3)
        self.scans.append((int(stamps_ns.max()), self.imu_ns[-1]))
        self.priorities.append(os.sched_getparam(0).sched_priority)

    def pose_at(self, stamp_ns: int) -> tuple[np.ndarray, np.ndarray]:
        self.asked_ns = stamp_ns
        self._data.qpos[:] = self._robot.data.qpos
        mujoco.mj_kinematics(self._robot.model, self._data)
        pose = ODOMETRY_FROM_WORLD @ imu_pose(self._data)
        return pose.position, pose.quat

    def health(self, stamp_ns: int) -> OdometryHealth:
        return OdometryHealth(self.tracking, 0)


@pytest.fixture(scope="module")
def flat() -> World:
    return build_world("flat")


def start(
    world: World, *, realtime: bool = False
) -> tuple[SimulatedRobot, Oracle, LidarOdometry]:
    robot = SimulatedRobot(world.model)
    oracle = Oracle(robot)
    sensors = HeadSensors(robot, world)
    odometry = LidarOdometry(sensors, oracle, world.model, realtime=realtime)
    return robot, oracle, odometry


def base(robot: SimulatedRobot) -> Pose:
    return Pose(*robot.base_pose())


def test_the_pose_is_that_of_the_pelvis_in_the_robots_world(flat: World) -> None:
    """Whatever the waist does, and wherever the odometry's own world lies."""
    robot, oracle, odometry = start(flat)
    odometry.begin(base(robot), robot.reading().joint_angles)
    qpos = standing_qpos()
    qpos[:3] += (1.0, 0.5, -0.1)
    qpos[3:7] = rotations.from_euler(np.array([-0.8, 0.1, 0.05]), "ZYX")
    for name, angle in (("yaw", 0.7), ("roll", 0.2), ("pitch", -0.3)):
        qpos[7 + g1.joint_index(f"waist_{name}_joint")] = angle
    robot.reset(qpos)
    odometry.observe(LOOP_START_NS, robot.reading().joint_angles)
    position, quat = odometry.pose_at(LOOP_START_NS)
    np.testing.assert_allclose(position, qpos[:3], atol=1e-9)
    assert rotations.angle_between(quat, qpos[3:7]) < 1e-9
    # The loop's clock is translated to the sensors': 1.5 s have been held still.
    assert oracle.asked_ns == 1_500_000_000


def test_a_scan_is_registered_when_its_result_would_have_come(flat: World) -> None:
    robot, oracle, odometry = start(flat)
    odometry.begin(base(robot), robot.reading().joint_angles)
    begun = len(oracle.scans)
    assert begun >= 14
    for tick in range(20):
        odometry.observe(LOOP_START_NS + tick * TICK_NS, robot.reading().joint_angles)
        robot.write(g1.DEFAULT_POSE)
        robot.advance()
    assert np.unique(np.diff(oracle.imu_ns)).tolist() == [5_000_000]
    # The first frame was complete when the robot was let go.
    for end_ns, newest_imu_ns in oracle.scans[begun + 1 :]:
        assert 35_000_000 <= newest_imu_ns - end_ns <= 60_000_000
    assert len(oracle.scans) - begun >= 3


def test_in_real_time_frames_are_worked_off_beside_the_loop(flat: World) -> None:
    robot, oracle, odometry = start(flat, realtime=True)
    odometry.begin(base(robot), robot.reading().joint_angles)
    begun = len(oracle.scans)
    try:
        for tick in range(11):
            odometry.observe(
                LOOP_START_NS + tick * TICK_NS, robot.reading().joint_angles
            )
            robot.write(g1.DEFAULT_POSE)
            robot.advance()
    finally:
        odometry.close()
    # Closing works off what waits: frames ended at 1.5 and 1.6 s; 1.7 s comes next.
    cost = odometry.cost()
    assert begun == 14
    assert len(oracle.scans) - begun + cost.dropped == 2
    assert cost.trace_ms > 0.0
    # Above ordinary threads and below the loop, where the system allows it at all.
    with realtime_priority() as granted:
        loop = os.sched_getparam(0).sched_priority
    assert oracle.priorities[0] == os.sched_getparam(0).sched_priority
    if granted:
        assert 0 < oracle.priorities[-1] < loop


def test_a_broken_thread_is_reported(flat: World) -> None:
    robot, oracle, odometry = start(flat, realtime=True)
    odometry.begin(base(robot), robot.reading().joint_angles)
    oracle.failing = True
    robot.write(g1.DEFAULT_POSE)
    robot.advance()
    try:
        odometry.observe(LOOP_START_NS, robot.reading().joint_angles)
        deadline = time.monotonic() + 60.0
        while odometry._failure is None and time.monotonic() < deadline:
            time.sleep(0.01)
        with pytest.raises(OpenCloneError, match="broken"):
            odometry.health(LOOP_START_NS)
    finally:
        odometry.close()


def test_a_world_without_hold_is_refused(flat: World) -> None:
    robot, oracle, odometry = start(flat)
    oracle.tracking = False
    with pytest.raises(OpenCloneError, match="did not start"):
        odometry.begin(base(robot), robot.reading().joint_angles)


def test_fast_lio_closes_the_loop(bundle: Bundle, walking: OperatorRecording) -> None:
    """The whole way, from rays to the command; the robot tumbles without a policy."""

    def run() -> tuple[np.ndarray, np.ndarray, int]:
        result = run_teleop(
            walking,
            bundle,
            seconds=0.8,
            realtime=False,
            world="room",
            odometry="lio",
        )
        log = result.log
        return log.base_position, log.qpos[:, :3], result.odometry_cost.scans

    believed, true, scans = run()
    # Frames that ended at 1.5 s, where the robot is let go, to 2.2 s.
    assert scans >= 7
    assert np.linalg.norm(true[-1] - true[0]) > 0.05
    error = np.linalg.norm(believed - true, axis=1)
    assert error[0] < 1e-6
    assert error.max() < 0.03
    again, _, _ = run()
    np.testing.assert_array_equal(believed, again)
