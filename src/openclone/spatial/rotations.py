"""Unit quaternions and rotations, for NumPy arrays and torch tensors alike.

Quaternions are ``wxyz`` along the last axis, unit length; ``q_a_from_b`` turns a
vector's coordinates in frame b into coordinates in frame a. Every function works on
any leading batch shape and returns the kind of array it was given, so the training
task (torch, batched) and the 50 Hz loop (NumPy, single) share one definition.
"""

from __future__ import annotations

import math
from types import ModuleType
from typing import Any

import numpy as np

Array = Any
"""A NumPy array or a torch tensor."""

IDENTITY = (1.0, 0.0, 0.0, 0.0)


def namespace(array: Array) -> ModuleType:
    """Return the module (``numpy`` or ``torch``) that ``array`` belongs to."""
    if isinstance(array, (np.ndarray, np.generic)):
        return np
    import torch

    return torch


def norm(vector: Array) -> Array:
    """Euclidean length over the last axis, kept: ``(..., n) -> (..., 1)``."""
    xp = namespace(vector)
    if xp is not np:  # its gradient at zero is zero, that of the root is not a number
        return xp.linalg.vector_norm(vector, dim=-1, keepdim=True)
    return xp.sqrt((vector * vector).sum(-1)[..., None])


def normalize(quat: Array) -> Array:
    """Scale ``(..., 4)`` to unit length; a zero quaternion stays finite."""
    length = norm(quat)
    return quat / (length + (length < 1e-12))


def cross(a: Array, b: Array) -> Array:
    """Cross product of vectors ``(..., 3)`` over the last axis."""
    xp = namespace(a)
    if xp is not np:
        return xp.linalg.cross(*xp.broadcast_tensors(a, b))
    ax, ay, az = a[..., 0], a[..., 1], a[..., 2]
    bx, by, bz = b[..., 0], b[..., 1], b[..., 2]
    parts = (ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx)
    return xp.stack(parts, -1)


def multiply(a: Array, b: Array) -> Array:
    """Hamilton product, in reading order: a from b, times b from c, is a from c."""
    xp = namespace(a)
    aw, ax, ay, az = a[..., 0], a[..., 1], a[..., 2], a[..., 3]
    bw, bx, by, bz = b[..., 0], b[..., 1], b[..., 2], b[..., 3]
    parts = (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )
    return xp.stack(parts, -1)


def conjugate(quat: Array) -> Array:
    """Inverse rotation of a unit quaternion, ``(..., 4)``."""
    xp = namespace(quat)
    return xp.concatenate((quat[..., :1], -quat[..., 1:]), -1)


def rotate(quat: Array, vector: Array) -> Array:
    """Rotate ``vector (..., 3)`` by ``quat (..., 4)``: coordinates b -> a."""
    imaginary = quat[..., 1:]
    twice = 2.0 * cross(imaginary, vector)
    return vector + quat[..., :1] * twice + cross(imaginary, twice)


def rotate_inverse(quat: Array, vector: Array) -> Array:
    """Rotate ``vector (..., 3)`` by the inverse of ``quat``: coordinates a -> b."""
    return rotate(conjugate(quat), vector)


def yaw(quat: Array) -> Array:
    """Heading angle about world Z, radians, ``(..., 4) -> (...)``."""
    xp = namespace(quat)
    w, x, y, z = quat[..., 0], quat[..., 1], quat[..., 2], quat[..., 3]
    atan2 = xp.arctan2
    return atan2(2.0 * (w * z + x * y), 1.0 - 2.0 * (y * y + z * z))


def vertical(quat: Array) -> Array:
    """World coordinates of the z axes of bodies, ``(..., 4) -> (..., 3)``."""
    xp = namespace(quat)
    w, x, y, z = (quat[..., k] for k in range(4))
    parts = (2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y))
    return xp.stack(parts, -1)


def from_yaw(angle: Array) -> Array:
    """Quaternion of a turn by ``angle`` radians about Z, ``(...) -> (..., 4)``."""
    xp = namespace(angle)
    half = 0.5 * angle
    zero = xp.zeros_like(half)
    return xp.stack((xp.cos(half), zero, zero, xp.sin(half)), -1)


def heading(quat: Array) -> Array:
    """The yaw-only part of ``quat``: the heading frame's orientation in the world."""
    return from_yaw(yaw(quat))


def to_rotation_vector(quat: Array) -> Array:
    """Logarithm: axis times angle in radians, ``(..., 4) -> (..., 3)``, angle <= pi."""
    xp = namespace(quat)
    sign = 1.0 - 2.0 * (quat[..., :1] < 0)
    quat = quat * sign
    length = norm(quat[..., 1:])
    angle = 2.0 * xp.arctan2(length, quat[..., :1])
    small = length < 1e-8
    return quat[..., 1:] * xp.where(small, 2.0 + 0.0 * length, angle / (length + small))


