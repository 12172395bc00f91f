"""Each fault of an odometry against what it must do to a known motion."""

import numpy as np
import pytest

from openclone.odometry.faults import REAL, OdometryFaults, OdometryFaultsConfig

DT = 0.02
V = np.array([0.5, -0.2, 0.1])


def play(config, steps, count=1, error=None, seed=0):
    """Published minus true position, (steps, n, 3), of robots that move with V."""
    start = np.zeros((count, 3))
    rng = np.random.default_rng(seed)
    faults = OdometryFaults(start, config, DT, rng)
    out = np.empty((steps, count, 3))
    zero = np.zeros((count, 3))
    for step in range(steps):
        now = start + V * DT * (step + 1)
        wrong = zero if error is None else error[step]
        out[step] = faults.step(now, wrong) - now
    return out, faults


def test_off_means_the_error_of_eq_2_and_nothing_else():
    error = np.random.default_rng(1).standard_normal((30, 4, 3))
    out, _ = play(OdometryFaultsConfig(), 30, 4, error)
    np.testing.assert_allclose(out, error, atol=1e-14)


def test_delay_publishes_the_past():
    config = OdometryFaultsConfig(delay=0.1)
    out, faults = play(config, 40, 500)
    # At constant velocity the error is -delay * velocity.
    np.testing.assert_allclose(out[-1], -faults.delay[:, None] * V, atol=1e-12)
    assert faults.delay.max() <= 0.1
    assert faults.delay.max() > 0.098
    assert faults.delay.mean() == pytest.approx(0.05, abs=0.006)


def test_hold_without_propagation_is_a_sawtooth():
    config = OdometryFaultsConfig(scan_rate_hz=10.0, propagation=False)
    out, _ = play(config, 100, 50)
    late = -out[20:] @ V / (V @ V)
    # Fresh at every fifth control step, then 20, 40, 60, 80 ms old.
    np.testing.assert_allclose(np.unique(late.round(9)), [0, 0.02, 0.04, 0.06, 0.08])
    assert late.mean() == pytest.approx(0.04, abs=1e-9)
    fresh = (late[:5] < 1e-9).argmax(axis=0)
    assert len(np.unique(fresh)) == 5  # scans of different robots are out of step


def test_propagation_carries_the_position_between_scans():
    out, _ = play(OdometryFaultsConfig(scan_rate_hz=10.0), 100, 5)
    np.testing.assert_allclose(out, 0.0, atol=1e-12)
    # The error of Eq. 2 changes with the scans only.
    error = np.arange(50)[:, None, None] * np.ones((50, 5, 3))
    out, _ = play(OdometryFaultsConfig(scan_rate_hz=10.0), 50, 5, error)
    moved = np.diff(out[:, :, 0], axis=0)[10:]
    assert set(np.unique(moved.round(9))) == {0.0, 5.0}


def test_velocity_error_grows_between_scans():
    config = OdometryFaultsConfig(scan_rate_hz=10.0, velocity_error=0.3)
    out, faults = play(config, 60, 3000)
    age = faults._since_scan
    for seconds in (0.0, 0.02, 0.04, 0.06, 0.08):
        chosen = np.isclose(age, seconds)
        spread = out[-1][chosen].std() if seconds else np.abs(out[-1][chosen]).max()
        assert spread == pytest.approx(0.3 * seconds, rel=0.08, abs=1e-12)


def test_dropouts_have_their_rate_and_length():
    config = OdometryFaultsConfig(
        scan_rate_hz=10.0,
        propagation=False,
        dropout_interval=2.0,
        dropout_seconds=0.6,
    )
    start = np.zeros((1000, 3))
    faults = OdometryFaults(start, config, DT, np.random.default_rng(0))
    blind, longest = [], 0.0
    for step in range(500):
        now = start + V * DT * (step + 1)
        late = (now - faults.step(now, start)) @ V / (V @ V)
        longest = max(longest, faults._blind.max() + DT)
        blind.append(faults.blind.mean())
    assert late.max() > 0.2
    # Alternating renewal process: 0.3 s blind, 2 s not, on average.
    assert np.mean(blind[100:]) == pytest.approx(0.3 / 2.3, rel=0.1)
    assert 0.58 < longest <= 0.6 + 1e-9


def test_without_scans_the_drift_goes_on():
    config = OdometryFaultsConfig(
        scan_rate_hz=10.0,
        velocity_error=0.1,
        dropout_interval=DT,
        dropout_seconds=1e9,
    )
    out, _ = play(config, 100, 200)
    growth = np.diff(out[5:], axis=0)
    np.testing.assert_allclose(growth, growth[:1].repeat(len(growth), 0), atol=1e-12)


def test_jumps_come_at_their_rate_and_go_again():
    config = OdometryFaultsConfig(jump_interval=4.0, jump_size=0.1, jump_seconds=1.0)
    out, _ = play(config, 600, 500)
    size = np.linalg.norm(out, axis=-1)
    assert size.max() <= 0.1 + 1e-12
    assert size.max() > 0.099
    # Jumped for 1 of 5 seconds (rates 1/4 and 1); an even spread of sizes when jumped.
    jumped = size[200:] > 0
    assert jumped.mean() == pytest.approx(0.2, abs=0.02)
    assert size[200:][jumped].mean() == pytest.approx(0.05, abs=0.004)
    begins = (np.diff(jumped.astype(int), axis=0) == 1).sum()
    seconds = 400 * DT * 500 * 0.8
    assert begins == pytest.approx(seconds / 4.0, rel=0.12)


def test_reset_touches_the_chosen_robots_only():
    _, faults = play(REAL, 100, 6)
    now = np.zeros((6, 3)) + V * DT * 101
    kept = faults.delay.copy()
    faults.reset(np.array([2]), np.array([[9.0, 9.0, 9.0]]))
    assert faults.delay[2] != kept[2]
    np.testing.assert_array_equal(np.delete(faults.delay, 2), np.delete(kept, 2))
    now[2] = 9.0
    out = faults.step(now, np.zeros((6, 3)))
    assert np.linalg.norm(out[2] - 9.0) < 0.05
    assert np.linalg.norm(out - now, axis=1).max() < 0.5


def test_same_seed_same_faults():
    runs = [play(REAL, 200, 3, seed=5)[0] for _ in range(2)]
    np.testing.assert_array_equal(*runs)
    assert np.abs(runs[0]).max() > 0.01
