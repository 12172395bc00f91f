"""The state's geometry against scipy and finite differences."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from openclone.odometry import manifold as m

STEP = 1e-6


def random_state(rng: np.random.Generator, tilt: float = 0.3) -> np.ndarray:
    state = np.zeros(m.STATE_SIZE)
    state[m.ROT] = Rotation.random(random_state=rng).as_matrix().ravel()
    state[9:21] = rng.standard_normal(12)
    down = Rotation.from_rotvec(tilt * rng.standard_normal(3)).apply((0, 0, -9.81))
    state[m.GRAVITY] = down
    state[m.ROT_LIDAR] = Rotation.random(random_state=rng).as_matrix().ravel()
    state[m.POS_LIDAR] = rng.standard_normal(3)
    return state


def derivative(function, size: int) -> np.ndarray:
    """Central differences of a vector function at zero."""
    columns = []
    for k in range(size):
        e = np.zeros(size)
        e[k] = STEP
        columns.append((function(e) - function(-e)) / (2 * STEP))
    return np.stack(columns, -1)


@pytest.mark.parametrize("angle", [0.0, 1e-7, 1e-4, 0.3, 3.0])
def test_exp_and_log_agree_with_scipy(angle: float) -> None:
    v = angle * np.array((0.36, -0.48, 0.8))
    rot = m.exp_rotation(v)
    np.testing.assert_allclose(rot, Rotation.from_rotvec(v).as_matrix(), atol=1e-9)
    np.testing.assert_allclose(m.log_rotation(rot), v, atol=1e-8)


@pytest.mark.parametrize("angle", [0.0, 1e-3, 0.7, 2.5])
def test_right_jacobian_and_its_inverse(angle: float) -> None:
    v = angle * np.array((0.6, 0.0, -0.8))
    base = Rotation.from_rotvec(v)
    numeric = derivative(
        lambda u: (base.inv() * Rotation.from_rotvec(v + u)).as_rotvec(), 3
    )
    np.testing.assert_allclose(m.right_jacobian(v), numeric, atol=1e-7)
    numeric = derivative(lambda u: (base * Rotation.from_rotvec(u)).as_rotvec(), 3)
    np.testing.assert_allclose(m.right_jacobian_inverse(v), numeric, atol=1e-7)


def test_sphere_basis_is_orthonormal_and_across_gravity() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        gravity = rng.standard_normal(3)
        basis = m.sphere_basis(gravity)
        np.testing.assert_allclose(basis.T @ basis, np.eye(2), atol=1e-9)
        np.testing.assert_allclose(gravity @ basis, 0.0, atol=1e-9)


def test_gravity_keeps_its_length() -> None:
    rng = np.random.default_rng(1)
    state = random_state(rng)
    moved = m.plus(state, rng.standard_normal(m.ERROR_SIZE))
    assert np.linalg.norm(moved[m.GRAVITY]) == pytest.approx(9.81)


def test_minus_undoes_plus() -> None:
    rng = np.random.default_rng(2)
    for _ in range(10):
        state, error = random_state(rng), 0.4 * rng.standard_normal(m.ERROR_SIZE)
        np.testing.assert_allclose(
            m.minus(m.plus(state, error), state), error, atol=1e-7
        )


def test_minus_jacobian_against_finite_differences() -> None:
    rng = np.random.default_rng(3)
    for size in (0.0, 1e-4, 0.3):
        reference = random_state(rng)
        state = m.plus(reference, size * rng.standard_normal(m.ERROR_SIZE))
        numeric = derivative(
            lambda e, s=state, r=reference: m.minus(m.plus(s, e), r), m.ERROR_SIZE
        )
        np.testing.assert_allclose(
            m.minus_jacobian(state, reference), numeric, atol=1e-6
        )


def test_orthonormal_repairs_a_rotation() -> None:
    rot = Rotation.from_rotvec((0.3, -0.2, 1.0)).as_matrix()
    repaired = m.orthonormal(rot + 1e-5 * np.arange(9).reshape(3, 3))
    np.testing.assert_allclose(repaired @ repaired.T, np.eye(3), atol=1e-7)
