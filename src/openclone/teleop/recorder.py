"""Recording of ticks: a subscriber that collects, a log of plain arrays, one file."""

from __future__ import annotations

import json
import zipfile
from dataclasses import dataclass, fields
from pathlib import Path

import numpy as np

from openclone.errors import InputError
from openclone.teleop.messages import LoopTick

FORMAT = "openclone-session-1"
MAX_FILE_BYTES = 1024 * 1024 * 1024
_SHAPES: dict[str, tuple[int, ...]] = {
    "stamp_ns": (),
    "phase": (),
    "operator_stamp_ns": (),
    "operator_position": (3, 3),
    "operator_quat": (3, 4),
    "target_position": (3, 3),
    "target_quat": (3, 4),
    "target_velocity": (3, 3),
    "measured_position": (3, 3),
    "measured_quat": (3, 4),
    "base_position": (3,),
    "base_quat": (4,),
    "joint_angles": (29,),
    "joint_velocities": (29,),
    "torque": (29,),
    "action": (29,),
    "targets": (29,),
    "qpos": (36,),
    "qvel": (35,),
    "fallen": (),
    "duration_ns": (),
    "overruns": (),
}
_WHOLE = ("stamp_ns", "operator_stamp_ns", "duration_ns", "overruns")


@dataclass(frozen=True)
class TickLog:
    """T ticks as arrays; what a tick lacked is NaN (stamps: -1).

    Attributes:
        stamp_ns: (T,), the loop's clock.
        phase: (T,), `teleop.messages.Phase` as numbers.
        operator_stamp_ns: (T,), the sensor's clock.
        operator_position, operator_quat: (T, 3, 3), (T, 3, 4), operator's world.
        target_position, target_quat, target_velocity: the command, for the next tick.
        measured_position, measured_quat: head and hands as the robot believes.
        base_position, base_quat: (T, 3), (T, 4), by odometry.
        joint_angles, joint_velocities, torque: (T, 29), radians, rad/s, N m.
        action, targets: (T, 29), policy output; radians.
        qpos, qvel: (T, 36), (T, 35), true state of a simulated robot.
        fallen: (T,), bool.
        duration_ns: (T,), of the whole tick.
        overruns: (T,), deadlines missed so far.
    """

    stamp_ns: np.ndarray
    phase: np.ndarray
    operator_stamp_ns: np.ndarray
    operator_position: np.ndarray
    operator_quat: np.ndarray
    target_position: np.ndarray
    target_quat: np.ndarray
    target_velocity: np.ndarray
    measured_position: np.ndarray
    measured_quat: np.ndarray
    base_position: np.ndarray
    base_quat: np.ndarray
    joint_angles: np.ndarray
    joint_velocities: np.ndarray
    torque: np.ndarray
    action: np.ndarray
    targets: np.ndarray
    qpos: np.ndarray
    qvel: np.ndarray
    fallen: np.ndarray
    duration_ns: np.ndarray
    overruns: np.ndarray

    @property
    def num_ticks(self) -> int:
        """T."""
        return len(self.stamp_ns)


class TickRecorder:
    """A subscriber that keeps the ticks in memory, up to a limit."""

    def __init__(self, max_ticks: int = 60_000) -> None:
        """Keep the first ``max_ticks`` ticks (20 minutes by default)."""
        self._ticks: list[LoopTick] = []
        self._max_ticks = max_ticks
        self.dropped = 0

    def put(self, value: LoopTick, /) -> None:
        """Keep one tick, or count it as dropped if the memory is full."""
        if len(self._ticks) < self._max_ticks:
            self._ticks.append(value)
        else:
            self.dropped += 1

    @property
    def ticks(self) -> tuple[LoopTick, ...]:
        """What was kept so far."""
        return tuple(self._ticks)

    def log(self) -> TickLog:
        """The ticks as arrays."""
        rows = [_row(tick) for tick in self._ticks]
        columns = {}
        for name, shape in _SHAPES.items():
            values = [row[name] for row in rows]
            columns[name] = np.array(values, dtype=_dtype(name)).reshape(-1, *shape)
        return TickLog(**columns)


def _dtype(name: str) -> type:
    if name in _WHOLE:
        return np.int64
    return {"phase": np.int8, "fallen": np.bool_}.get(name, np.float64)


def _row(tick: LoopTick) -> dict[str, object]:
    """One tick's entries of the log."""
    operator, command = tick.operator, tick.command

    def nothing(name: str) -> np.ndarray:
        return np.full(_SHAPES[name], np.nan)

    return {
        "stamp_ns": tick.stamp_ns,
        "phase": int(tick.phase),
        "operator_stamp_ns": operator.sensor_stamp_ns if operator else -1,
        "operator_position": operator.positions
        if operator
        else nothing("operator_position"),
        "operator_quat": operator.quats if operator else nothing("operator_quat"),
        "target_position": command.target.position
        if command
        else nothing("target_position"),
        "target_quat": command.target.quat if command else nothing("target_quat"),
        "target_velocity": command.velocity if command else nothing("target_velocity"),
        "measured_position": tick.measured.position,
        "measured_quat": tick.measured.quat,
        "base_position": tick.base_position,
        "base_quat": tick.base_quat,
        "joint_angles": tick.reading.joint_angles,
        "joint_velocities": tick.reading.joint_velocities,
        "torque": tick.reading.torque,
        "action": tick.action,
        "targets": tick.targets,
        "qpos": nothing("qpos") if tick.qpos is None else tick.qpos,
        "qvel": nothing("qvel") if tick.qvel is None else tick.qvel,
        "fallen": tick.fallen,
        "duration_ns": tick.durations.total_ns,
        "overruns": tick.overruns,
    }


def save_log(log: TickLog, path: Path) -> None:
    """Write ``log`` as one ``.npz``; an interrupted write leaves no half file."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_name(path.name + ".partial")
    arrays = {field.name: getattr(log, field.name) for field in fields(TickLog)}
    metadata = np.array(json.dumps({"format": FORMAT, "ticks": log.num_ticks}))
    with partial.open("wb") as stream:
        np.savez_compressed(stream, metadata=metadata, **arrays)
    partial.replace(path)


def load_log(path: Path) -> TickLog:
    """Read a file written by `save_log`.

    Raises:
        InputError: the file is missing, too large, or not such a log.
    """
    where = str(path)
    if not path.is_file():
        raise InputError("no such session file", where=where)
    try:
        with zipfile.ZipFile(path) as archive:
            if sum(item.file_size for item in archive.infolist()) > MAX_FILE_BYTES:
                raise InputError("the arrays are larger than 1 GB", where=where)
        with np.load(path, allow_pickle=False) as data:
            if json.loads(str(data["metadata"])).get("format") != FORMAT:
                raise ValueError(f"not of the format {FORMAT}")
            columns = {name: data[name] for name in _SHAPES}
        count = len(columns["stamp_ns"])
        for name, shape in _SHAPES.items():
            if columns[name].shape != (count, *shape):
                raise ValueError(f"{name} has shape {columns[name].shape}")
    except (OSError, ValueError, KeyError, TypeError, zipfile.BadZipFile) as error:
        raise InputError(
            f"not a readable session ({error})",
            where=where,
            remedy="record it with `openclone teleop --record FILE`",
        ) from None
    return TickLog(**columns)
