"""Eq. 2 against its closed form."""

import numpy as np
import pytest

from openclone.odometry.noise import OdometryNoise, OdometryNoiseConfig

N = 4000
DT = 0.02
FREE = {"max_error": 1e9, "reset_period": 1e12}


def walk(config, speeds, seed=0):
    """Errors after moving with each of ``speeds`` for one step along x."""
    noise = OdometryNoise(N, config, np.random.default_rng(seed))
    for speed in speeds:
        velocity = np.zeros((N, 3))
        velocity[:, 0] = speed
        noise.step(velocity, DT)
    return noise.error


@pytest.mark.parametrize("speed", [0.0, 0.5, 2.0])
def test_variance_grows_linearly_with_time_at_constant_speed(speed):
    config = OdometryNoiseConfig(c_vel=20.0, c_min=0.01, **FREE)
    rate = speed / 20.0 + 0.01
    for steps in (25, 100):
        error = walk(config, [speed] * steps)
        # dp = rate dW: each axis is normal with variance rate^2 t.
        expected = rate * np.sqrt(steps * DT)
        assert error.std(axis=0) == pytest.approx([expected] * 3, rel=0.05)
        assert np.abs(error.mean(axis=0)).max() < 5 * expected / np.sqrt(N)
        correlation = np.corrcoef(error.T) - np.eye(3)
        assert np.abs(correlation).max() < 5 / np.sqrt(N)
        # Kurtosis of a normal distribution: 3.
        assert (error**4).mean() / (error**2).mean() ** 2 == pytest.approx(3, abs=0.25)


def test_variance_adds_up_over_changing_speed():
    config = OdometryNoiseConfig(c_vel=10.0, c_min=0.005, **FREE)
    speeds = np.linspace(0.0, 1.5, 60)
    expected = np.sqrt(((speeds / 10.0 + 0.005) ** 2).sum() * DT)
    assert walk(config, speeds).std() == pytest.approx(expected, rel=0.03)


def test_the_step_length_does_not_matter():
    config = OdometryNoiseConfig(c_vel=10.0, c_min=0.01, **FREE)
    noise = OdometryNoise(N, config, np.random.default_rng(0))
    velocity = np.tile([0.0, 1.0, 0.0], (N, 1))
    for _ in range(200):
        noise.step(velocity, DT / 4)
    assert noise.error.std() == pytest.approx(0.11 * np.sqrt(1.0), rel=0.03)


def test_resets_make_the_age_exponential():
    config = OdometryNoiseConfig(c_vel=1e9, c_min=0.02, max_error=1e9, reset_period=0.5)
    error = walk(config, [0.0] * 400)
    # Resets at rate 1/T: the error's age is exponential with mean T, so the variance
    # settles at rate^2 T (discretized: the age counts whole steps).
    chance = DT / 0.5
    age = DT * (1 - chance) / chance
    assert error.var() == pytest.approx(0.02**2 * age, rel=0.08)
    at_zero = (np.abs(error).sum(axis=1) == 0).mean()
    assert at_zero == pytest.approx(chance, abs=5 * np.sqrt(chance / N))


def test_deviation_is_bounded_and_reaches_the_bound():
    config = OdometryNoiseConfig(
        c_vel=1.0, c_min=0.5, max_error=0.10, reset_period=1e12
    )
    error = walk(config, [1.0] * 50)
    size = np.linalg.norm(error, axis=1)
    assert size.max() <= 0.10 + 1e-12
    assert (size > 0.0999).mean() > 0.1


def test_reset_clears_the_chosen_robots_only():
    noise = OdometryNoise(3, OdometryNoiseConfig(**FREE), np.random.default_rng(0))
    noise.step(np.ones((3, 3)), DT)
    before = noise.error.copy()
    noise.reset(np.array([1]))
    assert not noise.error[1].any()
    np.testing.assert_array_equal(noise.error[[0, 2]], before[[0, 2]])
