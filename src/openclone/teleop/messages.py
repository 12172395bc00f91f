"""What travels through the running system: operator frames in, loop ticks out."""

from __future__ import annotations

import threading
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from queue import Empty, Full, Queue
from typing import Generic, Protocol, TypeVar

import numpy as np

from openclone.errors import InputError
from openclone.policy.command import NUM_POINTS, Command, KeyPoints
from openclone.simulation.robot import RobotReading

T = TypeVar("T")


@dataclass(frozen=True)
class OperatorFrame:
    """One sample of the operator's head and wrists, in the operator's own world.

    The world is metres, Z up. Points stand in the order of `policy.command.POINTS`.
    A head is the identity when it looks along +X; a hand when the arm points along
    +X with the palm inward and the thumb up.

    Attributes:
        sensor_stamp_ns: when it was measured, in the sensor's own clock.
        receive_stamp_ns: when it arrived here, in the loop's clock.
        positions: (3, 3), metres.
        quats: (3, 4), wxyz, operator's world from point.
        tracked: (3,), bool; False where the sensor lost the point.
    """

    sensor_stamp_ns: int
    receive_stamp_ns: int
    positions: np.ndarray
    quats: np.ndarray
    tracked: np.ndarray


@dataclass(frozen=True)
class OperatorRecording:
    """A recorded operator, to be replayed; conventions as in `OperatorFrame`.

    Attributes:
        name: where it comes from.
        stamps_ns: (T,), int64, increasing.
        positions: (T, 3, 3), metres.
        quats: (T, 3, 4), wxyz.
    """

    name: str
    stamps_ns: np.ndarray
    positions: np.ndarray
    quats: np.ndarray

    @property
    def seconds(self) -> float:
        """Duration from the first to the last sample."""
        return float(self.stamps_ns[-1] - self.stamps_ns[0]) * 1e-9


def recording_at_rate(
    name: str, fps: float, positions: np.ndarray, quats: np.ndarray
) -> OperatorRecording:
    """Make a recording from samples at a constant rate, the first at time zero."""
    stamps = np.round(np.arange(len(positions)) * (1e9 / fps)).astype(np.int64)
    return check_recording(OperatorRecording(name, stamps, positions, quats))


def check_recording(recording: OperatorRecording) -> OperatorRecording:
    """Return ``recording`` if it is well formed, else raise `InputError`."""
    count = len(recording.stamps_ns)
    where = recording.name
    if count < 2:
        raise InputError(
            f"an operator recording needs 2 samples or more, this one has {count}",
            where=where,
        )
    if not (np.diff(recording.stamps_ns) > 0).all():
        raise InputError("the time stamps do not increase", where=where)
    for name, width in (("positions", 3), ("quats", 4)):
        values = getattr(recording, name)
        shape = (count, NUM_POINTS, width)
        if values.shape != shape:
            raise InputError(
                f"{name} has shape {values.shape}, expected {shape}", where=where
            )
        bad = np.argwhere(~np.isfinite(values))
        if len(bad):
            raise InputError(
                f"{name}[{', '.join(map(str, bad[0]))}] is not a finite number",
                where=where,
                remedy="cut this part out of the recording",
            )
    return recording


class Phase(IntEnum):
    """What the loop is doing; `teleop.safety` holds the transitions."""

    IDLE = 0
    READY = 1
    RAMP = 2
    ACTIVE = 3
    HOLD = 4
    DAMPING = 5


@dataclass(frozen=True)
class TickDurations:
    """Where the time of one tick went, nanoseconds.

    Attributes:
        input_ns: reading operator, robot and odometry, calibration, kinematics.
        policy_ns: observation and inference.
        output_ns: guard and writing to the robot (simulated: the physics, too).
        total_ns: from wake-up until the targets are out.
    """

    input_ns: int
    policy_ns: int
    output_ns: int
    total_ns: int


@dataclass(frozen=True)
class LoopTick:
    """Everything one tick of the loop saw and did.

    The robot's quantities are those at the beginning of the tick, before ``targets``
    act; ``command`` is what head and hands should reach at the next tick.

    Attributes:
        index: number of the tick, from 0.
        stamp_ns: the loop's clock at the beginning of the tick.
        phase: of the safety state machine.
        trigger: name of what changed the phase in this tick, or "".
        operator: newest operator frame, or None before the first one.
        command: targets in the robot's odometry world; None before calibration.
        measured: head and hands by odometry and kinematics.
        reading: the robot's own sensors.
        base_position: (3,), metres, pelvis, by odometry.
        base_quat: (4,), wxyz, world from pelvis: odometry's heading, IMU's tilt.
        action: (29,), the policy's output.
        targets: (29,), radians, sent to the robot.
        qpos: (36,), true positions, if the robot is simulated.
        qvel: (35,), true velocities, if the robot is simulated.
        fallen: whether a simulated robot has fallen.
        durations: where the time went.
        overruns: deadlines missed so far.
    """

    index: int
    stamp_ns: int
    phase: Phase
    trigger: str
    operator: OperatorFrame | None
    command: Command | None
    measured: KeyPoints
    reading: RobotReading
    base_position: np.ndarray
    base_quat: np.ndarray
    action: np.ndarray
    targets: np.ndarray
    qpos: np.ndarray | None
    qvel: np.ndarray | None
    fallen: bool
    durations: TickDurations
    overruns: int


class Subscriber(Protocol):
    """Receives every tick; ``put`` runs in the loop and must return at once."""

    def put(self, value: LoopTick, /) -> None:
        """Take one tick."""
        ...


class LatestValue(Generic[T]):
    """A slot that holds the newest value only; writers and readers never wait.

    As a `Subscriber` it suits a viewer that polls at its own rate.
    """

    def __init__(self) -> None:
        """Start empty."""
        self._lock = threading.Lock()
        self._value: T | None = None
        self._count = 0

    def put(self, value: T, /) -> None:
        """Replace the value."""
        with self._lock:
            self._value = value
            self._count += 1

    def get(self) -> T | None:
        """The newest value, or None if there was none yet."""
        with self._lock:
            return self._value

    @property
    def count(self) -> int:
        """How many values were put; tells a reader whether there is news."""
        with self._lock:
            return self._count


class BackgroundSubscriber:
    """Calls a slow function with the ticks, in a thread of its own.

    Ticks that come while ``capacity`` others wait are dropped and counted, so the
    loop is never held up.
    """

    def __init__(
        self, function: Callable[[LoopTick], None], capacity: int = 256
    ) -> None:
        """Start the thread; end it with `close`."""
        self._function = function
        self._queue: Queue[LoopTick] = Queue(capacity)
        self._closed = threading.Event()
        self.dropped = 0
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    def put(self, value: LoopTick, /) -> None:
        """Queue one tick, or drop it if the queue is full."""
        try:
            self._queue.put_nowait(value)
        except Full:
            self.dropped += 1

    def close(self) -> None:
        """Deliver what is queued, then end the thread."""
        self._closed.set()
        self._thread.join()

    def _work(self) -> None:
        while not (self._closed.is_set() and self._queue.empty()):
            try:
                tick = self._queue.get(timeout=0.05)
            except Empty:
                continue
            self._function(tick)
