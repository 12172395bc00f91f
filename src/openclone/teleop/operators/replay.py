"""A recorded operator, played back as if it came from a headset."""

from __future__ import annotations

import threading
from dataclasses import dataclass

import numpy as np

from openclone.spatial import rotations
from openclone.spatial.clock import Clock, MonotonicClock, Ticker
from openclone.teleop.messages import LatestValue, OperatorFrame, OperatorRecording


@dataclass(frozen=True)
class ReplayConfig:
    """How a recording is played.

    Attributes:
        rate_hz: frames per second, those of a headset.
        lead_in_s: seconds of the first pose, for calibration and ramp.
        ease_s: seconds in which the playback gathers speed and in which it slows
            down, so that a recording that begins or ends amid a stride does not jerk.
        tail_s: seconds of the last pose before the operator counts as finished.
    """

    rate_hz: float = 90.0
    lead_in_s: float = 1.5
    ease_s: float = 0.6
    tail_s: float = 1.0


class Playback:
    """A recording on the time axis of its playback, sampled at a constant rate."""

    def __init__(self, recording: OperatorRecording, config: ReplayConfig) -> None:
        """Resample the recording: linear for positions, slerp for orientations."""
        self.config = config
        self._length_s = recording.seconds
        self._ease_s = min(config.ease_s, recording.seconds)
        self.period_ns = round(1e9 / config.rate_hz)
        self.seconds = config.lead_in_s + self._length_s + self._ease_s + config.tail_s
        play_s = np.arange(int(self.seconds * config.rate_hz) + 1) / config.rate_hz
        at = self.recording_time(play_s)
        stamps = (recording.stamps_ns - recording.stamps_ns[0]) * 1e-9
        low = np.clip(np.searchsorted(stamps, at, "right") - 1, 0, len(stamps) - 2)
        part = ((at - stamps[low]) / (stamps[low + 1] - stamps[low]))[:, None]
        first, second = recording.positions[low], recording.positions[low + 1]
        self.positions = first + part[..., None] * (second - first)
        quats = recording.quats
        self.quats = rotations.slerp(quats[low], quats[low + 1], part)

    def recording_time(self, play_s: np.ndarray) -> np.ndarray:
        """Seconds into the recording after ``play_s`` seconds of playback.

        The speed of playback rises evenly from 0 to 1, stays, and falls to 0 again.
        """
        ease, length = self._ease_s, self._length_s
        t = np.clip(play_s - self.config.lead_in_s, 0.0, length + ease)
        rising = 0.5 * np.minimum(t, ease) ** 2 / max(ease, 1e-9)
        steady = np.clip(t - ease, 0.0, length - ease)
        late = np.clip(t - length, 0.0, ease)
        falling = late - 0.5 * late**2 / max(ease, 1e-9)
        return np.minimum(rising + steady + falling, length)

    def frame(self, index: int, receive_stamp_ns: int) -> OperatorFrame:
        """Sample ``index`` of the playback; its last one repeats."""
        last = len(self.positions) - 1
        shown = min(max(index, 0), last)
        return OperatorFrame(
            sensor_stamp_ns=index * self.period_ns,
            receive_stamp_ns=receive_stamp_ns,
            positions=self.positions[shown],
            quats=self.quats[shown],
            tracked=np.ones(3, dtype=bool),
        )


class ReplayOperator:
    """Plays a recording in real time from a thread, or sampled by the loop's clock."""

    def __init__(
        self,
        recording: OperatorRecording,
        config: ReplayConfig | None = None,
        *,
        realtime: bool = True,
    ) -> None:
        """Prepare the playback; `start` sets its time zero."""
        self.playback = Playback(recording, config or ReplayConfig())
        self._realtime = realtime
        self._slot: LatestValue[OperatorFrame] = LatestValue()
        self._stopping = threading.Event()
        self._thread: threading.Thread | None = None
        self._start_ns = 0

    def start(self, clock: Clock) -> None:
        """Begin to play now."""
        self._start_ns = clock.now_ns()
        if self._realtime:
            self._thread = threading.Thread(target=self._play, daemon=True)
            self._thread.start()

    def stop(self) -> None:
        """End the thread."""
        self._stopping.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def latest(self, now_ns: int) -> OperatorFrame | None:
        """The newest frame at ``now_ns``."""
        if self._realtime:
            return self._slot.get()
        index = (now_ns - self._start_ns) // self.playback.period_ns
        stamp = self._start_ns + index * self.playback.period_ns
        return self.playback.frame(index, stamp)

    def finished(self, now_ns: int) -> bool:
        """Whether the recording and its tail are over."""
        return (now_ns - self._start_ns) * 1e-9 >= self.playback.seconds

    def recording_time(self, sensor_stamps_ns: np.ndarray) -> np.ndarray:
        """Seconds into the recording shown by frames with these sensor stamps."""
        return self.playback.recording_time(np.asarray(sensor_stamps_ns) * 1e-9)

    def _play(self) -> None:
        # Spinning here would keep the interpreter from the control loop.
        ticker = Ticker(MonotonicClock(spin_ns=0), self.playback.period_ns)
        while not self._stopping.is_set():
            wake = ticker.wait()
            index = (wake.deadline_ns - self._start_ns) // self.playback.period_ns
            self._slot.put(self.playback.frame(index, wake.now_ns))
