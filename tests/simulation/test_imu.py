import math

import numpy as np
import pytest

from openclone.robot import g1
from openclone.robot.model import TIMESTEP, standing_qpos
from openclone.simulation.imu import (
    GRAVITY,
    ImuConfig,
    ImuSample,
    Ringing,
    ShockConfig,
    SimulatedImu,
    ideal_readings,
)
from openclone.simulation.robot import SimulatedRobot
from openclone.simulation.sensors import HeadSensors, SensorConfig
from openclone.simulation.worlds import World, build_world
from openclone.spatial import rotations

PERFECT = ImuConfig(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, shock=None)


@pytest.fixture(scope="module")
def flat() -> World:
    return build_world("flat")


def sensors(world: World, imu: ImuConfig, seed: int = 0) -> HeadSensors:
    robot = SimulatedRobot(world.model)
    robot.reset(standing_qpos())
    return HeadSensors(robot, world, seed, SensorConfig(imu=imu))


def test_at_rest_it_feels_gravity_upwards(flat: World) -> None:
    """Upside down and pitched by 2.93 degrees, as the mount says."""
    head = sensors(flat, PERFECT)
    head.hold_still(0.05)
    sample = head.take_imu()[-1]
    np.testing.assert_allclose(sample.gyro, 0.0, atol=1e-9)
    assert np.linalg.norm(sample.accel) == pytest.approx(GRAVITY, abs=1e-6)
    pitch = g1.LIDAR_RPY[1]
    expected = GRAVITY * np.array([-math.sin(pitch), 0.0, -math.cos(pitch)])
    np.testing.assert_allclose(sample.accel, expected, atol=1e-6)


def test_a_known_motion_is_felt() -> None:
    """A circle of 0.5 m radius at 2 rad/s, looking ahead."""
    radius, rate, step = 0.5, 2.0, 0.005
    times = step * np.arange(-1, 2)
    angle = rate * times
    positions = radius * np.stack((np.cos(angle), np.sin(angle), 0 * angle), axis=1)
    quats = rotations.from_yaw(angle)
    gyro, accel = ideal_readings(positions, quats, step)
    np.testing.assert_allclose(gyro, [[0, 0, rate]], atol=1e-9)
    # Centripetal: towards the middle, which lies behind the body's x axis.
    np.testing.assert_allclose(accel, [[-radius * rate**2, 0, GRAVITY]], atol=1e-4)


def test_samples_add_up_to_the_motion(flat: World) -> None:
    """Dead reckoning through a fall of the robot returns to its true pose."""
    head = sensors(flat, PERFECT)
    robot = head._robot
    track: list[tuple[int, np.ndarray, np.ndarray]] = []

    def note() -> None:
        from openclone.simulation.sensors import imu_pose

        pose = imu_pose(head._data)
        track.append((head.now_ns, pose.position.copy(), pose.quat.copy()))

    robot.watch(note)
    rng = np.random.default_rng(0)
    for _ in range(40):
        robot.write(g1.DEFAULT_POSE + 0.1 * rng.standard_normal(29))
        robot.advance()
    samples = {sample.stamp_ns: sample for sample in head.take_imu()}
    begin = 2
    _, position, quat = track[begin]
    velocity = (track[begin + 1][1] - track[begin - 1][1]) / (2 * TIMESTEP)
    for index in range(begin, len(track) - 2):
        first, last = samples[track[index][0]], samples[track[index + 1][0]]
        half = rotations.from_rotation_vector(
            0.25 * TIMESTEP * (first.gyro + last.gyro)
        )
        middle = rotations.multiply(quat, half)
        felt = 0.5 * (first.accel + last.accel)
        accel = rotations.rotate(middle, felt) - np.array([0, 0, GRAVITY])
        position = position + TIMESTEP * velocity + 0.5 * TIMESTEP**2 * accel
        velocity = velocity + TIMESTEP * accel
        quat = rotations.multiply(middle, half)
    _, true_position, true_quat = track[len(track) - 2]
    moved = np.linalg.norm(true_position - track[begin][1])
    assert moved > 0.1
    assert np.linalg.norm(position - true_position) < 0.02 * moved
    assert math.degrees(rotations.angle_between(quat, true_quat)) < 0.2


def test_errors_have_the_configured_size() -> None:
    config = ImuConfig(shock=None)
    biases = []
    for seed in range(200):
        imu = SimulatedImu(config, TIMESTEP, np.random.default_rng(seed))
        biases.append((imu.gyro_bias, imu.accel_bias))
    sizes = np.array(biases).std(axis=(0, 2))
    np.testing.assert_allclose(sizes, [config.gyro_bias, config.accel_bias], rtol=0.1)
    imu = SimulatedImu(config, TIMESTEP, np.random.default_rng(1))
    first = imu.accel_bias.copy()
    samples = still(imu, 4000)
    gyro = np.array([sample.gyro for sample in samples])
    accel = np.array([sample.accel for sample in samples])
    assert np.diff(gyro, axis=0).std() / math.sqrt(2) == pytest.approx(0.001, rel=0.05)
    assert np.diff(accel, axis=0).std() / math.sqrt(2) == pytest.approx(0.015, rel=0.05)
    # Over 20 s a bias wanders by its walk times the root of the time.
    wandered = np.abs(imu.accel_bias - first).max()
    assert 0 < wandered < 4 * config.accel_walk * math.sqrt(20.0)


