"""ROS 2 sensor messages become samples; every convention of a driver ends here."""

from __future__ import annotations

import struct
from typing import Any

import numpy as np

from openclone.errors import InputError
from openclone.odometry.mcap_file import RawMessage
from openclone.odometry.ros_types import IMU, LIVOX_CLOUDS, ODOMETRY, type_store
from openclone.odometry.samples import (
    ImuSample,
    LidarScan,
    PoseSample,
    SensorSample,
    check_sample,
)

TIME_FIELDS = ("t", "offset_time", "time", "timestamp", "time_stamp")
"""Per-point time: Ouster and our recordings, Livox, Velodyne, Livox and Hesai."""

# sensor_msgs/msg/PointField constants
_FIELD_TYPES = ("i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8")
_LIVOX_POINT_BYTES = 20
_MAX_POINTS = 2_000_000


def decode(raw: RawMessage) -> SensorSample:
    """The sample in one message, checked.

    Raises:
        InputError: not CDR, damaged, without per-point time, or with values that no
            sensor measures.
    """
    if raw.encoding != "cdr":
        raise InputError(
            f"messages encoded as {raw.encoding!r}",
            where=raw.where,
            remedy="ROS 2's cdr is needed",
        )
    try:
        if raw.type_name in LIVOX_CLOUDS:
            sample: SensorSample = _livox_scan(raw)
        else:
            message = type_store().deserialize_cdr(raw.data, raw.type_name)
            if raw.type_name == IMU:
                sample = _imu(message)
            elif raw.type_name == ODOMETRY:
                sample = _pose(message)
            else:
                sample = _cloud_scan(message, raw)
    except InputError:
        raise
    except Exception as error:
        # rosbags' generated readers raise whatever the bytes provoke.
        raise InputError(
            f"damaged {raw.type_name} ({error or type(error).__name__})",
            where=raw.where,
        ) from error
    check_sample(sample, raw.where)
    return sample


def _stamp_ns(header: Any) -> int:
    return int(header.stamp.sec) * 1_000_000_000 + int(header.stamp.nanosec)


def _imu(message: Any) -> ImuSample:
    gyro, accel = message.angular_velocity, message.linear_acceleration
    return ImuSample(
        _stamp_ns(message.header),
        np.array([gyro.x, gyro.y, gyro.z]),
        np.array([accel.x, accel.y, accel.z]),
    )


def _pose(message: Any) -> PoseSample:
    pose = message.pose.pose
    at, turn = pose.position, pose.orientation
    return PoseSample(
        _stamp_ns(message.header),
        np.array([at.x, at.y, at.z]),
        np.array([turn.w, turn.x, turn.y, turn.z]),
    )


def _livox_scan(raw: RawMessage) -> LidarScan:
    """A Livox ``CustomMsg``, read as one array: 20 000 objects would take 50 ms.

    The points' offsets count from the header's stamp, which the IMU shares.
    """
    data = raw.data
    if len(data) < 4 or data[0] != 0 or data[1] not in (0, 1):
        raise ValueError("no CDR header")
    order = "<" if data[1] == 1 else ">"
    sec, nanosec, name_bytes = struct.unpack_from(order + "iII", data, 4)
    # CDR aligns each value to its size, counted from behind the 4-byte header.
    cursor = 12 + name_bytes
    cursor += -cursor % 8 + 8  # timebase
    cursor += 4 + 4  # point_num, lidar_id with rsvd
    (count,) = struct.unpack_from(order + "I", data, 4 + cursor)
    if count > _MAX_POINTS:
        raise ValueError(f"{count} points in one message")
    begin = 4 + cursor + 4
    # The last point lacks the padding byte that aligns its successor.
    end = begin + max(count * _LIVOX_POINT_BYTES - 1, 0)
    if end > len(data):
        raise ValueError(f"{count} points announced, {len(data) - begin} bytes there")
    layout = np.dtype(
        {
            "names": ["offset", "xyz"],
            "formats": [order + "u4", (order + "f4", 3)],
            "offsets": [0, 4],
            "itemsize": _LIVOX_POINT_BYTES,
        }
    )
    points = np.frombuffer(data[begin:end] + b"\0", layout, count)
    stamps_ns = sec * 1_000_000_000 + nanosec + points["offset"].astype(np.int64)
    return LidarScan(points["xyz"].astype(np.float32), stamps_ns)


