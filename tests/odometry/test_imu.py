"""What the IMU stream refuses and what it interpolates."""

import numpy as np
import pytest

from openclone.errors import InputError
from openclone.odometry.imu import CLOCK_SAMPLES, ClockJump, ImuBuffer, ImuConfig

UP = np.array((0.0, 0.0, 9.81))
PERIOD = 5_000_000


def filled(count: int = 50) -> ImuBuffer:
    buffer = ImuBuffer(ImuConfig())
    for k in range(count):
        buffer.append(k * PERIOD, np.array((k, 0.0, 0.0)) * 0.1, UP)
    return buffer


@pytest.mark.parametrize(
    ("stamp", "gyro", "accel", "text"),
    [
        (1.5, np.zeros(3), UP, "whole number"),
        (True, np.zeros(3), UP, "whole number"),
        (1, np.zeros(4), UP, "gyro sample has shape"),
        (1, np.zeros(3), np.zeros((1, 3)), "acceleration sample has shape"),
        (1, np.full(3, np.nan), UP, "gyro sample is"),
        (1, np.full(3, 200.0), UP, "rad/s"),
        (1, np.zeros(3), np.full(3, 9810.0), "m/s²"),
        (1, ["a", "b", "c"], UP, "type"),
    ],
)
def test_malformed_samples_are_refused(stamp, gyro, accel, text: str) -> None:
    buffer = ImuBuffer(ImuConfig())
    with pytest.raises(InputError, match=text):
        buffer.append(stamp, gyro, accel)
    assert len(buffer) == 0


@pytest.mark.parametrize(("scale", "text"), [(1 / 9.81, "are g;"), (0.0, "gravity")])
def test_wrong_units_of_acceleration_show_in_the_first_samples(scale, text) -> None:
    buffer = ImuBuffer(ImuConfig())
    for k in range(9):
        buffer.append(k * PERIOD, np.zeros(3), UP * scale)
    with pytest.raises(InputError, match=text):
        buffer.append(9 * PERIOD, np.zeros(3), UP * scale)
    # The next ones, in m/s², are taken.
    for k in range(20, 40):
        buffer.append(k * PERIOD, np.zeros(3), UP)
    assert len(buffer) == 20


@pytest.mark.parametrize("step", [0, -PERIOD, -10 * PERIOD, 10**12, 500])
def test_a_stamp_out_of_order_leaves_no_trace(step: int) -> None:
    buffer = filled()
    newest = buffer.newest_ns
    with pytest.raises(InputError, match="ns"):
        buffer.append(newest + step, np.zeros(3), UP)
    assert len(buffer) == 50
    assert buffer.append(newest + PERIOD, np.zeros(3), UP) == newest + PERIOD


def test_a_clock_set_back_for_good_is_noticed() -> None:
    buffer = filled(500)
    for k in range(CLOCK_SAMPLES - 1):
        with pytest.raises(InputError):
            buffer.append(k * PERIOD, np.zeros(3), UP)
    with pytest.raises(ClockJump):
        buffer.append(CLOCK_SAMPLES * PERIOD, np.zeros(3), UP)


def test_samples_of_an_interval_are_interpolated_at_its_ends() -> None:
    buffer = filled()
    start, end = 10 * PERIOD + 1_000_000, 12 * PERIOD + 2_500_000
    times, gyro, accel = buffer.between(start, end)
    np.testing.assert_allclose(times, [0.0, 0.004, 0.009, 0.0115])
    np.testing.assert_allclose(gyro[:, 0], [1.02, 1.1, 1.2, 1.25])
    np.testing.assert_allclose(accel, np.tile(UP, (4, 1)))


def test_beyond_the_newest_sample_it_is_held() -> None:
    buffer = filled()
    times, gyro, _ = buffer.between(48 * PERIOD, 55 * PERIOD)
    np.testing.assert_allclose(times, [0.0, 0.005, 0.035])
    np.testing.assert_allclose(gyro[:, 0], [4.8, 4.9, 4.9])


def test_old_samples_make_room() -> None:
    buffer = ImuBuffer(ImuConfig(capacity=100))
    for k in range(1000):
        buffer.append(k * PERIOD, np.zeros(3), UP)
    assert len(buffer) == 100
    assert buffer.oldest_ns == 900 * PERIOD


def test_pauses_are_counted() -> None:
    buffer = filled()
    newest = buffer.newest_ns
    buffer.append(newest + 200_000_000, np.zeros(3), UP)
    assert buffer.gaps == 1
    assert buffer.longest_pause(newest) == 200_000_000
