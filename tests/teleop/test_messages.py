import threading
import time
from typing import Any

import numpy as np
import pytest

from openclone.errors import InputError
from openclone.teleop.messages import (
    BackgroundSubscriber,
    LatestValue,
    OperatorRecording,
    check_recording,
    recording_at_rate,
)


def test_latest_value_keeps_the_newest_and_counts() -> None:
    slot: LatestValue[int] = LatestValue()
    assert slot.get() is None
    for value in range(5):
        slot.put(value)
    assert slot.get() == 4
    assert slot.count == 5


def test_latest_value_under_many_threads() -> None:
    slot: LatestValue[int] = LatestValue()

    def write() -> None:
        for value in range(500):
            slot.put(value)

    threads = [threading.Thread(target=write) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert slot.count == 2000
    assert slot.get() == 499


def test_a_slow_subscriber_drops_instead_of_blocking() -> None:
    release = threading.Event()
    seen: list[Any] = []

    def slow(tick: Any) -> None:
        release.wait(5.0)
        seen.append(tick)

    subscriber = BackgroundSubscriber(slow, capacity=4)
    tick: Any = object()
    began = time.monotonic()
    for _ in range(100):
        subscriber.put(tick)
    assert time.monotonic() - began < 1.0
    assert subscriber.dropped >= 95
    release.set()
    subscriber.close()
    assert len(seen) + subscriber.dropped == 100


def good() -> tuple[np.ndarray, np.ndarray]:
    return np.zeros((4, 3, 3)), np.tile([1.0, 0, 0, 0], (4, 3, 1))


def test_constant_rate_stamps() -> None:
    recording = recording_at_rate("r", 50.0, *good())
    np.testing.assert_array_equal(recording.stamps_ns, [0, 20e6, 40e6, 60e6])
    assert recording.seconds == pytest.approx(0.06)


def test_bad_recordings_are_named() -> None:
    positions, quats = good()
    stamps = np.arange(4) * 10
    with pytest.raises(InputError, match="2 samples"):
        check_recording(OperatorRecording("r", stamps[:1], positions[:1], quats[:1]))
    with pytest.raises(InputError, match="do not increase"):
        check_recording(
            OperatorRecording("r", np.array([0, 2, 1, 3]), positions, quats)
        )
    with pytest.raises(InputError, match="positions has shape"):
        check_recording(OperatorRecording("r", stamps, positions[:, :2], quats))
    positions[2, 1, 0] = np.nan
    with pytest.raises(InputError, match=r"r: positions\[2, 1, 0\] is not a finite"):
        check_recording(OperatorRecording("r", stamps, positions, quats))