def still(imu: SimulatedImu, count: int) -> list[ImuSample]:
    return imu.update(
        5_000_000 * np.arange(count),
        np.zeros((count, 3)),
        np.tile(rotations.IDENTITY, (count, 1)),
        np.zeros((count, 2)),
    )


def test_ringing_is_the_damped_oscillator_and_comes_back() -> None:
    config = ShockConfig(hertz=20.0, damping=0.1)
    step = 0.0005
    ringing = Ringing(config, step)
    kick = np.array([0.1, 0.0, 0.0, 0.0, 0.2, 0.0])
    omega = 2 * math.pi * 20.0
    damped = omega * math.sqrt(1 - 0.01)
    speed, turned = 0.0, 0.0
    for index in range(2000):
        mean = ringing.step(kick if index == 0 else np.zeros(6))
        speed, turned = speed + step * mean[0], turned + step * mean[4]
        if index == 99:
            # x(t) = v0 / w_d exp(-z w t) sin(w_d t), at t = 50 ms.
            t = 100 * step
            shrink = math.exp(-0.1 * omega * t)
            angle = 0.2 / damped * shrink * math.sin(damped * t)
            assert turned == pytest.approx(angle, rel=1e-6)
            cosine = math.cos(damped * t) - 0.1 * omega / damped * math.sin(damped * t)
            assert speed == pytest.approx(0.1 * shrink * cosine, rel=1e-6)
    # A shock leaves neither speed nor turn behind.
    assert abs(speed) < 1e-6
    assert abs(turned) < 1e-6


def landing(world: World, shock: ShockConfig | None) -> tuple[np.ndarray, int]:
    """Readings ``(n, 3)`` of a robot dropped onto its feet, and the touch-down."""
    head = sensors(world, ImuConfig(0.0, 0.0, 0.0, 0.0, 0.0, 0.0, shock=shock))
    robot = head._robot
    qpos = standing_qpos()
    qpos[2] += 0.03
    robot.reset(qpos)
    head.hold_still(0.01)
    head.take_imu()
    forces: list[float] = []
    robot.watch(lambda: forces.append(robot.true_state().foot_force[:, 2].sum()))
    for _ in range(15):
        robot.write(g1.DEFAULT_POSE)
        robot.advance()
    readings = np.array([sample.accel for sample in head.take_imu()])
    return readings, int(np.argmax(np.array(forces) > 40.0))


def test_footfalls_shake_the_head(flat: World) -> None:
    """The robot jars the IMU at touch-down and not before."""
    quiet, landed = landing(flat, None)
    shaken, _ = landing(flat, ShockConfig())
    difference = np.abs(shaken - quiet).max(axis=1)
    # sqrt(2 * 0.03 / 9.81) = 78 ms of free fall.
    assert landed * TIMESTEP == pytest.approx(0.078, abs=0.015)
    assert difference[: landed - 3].max() < 1e-9
    assert 1.0 < difference[landed - 3 : landed + 10].max() < 60.0
    # Falling, it feels nothing.
    assert np.linalg.norm(quiet[5 : landed - 3], axis=1).max() < 3.0


def test_a_rate_of_200_hertz_and_frames_after_their_readings(flat: World) -> None:
    head = sensors(flat, PERFECT)
    head.hold_still(0.31)
    stamps = [sample.stamp_ns for sample in head.take_imu()]
    assert np.unique(np.diff(stamps)).tolist() == [5_000_000]
    motions = head.take_motions()
    assert [int(m.stamps_ns[0]) for m in motions] == [0, 100_000_000, 200_000_000]
    assert int(motions[-1].stamps_ns[-1]) == 300_000_000 <= stamps[-1]
    assert head.take_motions() == []


def test_equal_seeds_give_equal_readings(flat: World) -> None:
    def readings(seed: int, every: int) -> np.ndarray:
        """Taken every few ticks: how often one asks must not matter."""
        head = sensors(flat, ImuConfig(), seed)
        taken: list[ImuSample] = []
        for tick in range(6):
            head._robot.write(g1.DEFAULT_POSE)
            head._robot.advance()
            taken += head.take_imu() if tick % every == every - 1 else []
        return np.array([np.append(s.gyro, s.accel) for s in taken])

    once = readings(5, 1)
    np.testing.assert_array_equal(once, readings(5, 1))
    # Sums in another order round differently, in the last digit.
    np.testing.assert_allclose(once, readings(5, 3), rtol=1e-12, atol=1e-14)
    assert (once != readings(6, 1)).all()
