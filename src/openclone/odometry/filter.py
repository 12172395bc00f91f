"""The iterated error-state Kalman filter of FAST-LIO2.

Propagation integrates the IMU on the manifold and carries the covariance along. The
update finds the most probable state given the propagated one and the planes seen; it
inverts matrices of the state's size (23), never of the number of points, because

    (H'R⁻¹H + P⁻¹)⁻¹ = (I + P H'R⁻¹H)⁻¹ P

whose right side also holds when parts of P are zero (an extrinsic that is not
estimated).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from openclone.odometry.manifold import (
    ERROR_SIZE,
    exp_rotation,
    minus,
    minus_jacobian,
    orthonormal,
    plus,
    right_jacobian,
    skew,
    sphere_basis,
)

KNOT_SIZE = 22
"""A knot of the trajectory: time, rotation, position, velocity, rate, acceleration."""


@dataclass(frozen=True)
class ImuNoise:
    """How far to trust the IMU; densities are for white noise.

    Attributes:
        gyro: rad/s per √Hz.
        accel: m/s² per √Hz.
        gyro_walk: rad/s² per √Hz, wandering of the bias.
        accel_walk: m/s³ per √Hz, wandering of the bias.
        roughness: share of the difference of two neighbouring samples that is
            taken as the error of their mean. A foot impact between two samples is
            thus believed less than smooth motion.
        gap: seconds between samples from which on the motion between them counts
            as unknown.
        gap_gyro: rad/s, unknown rotation during a gap (1 sigma).
        gap_accel: m/s², unknown acceleration during a gap (1 sigma).
    """

    gyro: float = 1e-3
    accel: float = 1e-2
    gyro_walk: float = 1e-4
    accel_walk: float = 5e-4
    roughness: float = 0.2
    gap: float = 0.03
    gap_gyro: float = 0.5
    gap_accel: float = 3.0

    def as_array(self) -> np.ndarray:
        """The numbers in the order of the attributes, for compiled code."""
        return np.array(
            (
                self.gyro,
                self.accel,
                self.gyro_walk,
                self.accel_walk,
                self.roughness,
                self.gap,
                self.gap_gyro,
                self.gap_accel,
            )
        )


@njit(cache=True, nogil=True)
def move(
    state: np.ndarray, rate: np.ndarray, accel: np.ndarray, period: float
) -> np.ndarray:
    """The nominal state ``period`` seconds later.

    Args:
        state: flat state.
        rate: (3,), rad/s, IMU frame, bias removed.
        accel: (3,), m/s², world, gravity added.
        period: seconds; may be negative.
    """
    out = state.copy()
    rot = state[0:9].reshape(3, 3) @ exp_rotation(rate * period)
    out[0:9] = orthonormal(rot).reshape(9)
    out[9:12] += state[12:15] * period + 0.5 * accel * period**2
    out[12:15] += accel * period
    return out


@njit(cache=True, nogil=True)
def world_acceleration(
    state: np.ndarray, rate: np.ndarray, accel: np.ndarray, period: float
) -> np.ndarray:
    """Acceleration ``(3,)``, world, from ``accel`` felt in the middle of a step."""
    half = exp_rotation(rate * (0.5 * period))
    return state[0:9].reshape(3, 3) @ (half @ accel) + state[21:24]


@njit(cache=True, nogil=True)
def transition(
    state: np.ndarray, rate: np.ndarray, accel: np.ndarray, period: float
) -> np.ndarray:
    """Derivative ``(23, 23)`` of the next error by the present one.

    Arguments as for `move`, but ``accel`` is in the IMU frame with its bias removed.
    """
    out = np.eye(ERROR_SIZE)
    rot = state[0:9].reshape(3, 3)
    turn = exp_rotation(rate * period)
    jacobian = right_jacobian(rate * period) * period
    half = exp_rotation(rate * (0.5 * period))
    half_jacobian = right_jacobian(rate * (0.5 * period)) * (0.5 * period)
    felt = rot @ half
    by_rotation = -(rot @ skew(half @ accel))
    by_gyro_bias = felt @ skew(accel) @ half_jacobian
    by_gravity = -(skew(state[21:24]) @ sphere_basis(state[21:24]))
    out[0:3, 0:3] = turn.T
    out[0:3, 9:12] = -jacobian
    scales = (0.5 * period**2, period)
    for block in range(2):
        first, scale = 3 + 3 * block, scales[block]
        out[first : first + 3, 0:3] = by_rotation * scale
        out[first : first + 3, 9:12] = by_gyro_bias * scale
        out[first : first + 3, 12:15] = -felt * scale
        out[first : first + 3, 15:17] = by_gravity * scale
    for i in range(3):
        out[3 + i, 6 + i] = period
    return out


@njit(cache=True, nogil=True)
def process_noise(
    period: float, gyro_step: float, accel_step: float, noise: np.ndarray
) -> np.ndarray:
    """Variances ``(23,)`` that one step adds.

    Args:
        period: seconds.
        gyro_step: rad/s, difference of the two gyro samples around the step.
        accel_step: m/s², the same for the accelerometer.
        noise: `ImuNoise.as_array`.
    """
    out = np.zeros(ERROR_SIZE)
    unknown = 1.0 if period > noise[5] else 0.0
    rate = noise[4] * gyro_step + unknown * noise[6]
    accel = noise[4] * accel_step + unknown * noise[7]
    velocity = noise[1] ** 2 * period + (accel * period) ** 2
    out[0:3] = noise[0] ** 2 * period + (rate * period) ** 2
    out[3:6] = 0.25 * velocity * period**2
    out[6:9] = velocity
    out[9:12] = noise[2] ** 2 * period
    out[12:15] = noise[3] ** 2 * period
    return out


@njit(cache=True, nogil=True)
def propagate(
    state: np.ndarray,
    covariance: np.ndarray,
    times: np.ndarray,
    gyro: np.ndarray,
    accel: np.ndarray,
    noise: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Forward propagation through IMU samples.

    Args:
        state: flat state at ``times[0]``.
        covariance: (23, 23).
        times: (n,), seconds, increasing.
        gyro: (n, 3), rad/s.
        accel: (n, 3), m/s².
        noise: `ImuNoise.as_array`.

    Returns:
        The state and covariance at ``times[-1]`` and the path between: ``(n, 22)``
        knots with time, rotation, position, velocity, and the rate (IMU frame) and
        acceleration (world) that hold from that knot on.
    """
    count = len(times)
    path = np.zeros((count, KNOT_SIZE))
    covariance = covariance.copy()
    for k in range(count):
        path[k, 0] = times[k]
        path[k, 1:16] = state[0:15]
        if k == count - 1:
            break
        period = times[k + 1] - times[k]
        rate = 0.5 * (gyro[k] + gyro[k + 1]) - state[15:18]
        felt = 0.5 * (accel[k] + accel[k + 1]) - state[18:21]
        accel_w = world_acceleration(state, rate, felt, period)
        step = transition(state, rate, felt, period)
        covariance = step @ covariance @ step.T
        added = process_noise(
            period,
            np.sqrt(((gyro[k + 1] - gyro[k]) ** 2).sum()),
            np.sqrt(((accel[k + 1] - accel[k]) ** 2).sum()),
            noise,
        )
        for i in range(ERROR_SIZE):
            covariance[i, i] += added[i]
        path[k, 16:19] = rate
        path[k, 19:22] = accel_w
        state = move(state, rate, accel_w, period)
    return state, 0.5 * (covariance + covariance.T), path


