"""FAST-LIO2 as a whole against known motion, biases and gravity."""

import threading
from dataclasses import replace

import box_room
import numpy as np
import pytest
from driving import aligned_error, drive

from openclone.errors import InputError
from openclone.odometry.estimator import EstimatorConfig
from openclone.odometry.fast_lio import FastLio, FastLioConfig
from openclone.odometry.scan import ScanConfig
from openclone.odometry.warmup import warm_up
from openclone.spatial import rotations

UP = np.array((0.0, 0.0, 9.80665))


@pytest.fixture(scope="module")
def walk():
    """Eight seconds in the furnished room, 20 000 points per scan."""
    world = box_room.World(
        box_room.walking(turn_rate=0.6),
        box_room.furnished(),
        box_room.Sensors(),
        np.random.default_rng(0),
    )
    return drive(box_room.stream(world, 8.0), world), world


def still_sensor(world: box_room.World, lio: FastLio, seconds: float = 1.2) -> None:
    for event in box_room.stream(world, seconds):
        if event.points is None:
            lio.add_imu(round(event.time * 1e9), event.gyro, event.accel)
        else:
            lio.add_scan(event.points, event.stamps)


def small_world(**changes) -> box_room.World:
    sensors = replace(box_room.Sensors(points=3000), **changes)
    rng = np.random.default_rng(7)
    return box_room.World(box_room.walking(), box_room.furnished(), sensors, rng)


def test_walk_in_a_furnished_room(walk) -> None:
    run, world = walk
    started = [state for state in run.states if state.health.tracking]
    estimated = np.array([state.position for state in started])
    times = np.array([state.stamp_ns for state in started]) * 1e-9
    assert aligned_error(estimated, world.pose(times)[0]) < 0.005
    metres, degrees = run.worst_tracked()
    assert metres < 0.02
    assert degrees < 0.5


def test_cube_with_known_motion() -> None:
    """Six bare walls, a circle of known radius and rate."""
    world = box_room.World(
        box_room.walking(0.8, 0.7),
        box_room.empty_room(2.5),
        box_room.Sensors(points=5000),
        np.random.default_rng(2),
    )
    run = drive(box_room.stream(world, 5.0), world)
    last = run.states[-1]
    position, quat = world.pose(np.array(5.0))
    np.testing.assert_allclose(last.position, position, atol=0.015)
    yaw = rotations.yaw(last.quat) - rotations.yaw(quat)
    assert abs(rotations.wrap_angle(yaw)) < np.deg2rad(0.3)
    velocity = world.motion.velocity(np.array(5.0))
    np.testing.assert_allclose(last.velocity, velocity, atol=0.04)


def test_gravity_and_biases_are_recovered(walk) -> None:
    run, world = walk
    last = run.states[-1]
    np.testing.assert_allclose(last.gyro_bias, world.sensors.gyro_bias, atol=1e-3)
    np.testing.assert_allclose(last.accel_bias, world.sensors.accel_bias, atol=0.015)
    # True gravity in the frame that the first, slightly tilted pose defines.
    first = run.lio.pose_at(150_000_000)[1]
    gravity = rotations.rotate(first, box_room.GRAVITY)
    tilt = np.linalg.norm(np.cross(last.gravity, gravity)) / 9.80665**2
    assert tilt < 1.5e-3
    assert np.linalg.norm(last.gravity) == pytest.approx(9.80665)
    # Before the walk, bias and tilt could not be told apart.
    early = next(state for state in run.states if state.health.tracking)
    assert np.abs(early.accel_bias - world.sensors.accel_bias).max() > 0.02


