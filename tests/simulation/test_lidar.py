import mujoco
import numpy as np
import pytest

from openclone.robot import g1
from openclone.robot.model import build_spec, standing_qpos
from openclone.simulation.lidar import Mid360Config, Motion, SimulatedLidar
from openclone.simulation.scan_pattern import beam_directions
from openclone.simulation.worlds import GLASS, SOLID, World, build_world
from openclone.spatial import rotations

CLEAN = Mid360Config(range_sigma=0.0, no_return=0.0)
BOX_LOW, BOX_HIGH = np.array([-3.0, -2.0, -0.5]), np.array([4.0, 5.0, 2.5])


def box_world(group: int = SOLID, outer: float = 0.0) -> World:
    """The robot inside a box of six thick walls; outside perhaps a larger one."""
    spec = build_spec()
    shells = [(BOX_LOW, BOX_HIGH, group)]
    if outer:
        shells.append((BOX_LOW - outer, BOX_HIGH + outer, SOLID))
    for low, high, kind in shells:
        for axis in range(3):
            for face, side in ((low[axis], -1.0), (high[axis], 1.0)):
                middle, half = 0.5 * (low + high), 0.5 * (high - low) + 0.01
                middle[axis], half[axis] = face + side * 0.01, 0.01
                spec.worldbody.add_geom(
                    type=mujoco.mjtGeom.mjGEOM_BOX, pos=middle, size=half, group=kind
                )
    return World("box", spec.compile())


def still(qpos: np.ndarray, start_ns: int = 0) -> Motion:
    return Motion(start_ns + np.array([0, 100_000_000]), np.array([qpos, qpos]))


