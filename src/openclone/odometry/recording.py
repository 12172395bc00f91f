"""Recordings of raw sensor streams: written as MCAP, read from MCAP and ROS 2 bags.

A recording is an MCAP file of profile ``ros2`` with CDR messages, so Foxglove,
``ros2 bag`` and rosbags open it. It has three topics:

- ``/livox/imu``, sensor_msgs/msg/Imu: rad/s and m/s², IMU frame;
- ``/livox/lidar``, sensor_msgs/msg/PointCloud2: per point ``x y z`` (float32, metres,
  LiDAR frame) and ``t`` (uint32, ns since the header's stamp), 16 bytes; the header's
  stamp is that of the earliest point; (0, 0, 0) where nothing came back;
- ``/ground_truth``, nav_msgs/msg/Odometry, if the truth is known: the IMU's pose.

Log times are the times of reception, and messages stand in that order.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType

from mcap.writer import CompressionType, Writer

from openclone.errors import InputError
from openclone.odometry.mcap_file import RawMessage, read_mcap
from openclone.odometry.ros_bag import read_bag
from openclone.odometry.ros_decode import decode
from openclone.odometry.ros_encode import encode
from openclone.odometry.ros_types import (
    CLOUD,
    CLOUDS,
    IMU,
    IMU_TOPIC,
    LIDAR_TOPIC,
    ODOMETRY,
    REFERENCE_TOPIC,
    type_store,
)
from openclone.odometry.samples import (
    AccelUnit,
    SensorSample,
    in_si_units,
    scans_after_imu,
    stamp_of,
)

_TOPICS = {IMU: IMU_TOPIC, CLOUD: LIDAR_TOPIC, ODOMETRY: REFERENCE_TOPIC}


class SensorRecorder:
    """Writes samples to an MCAP file; use it in a ``with`` statement.

    Chunks of 1 MB are flushed as they fill, so a recorder that dies loses its last
    second only: the rest of the file stays readable.
    """

    def __init__(self, path: Path) -> None:
        """Create ``path`` and its folder."""
        path.parent.mkdir(parents=True, exist_ok=True)
        self._file = path.open("wb")
        self._writer = Writer(self._file, compression=CompressionType.ZSTD)
        self._writer.start(profile="ros2", library="openclone")
        self._channels: dict[str, int] = {}
        self._counts: dict[str, int] = {}

    def __enter__(self) -> SensorRecorder:
        """Nothing more to do: the file is open."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Complete the file, also after an error."""
        self.close()

    def write(self, sample: SensorSample, received_ns: int | None = None) -> None:
        """Append ``sample``, received at ``received_ns`` (its own stamp by default)."""
        kind, header_ns, data = encode(sample)
        if kind not in self._channels:
            self._channels[kind] = self._add_channel(kind)
        self._counts[kind] = self._counts.get(kind, -1) + 1
        self._writer.add_message(
            self._channels[kind],
            log_time=stamp_of(sample) if received_ns is None else received_ns,
            publish_time=header_ns,
            data=data,
            sequence=self._counts[kind],
        )

    def close(self) -> None:
        """Write the index and close the file; further calls do nothing."""
        if not self._file.closed:
            self._writer.finish()
            self._file.close()

    def _add_channel(self, kind: str) -> int:
        text, _ = type_store().generate_msgdef(kind, ros_version=2)
        schema = self._writer.register_schema(kind, "ros2msg", text.encode())
        return self._writer.register_channel(_TOPICS[kind], "cdr", schema)


@dataclass(frozen=True)
class Topics:
    """Which topics to read; empty names are found by their type.

    Attributes:
        imu: sensor_msgs/msg/Imu.
        lidar: PointCloud2 or Livox CustomMsg.
        reference: nav_msgs/msg/Odometry to compare with; never found by its type,
            because a bag may hold any number of odometries.
    """

    imu: str = ""
    lidar: str = ""
    reference: str = REFERENCE_TOPIC


def read_messages(path: Path) -> Iterator[RawMessage]:
    """Raw messages of a recording or bag, by what ``path`` is.

    Raises:
        InputError: there is no such file, or it is of another kind.
    """
    if not path.exists():
        raise InputError("no such file", where=str(path))
    if path.is_dir() or path.suffix == ".db3":
        return read_bag(path)
    if path.suffix == ".bag":
        raise InputError(
            "a ROS 1 bag",
            where=str(path),
            remedy="`rosbags-convert --src FILE.bag --dst FOLDER` makes a ROS 2 bag",
        )
    return read_mcap(path)


def read_samples(
    path: Path,
    *,
    topics: Topics | None = None,
    unit: AccelUnit = "auto",
    say: Callable[[str], None] = print,
) -> Iterator[SensorSample]:
    """Checked samples in SI units; each scan follows the IMU readings that cover it.

    Args:
        path: a recording, a ROS 2 bag folder, or a .db3 file.
        topics: found by their types by default.
        unit: of the accelerations; found by their size by default.
        say: told what was assumed about the file.

    Raises:
        InputError: while iterating, at the first place that cannot be used.
    """
    chosen = _choose(read_messages(path), topics or Topics(), str(path))
    samples = (decode(raw) for raw in chosen)
    return scans_after_imu(in_si_units(samples, unit, str(path), say))


def _choose(
    messages: Iterator[RawMessage], topics: Topics, where: str
) -> Iterator[RawMessage]:
    """Only messages of the wanted topics; at the end, that both sensors were there."""
    wanted = {"imu": topics.imu, "lidar": topics.lidar}
    seen: set[str] = set()
    for raw in messages:
        if raw.type_name == ODOMETRY:
            if raw.topic == topics.reference:
                yield raw
            continue
        role = {IMU: "imu"}.get(raw.type_name, "lidar")
        if role == "lidar" and raw.type_name not in CLOUDS:
            continue
        given = getattr(topics, role)
        if not wanted[role]:
            wanted[role] = raw.topic
        if raw.topic == wanted[role]:
            seen.add(role)
            yield raw
        elif not given:
            raise InputError(
                f"both {wanted[role]} and {raw.topic} carry {role} data",
                where=raw.where,
                remedy=f"choose one with --{role}-topic",
            )
    for role in ("imu", "lidar"):
        if role not in seen:
            name = f" on {wanted[role]}" if wanted[role] else ""
            raise InputError(
                f"the file has no {role} data{name}",
                where=where,
                remedy="odometry needs sensor_msgs/msg/Imu, and PointCloud2 or "
                "Livox CustomMsg",
            )