def test_poses_come_at_the_rate_of_the_imu(walk) -> None:
    run, world = walk
    stamps = np.arange(7_000_000_000, 7_950_000_000, 5_000_000)
    poses = [run.lio.pose_at(int(stamp)) for stamp in stamps]
    true, _ = world.pose(stamps * 1e-9)
    positions = np.array([pose[0] for pose in poses])
    assert np.linalg.norm(positions - true, axis=1).max() < 0.02
    assert len(np.unique(positions[:, 0])) == len(stamps)
    steps = np.linalg.norm(np.diff(positions, axis=0), axis=1)
    assert steps.max() < 0.012
    ahead, _ = run.lio.pose_at(8_050_000_000)
    assert np.linalg.norm(ahead - world.pose(np.array(8.05))[0]) < 0.03
    with pytest.raises(InputError, match="older"):
        run.lio.pose_at(-1_000_000_000)


def test_health_tells_what_it_knows(walk) -> None:
    run, _ = walk
    health = run.lio.health()
    assert health.tracking
    assert health.reason == ""
    assert health.matches > 500
    assert health.agreement > 0.9
    assert 0.002 < health.residual < 0.02
    assert 1e-4 < health.position_sigma < 0.01
    assert health.covariance is not None
    assert health.covariance.shape == (6, 6)
    assert not health.degenerate
    later = run.lio.health(8_400_000_000)
    assert not later.tracking
    assert later.age_ns == 400_000_000


def test_upside_down_sensor() -> None:
    world = small_world(inverted=True)
    run = drive(box_room.stream(world, 3.0), world)
    metres, degrees = run.worst_tracked()
    assert metres < 0.02
    assert degrees < 0.6
    assert abs(run.states[-1].quat[1]) > 0.9


def test_a_corridor_without_ends_is_degenerate_along_it() -> None:
    room = box_room.Room(
        np.array(((-60, -1.5, -1.3), (60, 1.5, 1.5))), np.zeros((0, 2, 3))
    )
    world = replace(small_world(points=6000), room=room)
    config = FastLioConfig(estimator=EstimatorConfig(scan=ScanConfig(max_range=15.0)))
    lio = FastLio(config)
    still_sensor(world, lio)
    health = lio.health()
    assert health.degenerate
    assert abs(health.weakest_direction[0]) > 0.95


def test_tilt_anchor_makes_the_world_level() -> None:
    biased = np.array((0.12, -0.1, 0.0))
    world, lio = small_world(accel_bias=biased), FastLio()
    plain = FastLio()
    for event in box_room.stream(world, 2.5):
        stamp = round(event.time * 1e9)
        if event.points is None:
            for each in (lio, plain):
                each.add_imu(stamp, event.gyro, event.accel)
            quat = world.pose(np.array(event.time))[1]
            lio.add_tilt(stamp, rotations.rotate_inverse(quat, np.array((0, 0, 1.0))))
        else:
            for each in (lio, plain):
                each.add_scan(event.points, event.stamps)

    def tilt_deg(each: FastLio) -> float:
        up = rotations.rotate(each.pose_at(2_500_000_000)[1], np.array((0, 0, 1.0)))
        true = rotations.rotate(world.pose(np.array(2.5))[1], np.array((0, 0, 1.0)))
        return float(np.rad2deg(np.linalg.norm(np.cross(up, true))))

    assert tilt_deg(plain) > 0.6
    assert tilt_deg(lio) < 0.15


def test_extrinsic_is_refined_when_asked() -> None:
    world = box_room.World(
        box_room.spinning(1.5),
        box_room.furnished(),
        box_room.Sensors(points=4000),
        np.random.default_rng(3),
    )
    wrong = box_room.IMU_FROM_LIDAR + np.array((0.02, -0.02, 0.0))
    config = FastLioConfig(
        lidar_position=(wrong[0], wrong[1], wrong[2]), estimate_extrinsic=True
    )
    run = drive(box_room.stream(world, 6.0), world, config=config)
    error = run.states[-1].imu_from_lidar.position - box_room.IMU_FROM_LIDAR
    assert np.linalg.norm(error[:2]) < 0.5 * np.linalg.norm((0.02, 0.02))
    fixed = drive(box_room.stream(world, 1.5), world)
    np.testing.assert_array_equal(
        fixed.states[-1].imu_from_lidar.position, box_room.IMU_FROM_LIDAR
    )