def lidar_pose(qpos: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """World from LiDAR by the table in `g1` and quaternion algebra; waist at zero."""
    pelvis_from_torso = np.array([-0.0039635, 0.0, 0.044])
    torso = qpos[:3] + rotations.rotate(qpos[3:7], pelvis_from_torso)
    position = torso + rotations.rotate(qpos[3:7], np.array(g1.LIDAR_POSITION))
    roll, pitch, yaw = g1.LIDAR_RPY
    mount = rotations.multiply(
        rotations.from_axis_angle(np.array([0.0, 0.0, 1.0]), yaw),
        rotations.multiply(
            rotations.from_axis_angle(np.array([0.0, 1.0, 0.0]), pitch),
            rotations.from_axis_angle(np.array([1.0, 0.0, 0.0]), roll),
        ),
    )
    return position, rotations.multiply(qpos[3:7], mount)


def box_ranges(
    position: np.ndarray, beams_w: np.ndarray, margin: float = 0.0
) -> np.ndarray:
    """Distance to the box from inside, ``(N,)``: the nearest of six planes."""
    wall = np.where(beams_w > 0, BOX_HIGH + margin, BOX_LOW - margin)
    with np.errstate(divide="ignore"):
        return ((wall - position) / beams_w).min(axis=1)


def turned_qpos() -> np.ndarray:
    qpos = standing_qpos()
    qpos[:3] += (0.4, 0.7, 0.05)
    qpos[3:7] = rotations.from_euler(np.array([0.7, 0.1, -0.05]), "ZYX")
    return qpos


def test_ranges_are_those_of_a_box() -> None:
    qpos = turned_qpos()
    lidar = SimulatedLidar(box_world(), CLEAN, np.random.default_rng(0))
    points = lidar.trace(still(qpos)).points
    position, quat = lidar_pose(qpos)
    beams = beam_directions(np.arange(len(points)))
    expected = box_ranges(position, rotations.rotate(np.tile(quat, (20_000, 1)), beams))
    ranges = np.linalg.norm(points, axis=1)
    hit = ranges > 0
    assert hit.mean() > 0.95
    # The rest met the robot itself: nothing else is nearer than the box.
    np.testing.assert_allclose(ranges[hit], expected[hit], atol=2e-6)
    np.testing.assert_allclose(points[hit], beams[hit] * expected[hit, None], atol=2e-6)


def test_the_sensor_hangs_upside_down() -> None:
    """Its field of view, -7 to 52 degrees, lies below the horizon."""
    qpos = standing_qpos()
    position, quat = lidar_pose(qpos)
    up_w = rotations.rotate(quat, np.array([0.0, 0.0, 1.0]))
    assert up_w[2] == pytest.approx(-np.cos(0.0511207), abs=1e-9)
    assert position[2] == pytest.approx(1.256, abs=1e-3)
    lidar = SimulatedLidar(build_world("room"), CLEAN, np.random.default_rng(0))
    points = lidar.trace(still(qpos)).points
    seen = points[(points != 0).any(axis=1)]
    world = position + rotations.rotate(np.tile(quat, (len(seen), 1)), seen)
    # The floor is where it is, and more of it is seen than of the ceiling.
    floor = np.abs(world[:, 2]) < 1e-3
    assert floor.mean() > 0.3
    assert world[:, 2].min() > -1e-3
    assert (world[:, 2] > 2.0).mean() < 0.05


def test_the_room_is_distorted_by_motion_and_only_by_it() -> None:
    """Each point lies on the wall that the sensor saw from its place at that time."""
    start, end = standing_qpos(), standing_qpos()
    end[:3] += (0.1, -0.05, 0.02)
    end[3:7] = rotations.from_yaw(np.array(0.15))
    motion = Motion(np.array([7, 100_000_007]), np.array([start, end]))
    lidar = SimulatedLidar(box_world(), CLEAN, np.random.default_rng(0))
    frame = lidar.trace(motion)
    for index in range(100, 20_000, 1_700):
        part = (index // 200 + 0.5) / 100
        quat = rotations.from_yaw(np.array(0.15 * part))
        qpos = np.concatenate((start[:3] + part * (end - start)[:3], quat, start[7:]))
        position, lidar_quat = lidar_pose(qpos)
        point_w = position + rotations.rotate(lidar_quat, frame.points[index])
        faces = np.minimum(np.abs(point_w - BOX_LOW), np.abs(point_w - BOX_HIGH))
        assert faces.min() < 1e-5
    assert frame.stamps_ns[0] == 7
    assert frame.stamps_ns[-1] == 7 + 99_995_000
    assert frame.end_ns == 100_000_007


def test_the_robot_does_not_see_itself() -> None:
    """Arms raised in front of the sensor become no-returns, not points."""
    qpos = standing_qpos()
    for side in ("left", "right"):
        qpos[7 + g1.joint_index(f"{side}_shoulder_pitch_joint")] = -1.5
        qpos[7 + g1.joint_index(f"{side}_elbow_joint")] = 1.2
    lidar = SimulatedLidar(box_world(), CLEAN, np.random.default_rng(0))
    raised = np.linalg.norm(lidar.trace(still(qpos)).points, axis=1)
    masked = (raised == 0).mean()
    assert 0.005 < masked < 0.2
    assert raised[raised > 0].min() > 0.9


def test_noise_and_missing_returns_are_as_configured() -> None:
    config = Mid360Config(range_sigma=0.02, no_return=0.3)
    world, qpos = box_world(), standing_qpos()
    clean = SimulatedLidar(world, CLEAN, np.random.default_rng(0)).trace(still(qpos))
    noisy = SimulatedLidar(world, config, np.random.default_rng(1)).trace(still(qpos))
    true = np.linalg.norm(clean.points, axis=1)
    measured = np.linalg.norm(noisy.points, axis=1)
    both = (true > 0) & (measured > 0)
    assert (measured[true > 0] == 0).mean() == pytest.approx(0.3, abs=0.015)
    error = (measured - true)[both]
    assert error.std() == pytest.approx(0.02, rel=0.03)
    assert abs(error.mean()) < 0.001


def test_equal_seeds_give_equal_frames() -> None:
    world, qpos = build_world("glass"), standing_qpos()

    def frame(seed: int) -> np.ndarray:
        lidar = SimulatedLidar(world, Mid360Config(), np.random.default_rng(seed))
        return lidar.trace(still(qpos)).points

    np.testing.assert_array_equal(frame(3), frame(3))
    assert (frame(3) != frame(4)).any()


def test_frames_do_not_repeat() -> None:
    first, second = (
        beam_directions(np.arange(20_000)),
        beam_directions(20_000 + np.arange(20_000)),
    )
    np.testing.assert_allclose(np.linalg.norm(first, axis=1), 1.0, atol=1e-12)
    elevation = np.degrees(np.arcsin(first[:, 2]))
    assert -7.6 < elevation.min() < -6.5
    assert 51.5 < elevation.max() < 52.6

    def cells(beams: np.ndarray) -> set[tuple[int, int]]:
        azimuth = np.degrees(np.arctan2(beams[:, 1], beams[:, 0]))
        height = np.degrees(np.arcsin(beams[:, 2]))
        fine = np.stack((azimuth, height), axis=1) * 5
        return set(map(tuple, np.floor(fine).astype(int).tolist()))

    # 0.2 degree cells: the published table repeats 4.5 % of them in the next frame.
    shared = len(cells(first) & cells(second)) / len(cells(first))
    assert shared < 0.06


def test_glass_passes_most_light_and_mirrors_some() -> None:
    config = Mid360Config(range_sigma=0.0, no_return=0.0)
    qpos = standing_qpos()
    world = box_world(GLASS, outer=1.5)
    lidar = SimulatedLidar(world, config, np.random.default_rng(0))
    points = lidar.trace(still(qpos)).points
    position, quat = lidar_pose(qpos)
    beams = rotations.rotate(
        np.tile(quat, (20_000, 1)), beam_directions(np.arange(20_000))
    )
    pane = box_ranges(position, beams)
    ranges = np.linalg.norm(points, axis=1)
    on_pane = np.abs(ranges - pane) < 1e-4
    assert on_pane.mean() == pytest.approx(config.glass_return, abs=0.01)
    outer = box_ranges(position, beams, 1.5)
    passed = np.abs(ranges - outer) < 1e-4
    assert passed.mean() > 0.55
    # Mirror images lie behind the pane and on no wall. (A beam that a side pane mirrors
    # still meets the floor as far away as it would have: such images do not show.)
    ghosts = (ranges > 0) & ~on_pane & ~passed
    assert 0.05 < ghosts.mean() < 0.2
    assert (ranges[ghosts] > pane[ghosts]).all()
