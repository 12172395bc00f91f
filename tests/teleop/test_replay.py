import time

import numpy as np
import pytest

from openclone.spatial import rotations
from openclone.spatial.clock import ManualClock, MonotonicClock
from openclone.teleop.messages import OperatorRecording, recording_at_rate
from openclone.teleop.operators.replay import Playback, ReplayConfig, ReplayOperator

CONFIG = ReplayConfig(lead_in_s=1.0, ease_s=0.5, tail_s=0.5)


def test_time_stands_runs_and_stands(walking: OperatorRecording) -> None:
    playback = Playback(walking, CONFIG)
    length = walking.seconds
    times = playback.recording_time(np.array([0.0, 1.0, 1.5, 2.5, 1.0 + length, 99.0]))
    # While the speed rises evenly from 0 to 1 half as much is shown.
    np.testing.assert_allclose(
        times, [0, 0, 0.25, 1.25, length - 0.25, length], atol=1e-9
    )
    speed = np.diff(playback.recording_time(np.linspace(0, 6, 6001))) / 0.001
    assert speed.min() >= -1e-6
    assert speed.max() <= 1.0 + 1e-6
    assert np.abs(np.diff(speed)).max() < 0.003  # no jerk


def test_positions_are_interpolated_and_the_ends_are_held(
    walking: OperatorRecording,
) -> None:
    playback = Playback(walking, CONFIG)
    first = playback.frame(0, 7)
    np.testing.assert_allclose(first.positions, walking.positions[0])
    assert first.receive_stamp_ns == 7
    last = playback.frame(10**6, 8)
    np.testing.assert_allclose(last.positions, walking.positions[-1], atol=1e-9)
    index = 225  # 2.5 s of playback show 1.25 s
    expected = walking.positions[0] + [0.5 * 1.25, 0, 0]
    np.testing.assert_allclose(playback.frame(index, 0).positions, expected, atol=1e-6)


def test_orientations_are_interpolated_on_the_sphere() -> None:
    quats = np.stack([rotations.from_yaw(np.full(3, yaw)) for yaw in (0.0, 1.0)])
    recording = recording_at_rate("turn", 1.0, np.zeros((2, 3, 3)), -quats)
    playback = Playback(recording, ReplayConfig(lead_in_s=0.0, ease_s=0.0))
    frame = playback.frame(45, 0)  # half a second
    assert rotations.angle_between(frame.quats[0], quats[0, 0]) == pytest.approx(0.5)


def test_sampled_by_the_clock_without_real_time(walking: OperatorRecording) -> None:
    clock = ManualClock(10**9)
    operator = ReplayOperator(walking, CONFIG, realtime=False)
    operator.start(clock)
    clock.advance(2_500_000_000)
    frame = operator.latest(clock.now_ns())
    assert frame is not None
    # The newest of 90 frames a second: never from the future, at most 1/90 s old.
    assert 0 <= clock.now_ns() - frame.receive_stamp_ns < 11_111_112
    shown = operator.recording_time(np.array([frame.sensor_stamp_ns]))[0]
    assert shown == pytest.approx(1.25, abs=0.012)
    assert not operator.finished(clock.now_ns())
    clock.advance(3_000_000_000)
    assert operator.finished(clock.now_ns())
    operator.stop()


def test_in_real_time_frames_come_from_a_thread() -> None:
    positions = np.linspace(0, 1, 40)[:, None, None] * np.ones((40, 3, 3))
    recording = recording_at_rate(
        "r", 100, positions, np.tile([1.0, 0, 0, 0], (40, 3, 1))
    )
    operator = ReplayOperator(recording, ReplayConfig(lead_in_s=0.0, ease_s=0.0))
    clock = MonotonicClock()
    operator.start(clock)
    stamps = set()
    began = time.monotonic()
    while time.monotonic() - began < 0.4:
        frame = operator.latest(clock.now_ns())
        if frame:
            stamps.add(frame.sensor_stamp_ns)
        time.sleep(0.005)
    operator.stop()
    assert 10 <= len(stamps) <= 40  # 36 on an idle machine
    assert all(stamp % operator.playback.period_ns == 0 for stamp in stamps)
