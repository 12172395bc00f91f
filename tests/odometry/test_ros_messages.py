"""ROS 2 bags: Livox CustomMsg, PointCloud2 of several drivers, Imu in g."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer

from openclone.errors import InputError
from openclone.odometry.mcap_file import RawMessage
from openclone.odometry.recording import Topics, read_samples
from openclone.odometry.ros_decode import decode, point_stamps_ns
from openclone.odometry.ros_encode import encode
from openclone.odometry.ros_types import CLOUD, IMU, LIVOX_CLOUDS, type_store
from openclone.odometry.samples import GRAVITY, ImuSample, LidarScan

STAMP_NS = 1_700_000_000_100_000_000
STORE = type_store()
FLOAT32, FLOAT64, UINT32, UINT8 = 7, 8, 6, 2


def header(stamp_ns: int, frame: str = "livox_frame") -> Any:
    sec, nanosec = divmod(stamp_ns, 10**9)
    time = STORE.types["builtin_interfaces/msg/Time"](sec=sec, nanosec=nanosec)
    return STORE.types["std_msgs/msg/Header"](stamp=time, frame_id=frame)


def raw(message: Any, kind: str, topic: str = "/x") -> RawMessage:
    data = bytes(STORE.serialize_cdr(message, kind))
    return RawMessage(topic, kind, "cdr", STAMP_NS, data, "file, place")


def livox(points: np.ndarray, offsets: np.ndarray, kind: str, frame: str = "f") -> Any:
    point = STORE.types[kind.partition("/")[0] + "/msg/CustomPoint"]
    return STORE.types[kind](
        header=header(STAMP_NS, frame),
        timebase=STAMP_NS,
        point_num=len(points),
        lidar_id=1,
        rsvd=np.zeros(3, np.uint8),
        points=[
            point(offset_time=int(t), x=x, y=y, z=z, reflectivity=9, tag=16, line=2)
            for (x, y, z), t in zip(points.tolist(), offsets, strict=True)
        ],
    )


def cloud(
    fields: list[tuple[str, int]], rows: np.ndarray, *, dense: bool = True
) -> Any:
    """A PointCloud2 from a structured array whose fields have ROS types."""
    make = STORE.types["sensor_msgs/msg/PointField"]
    assert rows.dtype.fields is not None
    return STORE.types[CLOUD](
        header=header(STAMP_NS),
        height=1,
        width=len(rows),
        fields=[
            make(name=name, offset=rows.dtype.fields[name][1], datatype=kind, count=1)
            for name, kind in fields
        ],
        is_bigendian=False,
        point_step=rows.dtype.itemsize,
        row_step=rows.nbytes,
        data=np.frombuffer(rows.tobytes(), np.uint8),
        is_dense=dense,
    )


@pytest.mark.parametrize("kind", LIVOX_CLOUDS)
@pytest.mark.parametrize("frame", ["", "a", "ab", "livox", "livox_frame_7"])
def test_livox_message_against_the_serializer_of_rosbags(kind: str, frame: str) -> None:
    """Our array reader and rosbags agree, however the name shifts the alignment."""
    rng = np.random.default_rng(len(frame))
    points = rng.uniform(-9, 9, (7, 3)).astype(np.float32)
    offsets = np.sort(rng.integers(0, 10**8, 7))
    scan = decode(raw(livox(points, offsets, kind, frame), kind))
    assert isinstance(scan, LidarScan)
    np.testing.assert_array_equal(scan.points, points)
    np.testing.assert_array_equal(scan.stamps_ns, STAMP_NS + offsets)


def test_livox_count_beyond_the_message_is_refused() -> None:
    kind = LIVOX_CLOUDS[0]
    message = raw(livox(np.ones((3, 3)), np.arange(3), kind), kind)
    for count in (4, 2**31, 2**32 - 1):
        data = message.data.replace(b"\x03\0\0\0", count.to_bytes(4, "little"))
        wrong = RawMessage("/x", kind, "cdr", 0, data, "file, place")
        with pytest.raises(InputError, match=r"file, place: .*points"):
            decode(wrong)


def xyz_rows(time_type: str, times: np.ndarray) -> np.ndarray:
    layout = [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("i", "u1"), ("t", time_type)]
    rows = np.zeros(len(times), layout)
    rows["x"], rows["t"] = np.arange(len(times)), times
    return rows


@pytest.mark.parametrize(
    ("name", "kind", "time_type", "times", "exact_ns"),
    [
        ("t", UINT32, "<u4", [0, 5, 99_999_995], 0),
        ("time", FLOAT32, "<f4", [0.0, 5e-9, 0.099999995], 4),
        ("timestamp", FLOAT64, "<f8", [STAMP_NS, STAMP_NS + 512, STAMP_NS + 1e8], 0),
        ("timestamp", FLOAT64, "<f8", [1.7e9 + 0.1, 1.7e9 + 0.15, 1.7e9 + 0.2], 200),
    ],
)
def test_times_of_four_drivers(
    name: str, kind: int, time_type: str, times: list[float], exact_ns: int
) -> None:
    rows = xyz_rows(time_type, np.array(times))
    renamed = rows.view(
        [("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("i", "u1"), (name, time_type)]
    )
    message = cloud(
        [("x", FLOAT32), ("y", FLOAT32), ("z", FLOAT32), (name, kind)], renamed
    )
    scan = decode(raw(message, CLOUD))
    assert isinstance(scan, LidarScan)
    expected = {
        "t": [0, 5, 99_999_995],
        "time": [0, 5, 99_999_995],
        "timestamp": [0, 512, 10**8] if times[0] > 1e12 else [0, 50_000_000, 10**8],
    }[name]
    error = np.abs(scan.stamps_ns - STAMP_NS - np.array(expected))
    assert error.max() <= exact_ns
    np.testing.assert_array_equal(scan.points[:, 0], [0, 1, 2])


def test_impossible_times_are_refused() -> None:
    for times in ([np.nan], [-1.0], [np.inf], [1e30]):
        with pytest.raises(InputError, match="no time"):
            point_stamps_ns(np.array(times), STAMP_NS, "f")


def test_a_cloud_without_times_says_what_it_has() -> None:
    rows = np.zeros(2, [("x", "<f4"), ("y", "<f4"), ("z", "<f4")])
    message = cloud([(n, FLOAT32) for n in "xyz"], rows)
    with pytest.raises(InputError, match=r"no time per point, only x, y, z"):
        decode(raw(message, CLOUD))


def test_nan_points_by_the_promise_of_the_cloud() -> None:
    rows = xyz_rows("<u4", np.arange(3))
    rows["y"][1] = np.nan
    fields = [("x", FLOAT32), ("y", FLOAT32), ("z", FLOAT32), ("t", UINT32)]
    with pytest.raises(InputError, match=r"point 1 of the scan .*nan"):
        decode(raw(cloud(fields, rows), CLOUD))
    scan = decode(raw(cloud(fields, rows, dense=False), CLOUD))
    assert isinstance(scan, LidarScan)
    np.testing.assert_array_equal(scan.points[:, 0], [0, 0, 2])


def test_cloud_smaller_than_it_says() -> None:
    message = cloud(
        [("x", FLOAT32), ("y", FLOAT32), ("z", FLOAT32), ("t", UINT32)],
        xyz_rows("<u4", np.arange(3)),
    )
    message.width = 1000
    with pytest.raises(InputError, match="1000 points announced"):
        decode(raw(message, CLOUD))
    message.width, message.point_step = 3, 12
    with pytest.raises(InputError, match="outside of its point"):
        decode(raw(message, CLOUD))


def test_nan_in_the_imu_is_refused() -> None:
    sample = ImuSample(5, np.array([0.0, np.nan, 0.0]), np.array([0.0, 0.0, 9.81]))
    _, _, data = encode(sample)
    with pytest.raises(InputError, match=r"file, 7: angular velocity .*nan"):
        decode(RawMessage("/imu", IMU, "cdr", 0, data, "file, 7"))


def write_bag(folder: Path, plugin: StoragePlugin, lidars: int = 1) -> Path:
    """A bag as the Livox driver's user records it: CustomMsg, and Imu in g."""
    kind = LIVOX_CLOUDS[0]
    with Writer(folder, version=9, storage_plugin=plugin) as writer:
        imu = writer.add_connection("/livox/imu", IMU, typestore=STORE)
        clouds = [
            writer.add_connection(f"/livox/lidar{n or ''}", kind, typestore=STORE)
            for n in range(lidars)
        ]
        camera = writer.add_connection("/hello", "std_msgs/msg/String", typestore=STORE)
        text = STORE.types["std_msgs/msg/String"](data="hi")
        writer.write(camera, STAMP_NS, STORE.serialize_cdr(text, camera.msgtype))
        for n in range(120):
            stamp_ns = STAMP_NS + n * 5_000_000
            sample = ImuSample(stamp_ns, np.full(3, 0.1), np.array([0.0, 0.6, -0.8]))
            writer.write(imu, stamp_ns, encode(sample)[2])
        for n, connection in enumerate(clouds):
            message = livox(np.ones((4, 3)), np.arange(4), kind)
            data = STORE.serialize_cdr(message, kind)
            writer.write(connection, STAMP_NS + n, data)
    return folder


