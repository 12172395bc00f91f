"""Messages of a ROS 2 bag: a folder with metadata.yaml, or one .db3 file (rosbags).

Single ``.mcap`` files go through `mcap_file`, which bounds what it reads. A folder
may be compressed; rosbags unpacks it, to a temporary folder if need be.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from openclone.errors import InputError
from openclone.odometry.mcap_file import RawMessage
from openclone.odometry.ros_types import KNOWN


def read_bag(path: Path) -> Iterator[RawMessage]:
    """Yield the messages of known types, in the order of their reception.

    Raises:
        InputError: no bag, truncated or damaged.
    """
    from rosbags.rosbag2 import Reader

    count = 0
    try:
        with Reader(path) as reader:
            wanted = [c for c in reader.connections if c.msgtype in KNOWN]
            if not wanted:
                types = _names({c.msgtype for c in reader.connections})
                raise InputError(
                    "the bag has no IMU, point cloud or odometry",
                    where=str(path),
                    remedy=f"its types: {types}",
                )
            for connection, log_ns, data in reader.messages(wanted):
                count += 1
                yield RawMessage(
                    connection.topic,
                    connection.msgtype,
                    "cdr",
                    log_ns,
                    bytes(data),
                    f"{path}, message {count} ({connection.topic})",
                )
    except InputError:
        raise
    except Exception as error:
        # rosbags, SQLite and the YAML reader raise many kinds for damaged bags.
        text = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise InputError(
            f"damaged bag: {text}",
            where=f"{path}, behind message {count}",
            remedy="a folder with metadata.yaml, or one .db3 or .mcap file is needed",
        ) from error


def _names(types: set[str]) -> str:
    shown = sorted(types)[:8]
    return ", ".join(shown) + (", …" if len(types) > len(shown) else "") or "none"
