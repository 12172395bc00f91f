"""Propagation against exact motion, the update against the textbook form."""

import numpy as np
from scipy.spatial.transform import Rotation

from openclone.odometry import filter as f
from openclone.odometry import manifold as m

RNG = np.random.default_rng(0)


def state_at_rest() -> np.ndarray:
    state = np.zeros(m.STATE_SIZE)
    state[m.ROT] = state[m.ROT_LIDAR] = np.eye(3).ravel()
    state[m.GRAVITY] = (0.0, 0.0, -9.80665)
    return state


def step(state: np.ndarray, gyro: np.ndarray, accel: np.ndarray, dt: float):
    times = np.array((0.0, dt))
    return f.coast(state, times, np.stack((gyro, gyro)), np.stack((accel, accel)))


def test_transition_against_finite_differences() -> None:
    start = m.plus(state_at_rest(), 0.5 * RNG.standard_normal(m.ERROR_SIZE))
    gyro, accel, dt = np.array((2.0, -1.0, 3.0)), np.array((3.0, 8.0, -5.0)), 0.02
    following = step(start, gyro, accel, dt)
    numeric = np.zeros((m.ERROR_SIZE, m.ERROR_SIZE))
    for k in range(m.ERROR_SIZE):
        e = np.zeros(m.ERROR_SIZE)
        e[k] = 1e-6
        high = m.minus(step(m.plus(start, e), gyro, accel, dt), following)
        low = m.minus(step(m.plus(start, -e), gyro, accel, dt), following)
        numeric[:, k] = (high - low) / 2e-6
    analytic = f.transition(
        start, gyro - start[m.GYRO_BIAS], accel - start[m.ACCEL_BIAS], dt
    )
    np.testing.assert_allclose(analytic, numeric, atol=2e-7)


def test_a_circle_is_integrated() -> None:
    """Turning at w on a circle of radius r: known rate and force, known end."""
    radius, rate, seconds, hz = 2.0, 1.5, 3.0, 200
    times = np.arange(round(seconds * hz) + 1) / hz
    state = state_at_rest()
    state[m.VEL] = (radius * rate, 0.0, 0.0)
    gyro = np.tile((0.0, 0.0, rate), (len(times), 1))
    accel = np.tile((0.0, radius * rate**2, 9.80665), (len(times), 1))
    end = f.coast(state, times, gyro, accel)
    angle = rate * seconds
    np.testing.assert_allclose(
        end[m.POS],
        (radius * np.sin(angle), radius * (1 - np.cos(angle)), 0.0),
        atol=1e-3,
    )
    turned = Rotation.from_matrix(end[m.ROT].reshape(3, 3)).as_rotvec()
    assert abs((turned[2] - angle + np.pi) % (2 * np.pi) - np.pi) < 1e-6


def test_propagate_and_coast_agree_and_biases_are_removed() -> None:
    times = np.linspace(0.0, 0.1, 21)
    gyro, accel = RNG.standard_normal((21, 3)), RNG.standard_normal((21, 3))
    state, noise = state_at_rest(), f.ImuNoise().as_array()
    end, covariance, path = f.propagate(
        state, np.eye(m.ERROR_SIZE) * 1e-4, times, gyro, accel, noise
    )
    np.testing.assert_allclose(end, f.coast(state, times, gyro, accel), atol=1e-12)
    np.testing.assert_allclose(path[-1, 1:16], end[:15])
    assert np.linalg.eigvalsh(covariance)[0] > 0.0
    biased = state.copy()
    biased[m.GYRO_BIAS], biased[m.ACCEL_BIAS] = (0.1, 0.2, 0.3), (1.0, 2.0, 3.0)
    shifted = f.coast(
        biased, times, gyro + biased[m.GYRO_BIAS], accel + biased[m.ACCEL_BIAS]
    )
    np.testing.assert_allclose(shifted[:15], end[:15], atol=1e-12)


