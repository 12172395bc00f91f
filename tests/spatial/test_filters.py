import math

import numpy as np

from openclone.spatial import rotations
from openclone.spatial.filters import (
    Differentiator,
    OneEuroConfig,
    OneEuroFilter,
    OneEuroRotationFilter,
    smoothing_factor,
)

PERIOD = 1 / 90
CONFIG = OneEuroConfig(min_cutoff_hz=1.5, beta=5.0, speed_cutoff_hz=1.0)


def test_smoothing_factor_is_that_of_a_backward_euler_low_pass() -> None:
    # tau dx/dt = u - x, implicit step of h: weight h / (tau + h), tau = 1 / (2 pi f).
    tau = 1 / (2 * math.pi * 3.0)
    assert math.isclose(float(smoothing_factor(3.0, 0.01)), 0.01 / (tau + 0.01))


def test_first_sample_passes_and_a_constant_stays() -> None:
    still = np.array([[1.0, 2.0, 3.0]])
    smoother = OneEuroFilter(CONFIG)
    for _ in range(20):
        np.testing.assert_array_equal(smoother.update(still, PERIOD), still)


def test_trembling_at_rest_is_damped() -> None:
    rng = np.random.default_rng(0)
    noise = 0.001 * rng.standard_normal((900, 1, 3))
    smoother = OneEuroFilter(OneEuroConfig(1.5, 0.5, 1.0))
    out = np.array([smoother.update(sample, PERIOD) for sample in noise])
    # White noise through a first-order low-pass keeps a / (2 - a) of its variance.
    weight = float(smoothing_factor(1.5, PERIOD))
    expected = 0.001 * math.sqrt(weight / (2 - weight))
    assert out[100:].std() < 1.5 * expected
    assert out[100:].std() < 0.3 * 0.001


def test_fast_motion_lags_less_than_slow_motion() -> None:
    def lag_s(speed: float) -> float:
        smoother = OneEuroFilter(CONFIG)
        for index in range(400):
            truth = np.array([speed * index * PERIOD, 0.0, 0.0])
            out = smoother.update(truth, PERIOD)
        return float(truth[0] - out[0]) / speed

    # On a ramp a low-pass lags by its time constant.
    assert lag_s(0.01) > 0.09
    assert lag_s(1.0) < 0.04
    assert lag_s(3.0) < lag_s(1.0)


def test_result_does_not_depend_on_the_axes() -> None:
    rng = np.random.default_rng(1)
    path = np.cumsum(0.01 * rng.standard_normal((60, 2, 3)), axis=0)
    turn = rotations.normalize(rng.standard_normal(4))
    plain, turned = OneEuroFilter(CONFIG), OneEuroFilter(CONFIG)
    for sample in path:
        expected = rotations.rotate(turn, plain.update(sample, PERIOD))
        found = turned.update(rotations.rotate(turn, sample), PERIOD)
        np.testing.assert_allclose(found, expected, atol=1e-12)


def test_a_repeated_stamp_changes_nothing() -> None:
    smoother = OneEuroFilter(CONFIG)
    smoother.update(np.zeros(3), 0.0)
    before = smoother.update(np.ones(3), PERIOD)
    np.testing.assert_array_equal(smoother.update(5 * np.ones(3), 0.0), before)


def test_rotation_filter_follows_a_turn_and_ignores_the_sign() -> None:
    smoother = OneEuroRotationFilter(CONFIG)
    for index in range(300):
        angle = 1.0 * index * PERIOD
        quat = rotations.from_yaw(np.array([angle]))
        out = smoother.update(quat * (-1.0) ** index, PERIOD)
    behind = float(rotations.angle_between(out, quat)[0])
    assert 0.001 < behind < 0.05  # 1 rad/s and a lag below 50 ms
    np.testing.assert_allclose(np.linalg.norm(out, axis=-1), 1.0)
    # It stays on the way between old and new: no tilt out of the plane.
    np.testing.assert_allclose(out[..., 1:3], 0.0, atol=1e-12)


def test_differentiator_finds_the_speed_of_a_ramp() -> None:
    differentiator = Differentiator(6.0)
    for index in range(200):
        velocity = differentiator.update(
            np.array([0.7 * index * PERIOD, 0.0, 0.0]), PERIOD
        )
    np.testing.assert_allclose(velocity, [0.7, 0, 0], atol=1e-6)


def test_differentiator_delays_by_its_time_constant() -> None:
    differentiator = Differentiator(6.0)
    velocity = np.zeros(1)
    for index in range(400):
        # Constant acceleration of 2: the velocity estimate trails by 1/(2 pi 6) s
        # and half a sample.
        t = index * PERIOD
        velocity = differentiator.update(np.array([t * t]), PERIOD)
    delay = t - float(velocity[0]) / 2
    assert abs(delay - (1 / (2 * math.pi * 6.0) + PERIOD / 2)) < 0.002