@njit(cache=True, nogil=True)
def gauss_newton_step(
    state: np.ndarray,
    predicted: np.ndarray,
    covariance: np.ndarray,
    information: np.ndarray,
    gradient: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """One iteration of the update, Eq. 17-18 of FAST-LIO2.

    Args:
        state: present guess.
        predicted: propagated state, the centre of the prior.
        covariance: (23, 23), of the prior.
        information: (23, 23), H'R⁻¹H at ``state``.
        gradient: (23,), H'R⁻¹z at ``state``, z the residuals.

    Returns:
        The step ``(23,)`` from ``state`` and the covariance ``(23, 23)`` around it.
    """
    inverse = np.linalg.inv(minus_jacobian(state, predicted))
    prior = inverse @ covariance @ inverse.T
    system = np.eye(ERROR_SIZE) + prior @ information
    pull = prior @ gradient + inverse @ minus(state, predicted)
    right = np.empty((ERROR_SIZE, ERROR_SIZE + 1))
    right[:, :ERROR_SIZE] = prior
    right[:, ERROR_SIZE] = pull
    solved = np.linalg.solve(system, right)
    posterior = solved[:, :ERROR_SIZE]
    step = -solved[:, ERROR_SIZE]
    return step, 0.5 * (posterior + posterior.T)


@njit(cache=True, nogil=True)
def apply_step(
    state: np.ndarray, covariance: np.ndarray, step: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Displace ``state`` and carry the covariance into the new tangent space."""
    moved = plus(state, step)
    # An error e around the old state is the error J⁻¹(e - step) around the new one.
    back = np.linalg.inv(minus_jacobian(moved, state))
    return moved, back @ covariance @ back.T


@njit(cache=True, nogil=True)
def coast(
    state: np.ndarray, times: np.ndarray, gyro: np.ndarray, accel: np.ndarray
) -> np.ndarray:
    """The nominal state at ``times[-1]``; as `propagate`, without the covariance."""
    for k in range(len(times) - 1):
        period = times[k + 1] - times[k]
        rate = 0.5 * (gyro[k] + gyro[k + 1]) - state[15:18]
        felt = 0.5 * (accel[k] + accel[k + 1]) - state[18:21]
        accel_w = world_acceleration(state, rate, felt, period)
        state = move(state, rate, accel_w, period)
    return state