def test_covariance_matches_a_cloud_of_noisy_integrations() -> None:
    """Monte Carlo: white IMU noise of known density gives the predicted spread."""
    noise = f.ImuNoise(
        gyro=0.02, accel=0.2, gyro_walk=0.0, accel_walk=0.0, roughness=0.0, gap=1.0
    )
    count, dt = 40, 0.005
    times = np.arange(count + 1) * dt
    state, zero = state_at_rest(), np.zeros((m.ERROR_SIZE, m.ERROR_SIZE))
    rest = np.tile((0.0, 0.0, 9.80665), (count + 1, 1))
    still = np.zeros((count + 1, 3))
    mean, covariance, _ = f.propagate(state, zero, times, still, rest, noise.as_array())
    errors = []
    for _ in range(1500):
        end = state
        for _k in range(count):
            gyro = 0.02 / np.sqrt(dt) * RNG.standard_normal(3)
            accel = rest[0] + 0.2 / np.sqrt(dt) * RNG.standard_normal(3)
            end = step(end, gyro, accel, dt)
        errors.append(m.minus(end, mean)[:9])
    sampled, expected = np.cov(np.array(errors).T), covariance[:9, :9]
    ratio = np.diag(sampled) / np.diag(expected)
    np.testing.assert_allclose(ratio, 1.0, atol=0.15)


def test_a_gap_and_a_shock_are_less_certain() -> None:
    noise = f.ImuNoise().as_array()
    calm = f.process_noise(0.005, 0.0, 0.0, noise)
    assert f.process_noise(0.005, 0.0, 40.0, noise)[6] > 100 * calm[6]
    assert f.process_noise(0.2, 0.0, 0.0, noise)[6] > 0.3**2


def test_update_equals_the_textbook_kalman_filter() -> None:
    """One step with a large H, against K = P H' (H P H' + R)^-1."""
    predicted = state_at_rest()
    root = RNG.standard_normal((m.ERROR_SIZE, m.ERROR_SIZE)) * 0.01
    prior = root @ root.T
    prior[17:, :] = prior[:, 17:] = 0.0  # an extrinsic that is not estimated
    rows, sigma = 60, 0.02
    jacobian = RNG.standard_normal((rows, m.ERROR_SIZE))
    residuals = 0.01 * RNG.standard_normal(rows)
    gain = (
        prior
        @ jacobian.T
        @ np.linalg.inv(jacobian @ prior @ jacobian.T + sigma**2 * np.eye(rows))
    )
    move, posterior = f.gauss_newton_step(
        predicted,
        predicted,
        prior,
        jacobian.T @ jacobian / sigma**2,
        jacobian.T @ residuals / sigma**2,
    )
    np.testing.assert_allclose(move, -gain @ residuals, atol=1e-9)
    np.testing.assert_allclose(posterior, prior - gain @ jacobian @ prior, atol=1e-9)


def test_iterating_finds_the_most_probable_state() -> None:
    """At the result, the gradient of prior and measurement together is zero."""
    predicted = state_at_rest()
    prior = np.diag(np.full(m.ERROR_SIZE, 0.3**2))
    target = m.plus(predicted, 0.5 * RNG.standard_normal(m.ERROR_SIZE))
    variance, state = 0.2**2, predicted
    information = np.eye(m.ERROR_SIZE) / variance
    # The measurement is the state itself: residual = state [-] target.
    for _ in range(20):
        jacobian = m.minus_jacobian(state, target)
        move, posterior = f.gauss_newton_step(
            state,
            predicted,
            prior,
            jacobian.T @ information @ jacobian,
            jacobian.T @ information @ m.minus(state, target),
        )
        state, posterior = f.apply_step(state, posterior, move)

    def cost(e: np.ndarray) -> float:
        trial = m.plus(state, e)
        a, b = m.minus(trial, predicted), m.minus(trial, target)
        return a @ a / 0.3**2 + b @ b / variance

    for k in range(m.ERROR_SIZE):
        e = np.zeros(m.ERROR_SIZE)
        e[k] = 1e-4
        assert abs(cost(e) - cost(-e)) / 2e-4 < 1e-3
