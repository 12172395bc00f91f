"""Samples become ROS 2 messages that any ROS tool opens."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from openclone.errors import InputError
from openclone.odometry.ros_types import CLOUD, IMU, ODOMETRY, type_store
from openclone.odometry.samples import ImuSample, LidarScan, SensorSample

if TYPE_CHECKING:
    from openclone.odometry.samples import PoseSample

POINT_DTYPE = np.dtype([("xyz", "<f4", 3), ("t", "<u4")])
"""One recorded point: metres, and nanoseconds since the header's stamp."""

_FLOAT32, _UINT32 = 7, 6
_UNKNOWN = np.zeros(9)
_WORLD, _IMU, _LIDAR = "world", "imu", "lidar"


def encode(sample: SensorSample) -> tuple[str, int, bytes]:
    """Serialize ``sample``: its ROS type, its header stamp in ns, and the CDR bytes.

    Raises:
        InputError: stamps that the message cannot hold.
    """
    if isinstance(sample, ImuSample):
        kind, stamp_ns = IMU, sample.stamp_ns
        message = _imu(sample)
    elif isinstance(sample, LidarScan):
        kind, stamp_ns = CLOUD, int(sample.stamps_ns.min())
        message = _cloud(sample, stamp_ns)
    else:
        kind, stamp_ns = ODOMETRY, sample.stamp_ns
        message = _odometry(sample)
    return kind, stamp_ns, bytes(type_store().serialize_cdr(message, kind))


def _types() -> Any:
    """The message classes, by their ROS names; they are made at run time."""
    return type_store().types


def _header(stamp_ns: int, frame: str) -> Any:
    sec, nanosec = divmod(stamp_ns, 1_000_000_000)
    if not 0 <= sec < 2**31:
        raise InputError(
            f"stamp {stamp_ns} ns does not fit a ROS message",
            remedy="stamps from 0 to 2038 can be recorded",
        )
    time = _types()["builtin_interfaces/msg/Time"](sec=sec, nanosec=nanosec)
    return _types()["std_msgs/msg/Header"](stamp=time, frame_id=frame)


def _vector(values: np.ndarray, kind: str = "Vector3") -> Any:
    x, y, z = (float(value) for value in values)
    return _types()[f"geometry_msgs/msg/{kind}"](x=x, y=y, z=z)


def _quaternion(wxyz: np.ndarray) -> Any:
    w, x, y, z = (float(value) for value in wxyz)
    return _types()["geometry_msgs/msg/Quaternion"](x=x, y=y, z=z, w=w)


def _imu(sample: ImuSample) -> Any:
    # REP-145: -1 in the first covariance says that there is no orientation.
    no_orientation = np.array([-1.0] + [0.0] * 8)
    return _types()[IMU](
        header=_header(sample.stamp_ns, _IMU),
        orientation=_quaternion(np.array([1.0, 0.0, 0.0, 0.0])),
        orientation_covariance=no_orientation,
        angular_velocity=_vector(sample.gyro),
        angular_velocity_covariance=_UNKNOWN,
        linear_acceleration=_vector(sample.accel),
        linear_acceleration_covariance=_UNKNOWN,
    )


def _cloud(scan: LidarScan, base_ns: int) -> Any:
    points = np.empty(len(scan.points), POINT_DTYPE)
    points["xyz"] = scan.points
    points["t"] = scan.stamps_ns - base_ns
    make = _types()["sensor_msgs/msg/PointField"]
    fields = [
        make(name=name, offset=offset, datatype=kind, count=1)
        for name, offset, kind in (
            ("x", 0, _FLOAT32),
            ("y", 4, _FLOAT32),
            ("z", 8, _FLOAT32),
            ("t", 12, _UINT32),
        )
    ]
    return _types()[CLOUD](
        header=_header(base_ns, _LIDAR),
        height=1,
        width=len(points),
        fields=fields,
        is_bigendian=False,
        point_step=POINT_DTYPE.itemsize,
        row_step=points.nbytes,
        data=points.view(np.uint8),
        is_dense=bool(np.isfinite(scan.points).all()),
    )


def _odometry(sample: PoseSample) -> Any:
    still = _vector(np.zeros(3))
    pose = _types()["geometry_msgs/msg/Pose"](
        position=_vector(sample.position, "Point"),
        orientation=_quaternion(sample.quat),
    )
    twist = _types()["geometry_msgs/msg/Twist"](linear=still, angular=still)
    unknown = np.zeros(36)
    return _types()[ODOMETRY](
        header=_header(sample.stamp_ns, _WORLD),
        child_frame_id=_IMU,
        pose=_types()["geometry_msgs/msg/PoseWithCovariance"](
            pose=pose, covariance=unknown
        ),
        twist=_types()["geometry_msgs/msg/TwistWithCovariance"](
            twist=twist, covariance=unknown
        ),
    )