def test_before_the_start_the_pose_is_the_origin_and_not_trusted() -> None:
    lio = FastLio()
    position, quat = lio.pose_at(0)
    np.testing.assert_array_equal(position, np.zeros(3))
    np.testing.assert_array_equal(quat, rotations.IDENTITY)
    assert not lio.health().tracking
    assert "waiting" in lio.health(0).reason
    with pytest.raises(InputError, match="IMU"):
        lio.add_scan(np.ones((10, 3)), np.arange(10))
    assert lio.health().refused == 1


def test_refused_input_is_counted_and_changes_nothing() -> None:
    world, lio = small_world(), FastLio()
    still_sensor(world, lio)
    before, scans = lio.pose_at(1_200_000_000), lio.health().scans
    with pytest.raises(InputError):
        lio.add_imu(1_300_000_000, np.zeros(2), UP)
    with pytest.raises(InputError):
        lio.add_imu(1_100_000_000, np.zeros(3), UP)
    with pytest.raises(InputError):
        lio.add_scan(np.ones((5, 3)), np.full(5, 900_000_000))
    with pytest.raises(InputError):
        lio.add_tilt(1_200_000_000, (0.0, 0.0, 0.0))
    with pytest.raises(InputError):
        lio.pose_at(1.2)  # type: ignore[arg-type]
    after = lio.pose_at(1_200_000_000)
    np.testing.assert_array_equal(before[0], after[0])
    assert lio.health().scans == scans
    assert lio.health().refused == 3


def test_acceleration_in_g_is_refused() -> None:
    lio = FastLio()
    for k in range(9):
        lio.add_imu(k * 5_000_000, np.zeros(3), UP / 9.80665)
    with pytest.raises(InputError, match=r"are g;.*9\.80665"):
        lio.add_imu(9 * 5_000_000, np.zeros(3), UP / 9.80665)


def test_a_clock_set_back_starts_anew() -> None:
    world, lio = small_world(), FastLio()
    still_sensor(world, lio)
    assert lio.health().tracking
    for k in range(40):
        try:
            lio.add_imu(-(10**12) + k * 5_000_000, np.zeros(3), UP)
        except InputError:
            continue
    health = lio.health()
    assert health.restarts == 1
    assert not health.tracking
    assert "clock" in health.reason


def test_reset_forgets_everything() -> None:
    world, lio = small_world(), FastLio()
    still_sensor(world, lio)
    assert len(lio.map_points()) > 100
    lio.reset()
    assert len(lio.map_points()) == 0
    assert not lio.health().tracking
    still_sensor(world, lio)
    assert lio.health().tracking


def test_poses_are_served_while_scans_are_matched() -> None:
    """Three threads at once; every pose is finite and near the origin."""
    world, lio, seen = small_world(), FastLio(), []
    still_sensor(world, lio)
    done = threading.Event()

    def reader() -> None:
        while not done.is_set():
            seen.append(lio.pose_at(1_200_000_000)[0])

    thread = threading.Thread(target=reader)
    thread.start()
    for event in box_room.stream(world, 1.6):
        if event.time <= 1.2:
            continue
        if event.points is None:
            lio.add_imu(round(event.time * 1e9), event.gyro, event.accel)
        else:
            lio.add_scan(event.points, event.stamps)
    done.set()
    thread.join()
    assert len(seen) > 10
    assert np.abs(np.array(seen)).max() < 0.05


def test_warm_up_leaves_nothing_to_compile() -> None:
    warm_up()
    from openclone.odometry import filter as f
    from openclone.odometry import matching

    for function in (f.propagate, f.gauss_newton_step, matching.find_planes):
        assert function.signatures