@pytest.mark.parametrize("plugin", list(StoragePlugin))
def test_ros2_bags_in_both_storages(tmp_path: Path, plugin: StoragePlugin) -> None:
    folder = write_bag(tmp_path / "bag", plugin)
    storage = next(p for p in folder.iterdir() if p.suffix in (".db3", ".mcap"))
    for path in (folder, storage):
        said: list[str] = []
        samples = list(read_samples(path, say=said.append))
        assert len(said) == 1
        assert "in g" in said[0]
        readings = [s for s in samples if isinstance(s, ImuSample)]
        assert len(readings) == 120
        np.testing.assert_allclose(
            readings[-1].accel, [0.0, 0.6 * GRAVITY, -0.8 * GRAVITY]
        )
        assert sum(isinstance(s, LidarScan) for s in samples) == 1


def test_two_lidars_in_one_bag_need_a_choice(tmp_path: Path) -> None:
    folder = write_bag(tmp_path / "bag", StoragePlugin.SQLITE3, lidars=2)
    with pytest.raises(InputError, match=r"/livox/lidar and /livox/lidar1.*--lidar-"):
        list(read_samples(folder))
    chosen = Topics(lidar="/livox/lidar1")
    assert list(read_samples(folder, topics=chosen, say=lambda text: None))


def test_a_bag_without_sensors(tmp_path: Path) -> None:
    with Writer(tmp_path / "bag", version=9) as writer:
        kind = "std_msgs/msg/String"
        connection = writer.add_connection("/hello", kind, typestore=STORE)
        text = STORE.types[kind](data="hi")
        writer.write(connection, 5, STORE.serialize_cdr(text, kind))
    with pytest.raises(InputError, match=r"no IMU.*std_msgs/msg/String"):
        list(read_samples(tmp_path / "bag"))
