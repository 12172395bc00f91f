"""Rotations: group axioms, exp and log, frames, and NumPy against torch and SciPy."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.spatial.transform import Rotation

from openclone.spatial import rotations as rot

unit_floats = st.floats(-1, 1, width=32)
quats = (
    arrays(np.float64, 4, elements=unit_floats)
    .filter(lambda q: np.linalg.norm(q) > 0.1)
    .map(lambda q: q / np.linalg.norm(q))
)
vectors = arrays(np.float64, 3, elements=st.floats(-5, 5, width=32))
angles = st.floats(-3.1, 3.1)


def scipy_of(quat: np.ndarray) -> Rotation:
    return Rotation.from_quat(np.roll(quat, -1, axis=-1))


def same_rotation(a: np.ndarray, b: np.ndarray, tolerance: float = 1e-9) -> bool:
    """Compare rotations by matrix: q and -q are one rotation."""
    return np.allclose(rot.to_matrix(a), rot.to_matrix(b), atol=tolerance)


@given(quats, quats, quats)
def test_multiplication_is_associative(a, b, c):
    left = rot.multiply(rot.multiply(a, b), c)
    assert np.allclose(left, rot.multiply(a, rot.multiply(b, c)), atol=1e-12)


@given(quats)
def test_identity_and_inverse(q):
    one = np.array(rot.IDENTITY)
    assert np.array_equal(rot.multiply(one, q), q)
    assert np.array_equal(rot.multiply(q, one), q)
    assert np.allclose(rot.multiply(q, rot.conjugate(q)), one, atol=1e-12)


@given(quats, quats, vectors)
def test_product_acts_like_one_rotation_after_the_other(a, b, v):
    at_once = rot.rotate(rot.multiply(a, b), v)
    assert np.allclose(at_once, rot.rotate(a, rot.rotate(b, v)), atol=1e-9)


@given(quats, vectors, vectors)
def test_rotation_keeps_lengths_angles_and_handedness(q, v, w):
    rv, rw = rot.rotate(q, v), rot.rotate(q, w)
    assert np.isclose(rv @ rw, v @ w, atol=1e-9)
    assert np.allclose(np.cross(rv, rw), rot.rotate(q, np.cross(v, w)), atol=1e-9)


@given(quats, vectors)
def test_rotate_agrees_with_matrix_inverse_and_scipy(q, v):
    assert np.allclose(rot.to_matrix(q) @ v, rot.rotate(q, v), atol=1e-9)
    assert np.allclose(scipy_of(q).apply(v), rot.rotate(q, v), atol=1e-9)
    assert np.allclose(rot.rotate_inverse(q, rot.rotate(q, v)), v, atol=1e-9)


@given(quats)
def test_matrix_round_trip(q):
    back = rot.from_matrix(rot.to_matrix(q))
    assert back[0] >= 0
    assert same_rotation(back, q)
    columns = rot.to_matrix(q)[:, :2].T.ravel()
    assert np.allclose(rot.to_6d(q), columns, atol=1e-12)


@pytest.mark.parametrize("axis", np.vstack((np.eye(3), -np.eye(3))))
def test_from_matrix_survives_half_turns(axis):
    half_turn = 2 * np.outer(axis, axis) - np.eye(3)
    assert np.allclose(rot.to_matrix(rot.from_matrix(half_turn)), half_turn, atol=1e-12)


@given(quats)
def test_exp_inverts_log(q):
    log = rot.to_rotation_vector(q)
    assert np.linalg.norm(log) <= math.pi + 1e-9
    assert same_rotation(rot.from_rotation_vector(log), q)
    assert np.isclose(np.linalg.norm(log), scipy_of(q).magnitude(), atol=1e-7)


@given(arrays(np.float64, 3, elements=st.floats(-1.7, 1.7)))
def test_log_inverts_exp_within_pi(v):
    # The cube of half-width 1.7 has its corners at 2.94 rad, inside the ball of pi.
    log = rot.to_rotation_vector(rot.from_rotation_vector(v))
    assert np.allclose(log, v, atol=1e-7)


def test_tiny_and_zero_rotations_stay_finite():
    for size in (0.0, 1e-12, 1e-9, 1e-7):
        v = np.array([size, 0, 0])
        q = rot.from_rotation_vector(v)
        assert np.allclose(q, [1, size / 2, 0, 0], atol=1e-15)
        assert np.allclose(rot.to_rotation_vector(q), v, atol=1e-15)
    assert np.isfinite(rot.normalize(np.zeros(4))).all()


@pytest.mark.parametrize("turn", [0.0, 1e-7, 1e-3, 0.5, 3.0, math.pi - 1e-7, math.pi])
def test_angle_between_is_the_angle_of_the_turn(turn):
    axis = np.array([2.0, -1.0, 2.0]) / 3.0
    start = rot.from_axis_angle(np.array([0.0, 0.6, 0.8]), 1.3)
    end = rot.multiply(start, rot.from_axis_angle(axis, turn))
    for there in (end, -end):
        assert rot.angle_between(start, there) == pytest.approx(turn, abs=1e-14)
    # Single precision knows a turn to half a millionth of a radian.
    pair = (torch.tensor(q, dtype=torch.float32) for q in (start, end))
    assert float(rot.angle_between(*pair)) == pytest.approx(turn, abs=5e-7)


@given(quats, quats)
def test_angle_between_is_a_metric(a, b):
    angle = rot.angle_between(a, b)
    assert 0 <= angle <= math.pi + 1e-9
    assert np.isclose(angle, rot.angle_between(b, a), atol=1e-9)
    assert np.isclose(angle, rot.angle_between(a, -b), atol=1e-7)
    expected = (scipy_of(a).inv() * scipy_of(b)).magnitude()
    assert np.isclose(angle, expected, atol=1e-7)


@given(quats, quats, st.floats(0, 1))
def test_slerp_divides_the_angle(a, b, fraction):
    whole = rot.angle_between(a, b)
    middle = rot.slerp(a, b, fraction)
    assert np.isclose(rot.angle_between(a, middle), fraction * whole, atol=1e-6)
    assert np.isclose(rot.angle_between(middle, b), (1 - fraction) * whole, atol=1e-6)


@given(angles, vectors)
def test_yaw_turns_about_the_vertical(angle, v):
    q = rot.from_yaw(np.array(angle))
    x, y = v[:2]
    turned = (
        math.cos(angle) * x - math.sin(angle) * y,
        math.sin(angle) * x + math.cos(angle) * y,
        v[2],
    )
    assert np.allclose(rot.rotate(q, v), turned, atol=1e-9)
    assert np.isclose(rot.yaw(q), angle, atol=1e-9)


@given(angles, st.floats(-1.5, 1.5), st.floats(-3, 3))
def test_heading_ignores_pitch_and_roll(yaw, pitch, roll):
    q = rot.from_euler(np.array([yaw, pitch, roll]), "ZYX")
    assert np.allclose(rot.wrap_angle(rot.yaw(q) - yaw), 0, atol=1e-7)
    assert same_rotation(rot.heading(q), rot.from_yaw(np.array(yaw)), 1e-7)


@given(arrays(np.float64, 3, elements=angles), st.permutations("XYZ"))
def test_euler_angles_are_intrinsic(turns, order):
    # SciPy writes intrinsic orders with capitals.
    expected = Rotation.from_euler("".join(order), turns)
    q = rot.from_euler(turns, "".join(order))
    assert np.allclose(rot.to_matrix(q), expected.as_matrix(), atol=1e-9)


def test_make_continuous_flips_signs_only():
    turn = rot.from_yaw(np.linspace(0, 3 * math.pi, 50))
    broken = turn * np.where(np.arange(50) % 3 == 0, -1.0, 1.0)[:, None]
    smooth = rot.make_continuous(broken)
    assert ((smooth[1:] * smooth[:-1]).sum(-1) > 0).all()
    assert np.allclose(np.abs((smooth * turn).sum(-1)), 1)


@given(st.floats(-50, 50))
def test_wrap_angle(angle):
    wrapped = rot.wrap_angle(angle)
    assert -math.pi <= wrapped < math.pi
    assert np.isclose(math.cos(wrapped), math.cos(angle), atol=1e-9)
    assert np.isclose(math.sin(wrapped), math.sin(angle), atol=1e-9)


def batch(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    a, b = rot.normalize(rng.standard_normal((2, 7, 3, 4)))
    return a, b, rng.standard_normal((7, 3, 3))


TWINS = {
    "normalize": lambda a, b, v: rot.normalize(3 * a),
    "multiply": lambda a, b, v: rot.multiply(a, b),
    "conjugate": lambda a, b, v: rot.conjugate(a),
    "rotate": lambda a, b, v: rot.rotate(a, v),
    "rotate_inverse": lambda a, b, v: rot.rotate_inverse(a, v),
    "heading": lambda a, b, v: rot.heading(a),
    "log": lambda a, b, v: rot.to_rotation_vector(a),
    "exp": lambda a, b, v: rot.from_rotation_vector(v),
    "exp of zero": lambda a, b, v: rot.from_rotation_vector(0 * v),
    "angle_between": lambda a, b, v: rot.angle_between(a, b),
    "slerp": lambda a, b, v: rot.slerp(a, b, 0.25 + 0 * a[..., 0]),
    "slerp, one fraction": lambda a, b, v: rot.slerp(a, b, 0.25),
    "to_matrix": lambda a, b, v: rot.to_matrix(a),
    "to_6d": lambda a, b, v: rot.to_6d(a),
    "wrap_angle": lambda a, b, v: rot.wrap_angle(9 * v),
}


@pytest.mark.parametrize("name", TWINS)
def test_numpy_and_torch_agree(name):
    arguments = batch(np.random.default_rng(3))
    expected = TWINS[name](*arguments)
    found = TWINS[name](*(torch.from_numpy(item) for item in arguments))
    assert isinstance(expected, np.ndarray)
    assert isinstance(found, torch.Tensor)
    assert found.dtype == torch.float64
    assert np.allclose(found.numpy(), expected, atol=1e-12)


@pytest.mark.parametrize("name", TWINS)
def test_batches_agree_with_single_items(name):
    arguments = batch(np.random.default_rng(4))
    whole = TWINS[name](*arguments)
    one = TWINS[name](*(item[2, 1] for item in arguments))
    assert np.allclose(whole[2, 1], one, atol=1e-12)


def test_vertical_is_the_turned_z_axis() -> None:
    quats = rot.normalize(np.random.default_rng(0).standard_normal((20, 4)))
    up = np.tile([0.0, 0.0, 1.0], (20, 1))
    assert np.allclose(rot.vertical(quats), rot.rotate(quats, up), atol=1e-12)