def _cloud_scan(message: Any, raw: RawMessage) -> LidarScan:
    layout, time_name = _cloud_layout(message, raw.where)
    count = int(message.width) * int(message.height)
    if count > _MAX_POINTS:
        raise ValueError(f"{count} points in one message")
    if len(message.data) < count * message.point_step:
        raise ValueError(f"{count} points announced, {len(message.data)} bytes there")
    if message.height > 1 and message.row_step != message.width * message.point_step:
        raise ValueError("rows with padding")
    points = np.frombuffer(message.data.tobytes(), layout, count)
    xyz = np.stack([points[axis] for axis in "xyz"], axis=1).astype(np.float32)
    if not message.is_dense:
        # Such clouds mark "no return" by NaN; we mark it by zeros, as Livox does.
        xyz[~np.isfinite(xyz).all(axis=1)] = 0.0
    times = points[time_name]
    return LidarScan(xyz, point_stamps_ns(times, _stamp_ns(message.header), raw.where))


def _cloud_layout(message: Any, where: str) -> tuple[np.dtype, str]:
    """The NumPy type of one point and the name of its time field."""
    order = ">" if message.is_bigendian else "<"
    fields = {}
    for field in message.fields:
        if not 1 <= field.datatype <= len(_FIELD_TYPES):
            raise ValueError(f"field {field.name!r} of the unknown type")
        kind = np.dtype(order + _FIELD_TYPES[field.datatype - 1])
        if field.offset + kind.itemsize > message.point_step:
            raise ValueError(f"field {field.name!r} outside of its point")
        fields[field.name] = (kind, field.offset)
    if missing := {"x", "y", "z"} - fields.keys():
        raise ValueError(f"a cloud without {', '.join(sorted(missing))}")
    time_name = next((name for name in TIME_FIELDS if name in fields), None)
    if time_name is None:
        raise InputError(
            f"the cloud has no time per point, only {', '.join(fields)}",
            where=where,
            remedy=f"record with a driver that fills one of {', '.join(TIME_FIELDS)}",
        )
    wanted = ["x", "y", "z", time_name]
    layout = np.dtype(
        {
            "names": wanted,
            "formats": [fields[name][0] for name in wanted],
            "offsets": [fields[name][1] for name in wanted],
            "itemsize": int(message.point_step),
        }
    )
    return layout, time_name


def point_stamps_ns(times: np.ndarray, header_ns: int, where: str) -> np.ndarray:
    """Absolute stamps (N,) int64, ns, from whatever a driver wrote.

    Integers are nanoseconds. Floating-point numbers are seconds, or nanoseconds when
    they exceed any possible second. Small values count from the header's stamp, large
    ones from the epoch; no scan lasts so long that the two could be confused.

    Raises:
        InputError: NaN, negative or impossible times.
    """
    if not len(times):
        return np.zeros(0, np.int64)
    if not np.isfinite(times).all() or times.min() < 0 or times.max() > 4e18:
        raise InputError("the time of a point is no time", where=where)
    largest = float(times.max())
    if times.dtype.kind in "iu":
        offsets = times.astype(np.int64)
        return offsets if largest > 1e15 else header_ns + offsets
    if largest > 1e15:  # nanoseconds since the epoch
        return times.astype(np.int64)
    if largest > 1e6:  # seconds since the epoch
        # In double precision a second of today is good to 0.2 µs, no more.
        return np.round(times.astype(np.float64) * 1e9).astype(np.int64)
    return header_ns + np.round(times.astype(np.float64) * 1e9).astype(np.int64)
