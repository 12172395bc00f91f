"""The map against brute force."""

import numpy as np

from openclone.odometry.voxel_map import NEIGHBOURS, MapConfig, VoxelMap, nearest_cells


def insert(world: VoxelMap, points: np.ndarray, use: int = 2) -> None:
    count = len(points)
    world.insert(points, np.ones(count), np.full(count, use, np.int64))


def neighbours(world: VoxelMap, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    nearest, distances2 = np.zeros(NEIGHBOURS, np.int64), np.zeros(NEIGHBOURS)
    found = nearest_cells(
        *point, world.cells, world.table, world.keys, 0.2, nearest, distances2
    )
    return nearest[:found], distances2[:found]


def test_five_nearest_cells_equal_brute_force() -> None:
    rng = np.random.default_rng(0)
    world = VoxelMap(MapConfig())
    insert(world, rng.uniform(-1.0, 1.0, (3000, 3)))
    points = world.points
    assert len(points) > 500
    for query in rng.uniform(-0.9, 0.9, (200, 3)):
        nearest, distances2 = neighbours(world, query)
        expected = np.sort(((points - query) ** 2).sum(1))[:NEIGHBOURS]
        # Cells beyond the searched voxels are not promised.
        if expected[-1] < 0.15**2:
            np.testing.assert_allclose(distances2, expected, atol=1e-12)
        assert len(set(nearest.tolist())) == NEIGHBOURS


def test_sparse_maps_are_searched_one_shell_wider() -> None:
    world = VoxelMap(MapConfig())
    grid = 0.38 * np.arange(-3, 4)
    insert(world, np.array([(x, y, 0.01) for x in grid for y in grid]))
    _, distances2 = neighbours(world, np.array((0.1, 0.1, 0.01)))
    offsets = np.array([(x - 0.1, y - 0.1) for x in grid for y in grid])
    expected = np.sort((offsets**2).sum(1))[:NEIGHBOURS]
    np.testing.assert_allclose(distances2, expected, atol=1e-12)


def test_a_cell_is_the_mean_of_its_points_and_then_stays() -> None:
    rng = np.random.default_rng(1)
    world = VoxelMap(MapConfig(max_weight=50.0))
    points = np.array((0.1, 0.1, 0.1)) + 0.01 * rng.standard_normal((50, 3))
    for point in points:
        insert(world, point[None])
    assert len(world) == 1
    np.testing.assert_allclose(world.points[0], points.mean(0), atol=1e-12)
    insert(world, np.array([[0.14, 0.1, 0.1]]))
    np.testing.assert_allclose(world.points[0], points.mean(0), atol=1e-12)


def test_a_wall_on_a_voxel_border_stays_one_layer() -> None:
    """Noise across a voxel border must not make two layers of a flat wall."""
    rng = np.random.default_rng(2)
    world = VoxelMap(MapConfig())
    wall = rng.uniform(-1.0, 1.0, (20_000, 3))
    wall[:, 2] = 0.4 + 0.02 * rng.standard_normal(len(wall))
    insert(world, wall)
    assert np.abs(world.points[:, 2] - 0.4).std() < 0.01
    assert len(world) < 180  # two layers have 200


def test_use_decides_what_points_may_do() -> None:
    world = VoxelMap(MapConfig())
    insert(world, np.array([[0.1, 0.1, 0.1]]))
    before = world.points
    insert(world, np.array([[0.15, 0.1, 0.1]]), use=1)
    insert(world, np.array([[0.15, 0.1, 0.1], [2.0, 2, 2]]), use=0)
    np.testing.assert_array_equal(world.points, before)
    insert(world, np.array([[1.0, 1.0, 1.0]]), use=1)
    assert len(world) == 2


def test_the_box_moves_with_the_sensor() -> None:
    world = VoxelMap(MapConfig(box=5.0))
    line = np.zeros((100, 3))
    line[:, 0] = np.linspace(-4.9, 14.9, 100)
    world.follow(np.zeros(3))
    insert(world, line)
    assert world.follow(np.array((0.5, 0.0, 0.0))) == 0
    dropped = world.follow(np.array((10.0, 0.0, 0.0)))
    left = world.points[:, 0]
    assert dropped == 100 - len(left)
    np.testing.assert_allclose(left, line[(line[:, 0] >= 5.0), 0])
    # What is left can still be found, what is gone cannot.
    assert neighbours(world, np.array((12.0, 0.0, 0.0)))[1][0] < 0.1**2
    assert len(neighbours(world, np.array((0.0, 0.0, 0.0)))[0]) == 0


def test_a_full_map_makes_room_and_memory_stays() -> None:
    rng = np.random.default_rng(3)
    world = VoxelMap(MapConfig(capacity=2048, box=20.0))
    size = world.cells.nbytes + world.keys.nbytes + world.table.nbytes
    for step in range(40):
        centre = np.array((0.5 * step, 0.0, 0.0))
        world.follow(centre)
        insert(world, centre + rng.uniform(-3.0, 3.0, (500, 3)))
        assert len(world) <= 2048
    assert world.cells.nbytes + world.keys.nbytes + world.table.nbytes == size
    newest = world.points[:, 0].max()
    assert newest > 20.0
