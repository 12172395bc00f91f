"""ROS 2 message types of sensors, and how a recording names them.

Only types known here are ever decoded. Definitions inside a file are ignored: rosbags
would turn them into Python code, and a recording is input from outside.
"""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from rosbags.typesys.store import Typestore

IMU = "sensor_msgs/msg/Imu"
CLOUD = "sensor_msgs/msg/PointCloud2"
ODOMETRY = "nav_msgs/msg/Odometry"
LIVOX_CLOUDS = (
    "livox_ros_driver2/msg/CustomMsg",
    "livox_ros_driver/msg/CustomMsg",
    "livox_interfaces/msg/CustomMsg",
)
CLOUDS = (CLOUD, *LIVOX_CLOUDS)
KNOWN = (IMU, ODOMETRY, *CLOUDS)

IMU_TOPIC = "/livox/imu"
LIDAR_TOPIC = "/livox/lidar"
REFERENCE_TOPIC = "/ground_truth"
"""Topics of our own recordings; the first two are the Livox driver's."""

LIVOX_POINT = """uint32 offset_time
float32 x
float32 y
float32 z
uint8 reflectivity
uint8 tag
uint8 line
"""
LIVOX_MESSAGE = """std_msgs/Header header
uint64 timebase
uint32 point_num
uint8 lidar_id
uint8[3] rsvd
CustomPoint[] points
"""
"""The Livox driver's interface: its field names and order are the wire format."""


@cache
def type_store() -> Typestore:
    """ROS 2 types of the Humble release, with Livox's."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_HUMBLE)
    for name in LIVOX_CLOUDS:
        package = name.partition("/")[0]
        store.register(
            {
                **get_types_from_msg(LIVOX_POINT, f"{package}/msg/CustomPoint"),
                **get_types_from_msg(LIVOX_MESSAGE, name),
            }
        )
    return store
