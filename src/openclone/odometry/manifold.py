"""The state of FAST-LIO2 and the geometry it lives on, compiled.

The nominal state is one flat vector (`STATE_SIZE` numbers) so that compiled loops can
take it; its slices are named here. The error state has 23 dimensions: rotations err on
their right side, ``R Exp(theta)``, and gravity errs on the sphere of its length (S²,
two dimensions). Section III of the FAST-LIO2 paper (Xu et al., 2022).
"""

from __future__ import annotations

import numpy as np
from numba import njit

# Slices of the nominal state: world from IMU, then IMU from LiDAR.
ROT = slice(0, 9)
POS = slice(9, 12)
VEL = slice(12, 15)
GYRO_BIAS = slice(15, 18)
ACCEL_BIAS = slice(18, 21)
GRAVITY = slice(21, 24)
ROT_LIDAR = slice(24, 33)
POS_LIDAR = slice(33, 36)
STATE_SIZE = 36

# Slices of the error state.
E_ROT = slice(0, 3)
E_POS = slice(3, 6)
E_VEL = slice(6, 9)
E_GYRO_BIAS = slice(9, 12)
E_ACCEL_BIAS = slice(12, 15)
E_GRAVITY = slice(15, 17)
E_ROT_LIDAR = slice(17, 20)
E_POS_LIDAR = slice(20, 23)
ERROR_SIZE = 23

SMALL = 1e-9


@njit(cache=True, nogil=True)
def skew(v: np.ndarray) -> np.ndarray:
    """Matrix of the cross product: ``skew(v) @ u = v x u``, ``(3, 3)``."""
    out = np.zeros((3, 3))
    out[0, 1], out[0, 2] = -v[2], v[1]
    out[1, 0], out[1, 2] = v[2], -v[0]
    out[2, 0], out[2, 1] = -v[1], v[0]
    return out


@njit(cache=True, nogil=True)
def exp_rotation(v: np.ndarray) -> np.ndarray:
    """Rotation matrix ``(3, 3)`` of the rotation vector ``v (3,)`` in radians."""
    angle2 = v[0] * v[0] + v[1] * v[1] + v[2] * v[2]
    if angle2 < SMALL:
        a, b = 1.0 - angle2 / 6.0, 0.5 - angle2 / 24.0
    else:
        angle = np.sqrt(angle2)
        a, b = np.sin(angle) / angle, (1.0 - np.cos(angle)) / angle2
    s = skew(v)
    return np.eye(3) + a * s + b * (s @ s)


@njit(cache=True, nogil=True)
def log_rotation(rot: np.ndarray) -> np.ndarray:
    """Rotation vector ``(3,)`` of a rotation matrix, angle below pi."""
    w = np.array((rot[2, 1] - rot[1, 2], rot[0, 2] - rot[2, 0], rot[1, 0] - rot[0, 1]))
    sine = 0.5 * np.sqrt((w * w).sum())
    cosine = 0.5 * (rot[0, 0] + rot[1, 1] + rot[2, 2] - 1.0)
    angle = np.arctan2(sine, cosine)
    if sine < 1e-7:
        return 0.5 * w
    return w * (0.5 * angle / sine)


@njit(cache=True, nogil=True)
def right_jacobian(v: np.ndarray) -> np.ndarray:
    """``Exp(v + u) = Exp(v) Exp(J u)`` for small u, ``(3, 3)``."""
    angle2 = (v * v).sum()
    if angle2 < SMALL:
        a, b = 0.5 - angle2 / 24.0, 1.0 / 6.0 - angle2 / 120.0
    else:
        angle = np.sqrt(angle2)
        a = (1.0 - np.cos(angle)) / angle2
        b = (angle - np.sin(angle)) / (angle2 * angle)
    s = skew(v)
    return np.eye(3) - a * s + b * (s @ s)


@njit(cache=True, nogil=True)
def right_jacobian_inverse(v: np.ndarray) -> np.ndarray:
    """``Log(Exp(v) Exp(u)) = v + J u`` for small u, ``(3, 3)``."""
    angle2 = (v * v).sum()
    if angle2 < 1e-6:
        b = 1.0 / 12.0 + angle2 / 720.0
    else:
        angle = np.sqrt(angle2)
        b = 1.0 / angle2 - (1.0 + np.cos(angle)) / (2.0 * angle * np.sin(angle))
    s = skew(v)
    return np.eye(3) + 0.5 * s + b * (s @ s)


