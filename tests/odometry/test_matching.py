"""Planes, residuals and their Jacobians."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from openclone.odometry import manifold as m
from openclone.odometry import matching
from openclone.odometry.matching import COLUMNS, MatchConfig, Matcher
from openclone.odometry.scan import Thinned
from openclone.odometry.voxel_map import MapConfig, VoxelMap


def random_state(rng: np.random.Generator) -> np.ndarray:
    state = np.zeros(m.STATE_SIZE)
    state[m.ROT] = Rotation.random(random_state=rng).as_matrix().ravel()
    state[m.POS] = rng.standard_normal(3)
    state[m.GRAVITY] = (0.0, 0.0, -9.81)
    state[m.ROT_LIDAR] = Rotation.random(random_state=rng).as_matrix().ravel()
    state[m.POS_LIDAR] = rng.standard_normal(3)
    return state


def height(state: np.ndarray, point: np.ndarray, normal: np.ndarray) -> float:
    """The residual's formula, written out."""
    in_imu = state[m.ROT_LIDAR].reshape(3, 3) @ point + state[m.POS_LIDAR]
    return float(normal @ (state[m.ROT].reshape(3, 3) @ in_imu + state[m.POS]))


def test_jacobian_of_the_residual_against_finite_differences() -> None:
    rng = np.random.default_rng(0)
    for _ in range(5):
        state, point = random_state(rng), 3.0 * rng.standard_normal(3)
        normal = rng.standard_normal(3)
        normal /= np.linalg.norm(normal)
        row = np.zeros(12)
        value = matching.residual_row(state, point, normal, row)
        assert value == pytest.approx(height(state, point, normal))
        for column in range(m.ERROR_SIZE):
            e = np.zeros(m.ERROR_SIZE)
            e[column] = 1e-6
            high = height(m.plus(state, e), point, normal)
            low = height(m.plus(state, -e), point, normal)
            where = np.flatnonzero(column == COLUMNS)
            expected = row[where[0]] if len(where) else 0.0
            assert (high - low) / 2e-6 == pytest.approx(expected, abs=1e-7)


def test_smallest_eigenvector_against_numpy() -> None:
    """Five cells of a map span decimetres, so variances are 0.01 to 1 m²."""
    rng = np.random.default_rng(1)
    for scale in (1.0, 0.1):
        for _ in range(30):
            root = scale * rng.standard_normal((3, 3)) * (1.0, 0.3, 0.02)
            a = root @ root.T
            vector = np.zeros(3)
            upper = a[np.triu_indices(3)]
            smallest, middle = matching.smallest_eigenvector(*upper, vector)
            values, vectors = np.linalg.eigh(a)
            assert smallest == pytest.approx(values[0], abs=1e-6 * values[2])
            assert middle == pytest.approx(values[1], rel=1e-5)
            assert abs(vector @ vectors[:, 0]) == pytest.approx(1.0, abs=1e-4)


def test_a_plane_is_fitted_and_a_line_or_a_heap_is_not() -> None:
    limits, plane, five = MatchConfig().as_array(), np.zeros(5), np.arange(5)
    normal = np.array((0.6, 0.0, 0.8))
    across = np.array(((0.8, 0.0, -0.6), (0.0, 1.0, 0.0)))
    spots = 0.2 * np.array(((0, 0), (1, 0), (0, 1), (-1, 0), (0, -1)))
    cells = np.ones((5, 4))
    cells[:, :3] = 2.0 * normal + spots @ across
    assert matching.fit_plane(five, cells, limits, plane)
    sign = np.sign(plane[3])
    np.testing.assert_allclose(sign * plane[:3], normal, atol=1e-9)
    assert sign * plane[3] == pytest.approx(2.0)
    line = np.ones((5, 4))
    line[:, :3] = np.linspace(0, 1, 5)[:, None] * normal
    assert not matching.fit_plane(five, line, limits, plane)
    heap = cells.copy()
    heap[0, :3] += 0.2 * normal
    assert not matching.fit_plane(five, heap, limits, plane)


def test_a_scan_displaced_from_the_map_pulls_back_to_it() -> None:
    """Normal equations of a known displacement solve to that displacement."""
    rng = np.random.default_rng(2)
    cube = rng.uniform(-2.0, 2.0, (30_000, 3))
    face = rng.integers(0, 3, len(cube))
    cube[np.arange(len(cube)), face] = rng.choice((-2.0, 2.0), len(cube))
    world = VoxelMap(MapConfig())
    world.insert(cube, np.ones(len(cube)), np.full(len(cube), 2))
    inner = cube[(np.sort(np.abs(cube), axis=1)[:, 1] < 1.5)][:2000]
    count = len(inner)
    thinned = Thinned(inner, np.zeros((count, 6)), np.ones(count), count, 0)
    truth = np.zeros(m.STATE_SIZE)
    truth[m.ROT] = truth[m.ROT_LIDAR] = np.eye(3).ravel()
    truth[m.GRAVITY] = (0.0, 0.0, -9.81)
    error = np.zeros(m.ERROR_SIZE)
    error[:6] = (0.004, -0.006, 0.005, 0.02, -0.01, 0.015)
    matcher = Matcher(thinned, world, MatchConfig())
    evidence = matcher.evidence(
        m.plus(truth, error), 0.03**2 * np.eye(m.ERROR_SIZE), search=True
    )
    assert evidence.agreement > 0.95
    step = -np.linalg.solve(evidence.information[:6, :6], evidence.gradient[:6])
    np.testing.assert_allclose(step, -error[:6], atol=5e-4)


def test_voxels_that_hold_an_edge_are_trusted_less() -> None:
    scatters = np.zeros((1, 6))
    scatters[0, 5] = 0.03**2
    along = matching.spread(scatters[0], np.array((0.0, 0.0, 1.0)))
    across = matching.spread(scatters[0], np.array((1.0, 0.0, 0.0)))
    assert along == pytest.approx(0.03**2)
    assert across == 0.0