def from_rotation_vector(vector: Array) -> Array:
    """Exponential: axis times angle in radians, ``(..., 3)``, to ``(..., 4)``."""
    xp = namespace(vector)
    angle = norm(vector)
    small = angle < 1e-8
    scale = xp.where(small, 0.5 + 0.0 * angle, xp.sin(0.5 * angle) / (angle + small))
    return xp.concatenate((xp.cos(0.5 * angle), vector * scale), -1)


def angle_between(a: Array, b: Array) -> Array:
    """Rotation angle from a to b in radians, ``(..., 4) -> (...)``, in [0, pi].

    Two unit quaternions at an angle of t lie 2 sin(t / 4) apart.
    """
    xp = namespace(a)
    apart, across = norm(a - b)[..., 0], norm(a + b)[..., 0]
    return 4.0 * xp.arctan2(xp.minimum(apart, across), xp.maximum(apart, across))


def slerp(a: Array, b: Array, fraction: Array) -> Array:
    """Interpolate from a (0) to b (1) at constant speed, the short way round.

    ``a, b (..., 4)``; ``fraction`` broadcasts against their leading shape.
    """
    step = to_rotation_vector(multiply(conjugate(a), b))
    if not isinstance(fraction, float):
        fraction = fraction[..., None]
    return normalize(multiply(a, from_rotation_vector(step * fraction)))


def to_matrix(quat: Array) -> Array:
    """Rotation matrix ``(..., 3, 3)`` of ``quat (..., 4)``."""
    xp = namespace(quat)
    w, x, y, z = quat[..., 0], quat[..., 1], quat[..., 2], quat[..., 3]
    entries = (
        1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y),
        2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x),
        2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y),
    )  # fmt: skip
    return xp.stack(entries, -1).reshape((*quat.shape[:-1], 3, 3))


def to_6d(quat: Array) -> Array:
    """First two matrix columns, a continuous code for networks: ``(..., 6)``."""
    xp = namespace(quat)
    w, x, y, z = quat[..., 0], quat[..., 1], quat[..., 2], quat[..., 3]
    entries = (
        1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y),
        2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x),
    )  # fmt: skip
    return xp.stack(entries, -1)


def from_matrix(matrix: np.ndarray) -> np.ndarray:
    """Quaternion ``(..., 4)``, w >= 0, of rotation matrices ``(..., 3, 3)``; NumPy."""
    m = matrix
    trace = m[..., 0, 0] + m[..., 1, 1] + m[..., 2, 2]
    squares = np.stack(
        (
            1 + trace,
            1 + 2 * m[..., 0, 0] - trace,
            1 + 2 * m[..., 1, 1] - trace,
            1 + 2 * m[..., 2, 2] - trace,
        ),
        -1,
    )
    yz, zy = m[..., 1, 2], m[..., 2, 1]
    zx, xz = m[..., 2, 0], m[..., 0, 2]
    xy, yx = m[..., 0, 1], m[..., 1, 0]
    w, x, y, z = (squares[..., k] for k in range(4))
    rows = np.stack(
        (
            np.stack((w, zy - yz, xz - zx, yx - xy), -1),
            np.stack((zy - yz, x, xy + yx, zx + xz), -1),
            np.stack((xz - zx, xy + yx, y, yz + zy), -1),
            np.stack((yx - xy, zx + xz, yz + zy, z), -1),
        ),
        -2,
    )
    best = np.argmax(squares, -1)[..., None, None]
    quat = np.take_along_axis(rows, best, -2)[..., 0, :]
    return normalize(quat * np.where(quat[..., :1] < 0, -1.0, 1.0))


def from_axis_angle(axis: np.ndarray, angle: np.ndarray | float) -> np.ndarray:
    """Quaternion of a turn by ``angle`` radians about the unit ``axis (3,)``."""
    half = 0.5 * np.asarray(angle, dtype=float)[..., None]
    return np.concatenate((np.cos(half), np.sin(half) * np.asarray(axis)), -1)


def from_euler(angles: np.ndarray, order: str) -> np.ndarray:
    """Intrinsic Euler angles in radians to quaternions.

    ``angles (..., n)`` stand in the sequence of ``order``, e.g. ``"ZXY"`` turns about
    Z first, then about the new X, then the new Y (the convention of BVH channels).
    """
    axes = {"X": (1.0, 0, 0), "Y": (0, 1.0, 0), "Z": (0, 0, 1.0)}
    quat = np.array(IDENTITY)
    for index, name in enumerate(order.upper()):
        turn = from_axis_angle(np.array(axes[name]), angles[..., index])
        quat = multiply(quat * np.ones_like(turn), turn)
    return quat


def make_continuous(quats: np.ndarray) -> np.ndarray:
    """Flip signs along the first axis so that neighbours lie in one hemisphere."""
    dots = (quats[1:] * quats[:-1]).sum(-1)
    signs = np.cumprod(np.where(dots < 0, -1.0, 1.0), axis=0)
    out = quats.copy()
    out[1:] *= signs[..., None]
    return out


def wrap_angle(angle: Array) -> Array:
    """Map radians to [-pi, pi)."""
    return (angle + math.pi) % (2 * math.pi) - math.pi