@njit(cache=True, nogil=True)
def orthonormal(rot: np.ndarray) -> np.ndarray:
    """Nearest rotation to an almost-rotation: one Newton step of the polar form."""
    return rot @ (1.5 * np.eye(3) - 0.5 * (rot.T @ rot))


@njit(cache=True, nogil=True)
def sphere_basis(gravity: np.ndarray) -> np.ndarray:
    """Two unit vectors across ``gravity``, ``(3, 2)``.

    They are the world's x and y axes turned by the smallest rotation that takes
    "down" to ``gravity``, so they change smoothly while gravity points anywhere
    but straight up.
    """
    n = gravity / np.sqrt((gravity * gravity).sum())
    # The axis is (0, 0, -1) x n, the cosine is -n_z.
    s = skew(np.array((n[1], -n[0], 0.0)))
    turn = np.eye(3) + s + (s @ s) / max(1.0 - n[2], 1e-12)
    return np.ascontiguousarray(turn[:, :2])


@njit(cache=True, nogil=True)
def sphere_minus(gravity: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Error ``(2,)`` that takes ``reference`` to ``gravity`` on their sphere."""
    axis = np.cross(reference, gravity)
    sine = np.sqrt((axis * axis).sum())
    cosine = (reference * gravity).sum()
    scale = np.arctan2(sine, cosine) / sine if sine > SMALL else 1.0 / cosine
    return sphere_basis(reference).T @ (axis * scale)


@njit(cache=True, nogil=True)
def sphere_minus_jacobian(gravity: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Derivative ``(2, 2)`` of ``(gravity [+] u) [-] reference`` by u at zero."""
    length2 = (reference * reference).sum()
    axis = np.cross(reference, gravity) / length2
    cosine = (reference * gravity).sum() / length2
    sine2 = (axis * axis).sum()
    if sine2 < SMALL:
        scale, slope = 1.0, -1.0 / 3.0
    else:
        sine = np.sqrt(sine2)
        angle = np.arctan2(sine, cosine)
        scale = angle / sine
        slope = (angle * cosine - sine) / (sine2 * sine)
    n, start = gravity / np.sqrt(length2), reference / np.sqrt(length2)
    moved = -skew(n) @ sphere_basis(gravity)
    full = scale * (skew(start) @ moved)
    pull = slope * (start @ moved)
    for i in range(3):
        for j in range(2):
            full[i, j] += axis[i] * pull[j]
    return sphere_basis(reference).T @ full


@njit(cache=True, nogil=True)
def plus(state: np.ndarray, error: np.ndarray) -> np.ndarray:
    """``state [+] error``: the state displaced by an error ``(23,)``."""
    out = state.copy()
    rot = state[0:9].reshape(3, 3) @ exp_rotation(error[0:3])
    out[0:9] = orthonormal(rot).reshape(9)
    out[9:21] += error[3:15]
    gravity = state[21:24]
    out[21:24] = exp_rotation(sphere_basis(gravity) @ error[15:17]) @ gravity
    rot = state[24:33].reshape(3, 3) @ exp_rotation(error[17:20])
    out[24:33] = orthonormal(rot).reshape(9)
    out[33:36] += error[20:23]
    return out


@njit(cache=True, nogil=True)
def minus(state: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """``state [-] reference``: the error ``(23,)`` from reference to state."""
    out = np.zeros(ERROR_SIZE)
    rot = reference[0:9].reshape(3, 3).T.copy() @ state[0:9].reshape(3, 3)
    out[0:3] = log_rotation(rot)
    out[3:15] = state[9:21] - reference[9:21]
    out[15:17] = sphere_minus(state[21:24], reference[21:24])
    rot = reference[24:33].reshape(3, 3).T.copy() @ state[24:33].reshape(3, 3)
    out[17:20] = log_rotation(rot)
    out[20:23] = state[33:36] - reference[33:36]
    return out


@njit(cache=True, nogil=True)
def minus_jacobian(state: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Derivative ``(23, 23)`` of ``(state [+] e) [-] reference`` by e at zero."""
    out = np.eye(ERROR_SIZE)
    error = minus(state, reference)
    out[0:3, 0:3] = right_jacobian_inverse(error[0:3])
    out[15:17, 15:17] = sphere_minus_jacobian(state[21:24], reference[21:24])
    out[17:20, 17:20] = right_jacobian_inverse(error[17:20])
    return out
