"""Recordings keep every number, and foreign tools can open them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from rosbags.rosbag2 import Reader
from rosbags.typesys import Stores, get_typestore

from openclone.errors import InputError
from openclone.odometry.recording import SensorRecorder, Topics, read_samples
from openclone.odometry.samples import (
    GRAVITY,
    ImuSample,
    LidarScan,
    PoseSample,
    SensorSample,
    in_si_units,
    scans_after_imu,
    stamp_of,
)
from room_stream import RoomStreamConfig, room_stream

EPOCH_NS = 1_700_000_000_123_456_789


def small_stream(seconds: float = 1.0) -> list[SensorSample]:
    config = RoomStreamConfig(seconds=seconds, points=200, start_ns=EPOCH_NS)
    return list(room_stream(config))


def record(samples: list[SensorSample], path: Path) -> Path:
    with SensorRecorder(path) as recorder:
        for sample in samples:
            recorder.write(sample)
    return path


def imu(stamp_ns: int, accel: tuple[float, float, float]) -> ImuSample:
    return ImuSample(stamp_ns, np.zeros(3), np.array(accel))


def test_everything_written_comes_back(tmp_path: Path) -> None:
    samples = small_stream()
    back = list(read_samples(record(samples, tmp_path / "a.mcap"), say=pytest.fail))
    assert [type(s) for s in back] == [type(s) for s in samples]
    for before, after in zip(samples, back, strict=True):
        assert stamp_of(after) == stamp_of(before)
        if isinstance(before, LidarScan):
            assert isinstance(after, LidarScan)
            np.testing.assert_array_equal(after.points, before.points)
            np.testing.assert_array_equal(after.stamps_ns, before.stamps_ns)
        elif isinstance(before, ImuSample):
            assert isinstance(after, ImuSample)
            np.testing.assert_array_equal(after.gyro, before.gyro)
            np.testing.assert_array_equal(after.accel, before.accel)
        elif isinstance(before, PoseSample):
            assert isinstance(after, PoseSample)
            np.testing.assert_array_equal(after.position, before.position)
            np.testing.assert_array_equal(after.quat, before.quat)


def test_rosbags_and_mcap_open_a_recording(tmp_path: Path) -> None:
    """Two foreign readers, with the types of the file and not with ours."""
    samples = small_stream()
    path = record(samples, tmp_path / "a.mcap")
    scans = [s for s in samples if isinstance(s, LidarScan)]
    types = get_typestore(Stores.ROS2_JAZZY)
    with Reader(path) as reader:
        kinds = {c.topic: c.msgtype for c in reader.connections}
        assert kinds == {
            "/livox/imu": "sensor_msgs/msg/Imu",
            "/livox/lidar": "sensor_msgs/msg/PointCloud2",
            "/ground_truth": "nav_msgs/msg/Odometry",
        }
        wanted = [c for c in reader.connections if c.topic == "/livox/lidar"]
        clouds = [
            types.deserialize_cdr(data, c.msgtype)
            for c, _, data in reader.messages(wanted)
        ]
    assert len(clouds) == len(scans)
    cloud, scan = clouds[3], scans[3]
    assert (cloud.width, cloud.height, cloud.point_step) == (200, 1, 16)
    assert [(f.name, f.offset) for f in cloud.fields] == [
        ("x", 0), ("y", 4), ("z", 8), ("t", 12),
    ]  # fmt: skip
    floats = cloud.data.view("<f4").reshape(-1, 4)[:, :3]
    np.testing.assert_array_equal(floats, scan.points)
    base = cloud.header.stamp.sec * 10**9 + cloud.header.stamp.nanosec
    nanoseconds = cloud.data.view("<u4").reshape(-1, 4)[:, 3].astype(np.int64)
    np.testing.assert_array_equal(base + nanoseconds, scan.stamps_ns)
    with path.open("rb") as file:
        summary = make_reader(file, validate_crcs=True).get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert summary.statistics.message_count == len(samples)
    schemas = {s.name: s for s in summary.schemas.values()}
    assert {s.encoding for s in schemas.values()} == {"ros2msg"}
    # Foxglove needs the definitions of nested types in the schema.
    assert b"MSG: sensor_msgs/PointField" in schemas["sensor_msgs/msg/PointCloud2"].data


def test_a_damaged_tail_does_not_cost_the_beginning(tmp_path: Path) -> None:
    samples = small_stream(3.0) * 8
    # Noise hardly compresses, so the file has several chunks.
    whole = record(samples, tmp_path / "a.mcap").read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole[: len(whole) * 3 // 4])
    got: list[SensorSample] = []
    # list.extend keeps what came before the error.
    with pytest.raises(InputError, match=r"cut\.mcap, byte \d+: .*truncated") as caught:
        got.extend(read_samples(cut))
    assert "\n" not in str(caught.value)
    assert len(samples) / 2 < len(got) < len(samples)


def test_scans_wait_for_the_imu() -> None:
    scan = LidarScan(np.ones((2, 3), np.float32), np.array([100, 200]))
    stream = [imu(50, (0, 0, 9.8)), scan, imu(150, (0, 0, 9.8)), imu(205, (0, 0, 9.8))]
    order = [type(s).__name__ for s in scans_after_imu(stream)]
    assert order == ["ImuSample", "ImuSample", "ImuSample", "LidarScan"]


def test_a_dead_imu_does_not_stop_the_scans() -> None:
    scans = [
        LidarScan(np.ones((1, 3), np.float32), np.array([n * 10**8])) for n in range(40)
    ]
    stream = scans_after_imu(scans)
    passed = [next(stream) for _ in range(25)]
    assert [stamp_of(s) for s in passed] == [n * 10**8 for n in range(25)]


@pytest.mark.parametrize("tilt", [0.0, 1.0, np.pi])
def test_g_is_detected_and_said(tilt: float) -> None:
    said: list[str] = []
    rng = np.random.default_rng(0)
    up = np.array([np.sin(tilt), 0.0, np.cos(tilt)])
    stream = [
        ImuSample(n, np.zeros(3), up + 0.2 * rng.standard_normal(3)) for n in range(300)
    ]
    back = list(in_si_units(stream, "auto", "x.mcap", said.append))
    assert len(back) == 300
    assert said == ["x.mcap: acceleration is in g, converted to m/s²"]
    mean = np.mean([s.accel for s in back if isinstance(s, ImuSample)], axis=0)
    np.testing.assert_allclose(mean, GRAVITY * up, atol=0.5)


def test_metres_stay_and_nothing_is_said() -> None:
    stream = [imu(n, (0.0, 6.0, 7.7)) for n in range(150)]
    back = list(in_si_units(stream, "auto", "x", pytest.fail))
    assert all(s is t for s, t in zip(stream, back, strict=True))


def test_a_third_unit_is_refused() -> None:
    stream = [imu(n, (0.0, 0.0, 981.0)) for n in range(150)]
    with pytest.raises(InputError, match=r"median of 981.*--imu-unit"):
        list(in_si_units(stream, "auto", "x", print))
    assert len(list(in_si_units(stream, "m/s2", "x", print))) == 150


def test_a_topic_that_is_not_there(tmp_path: Path) -> None:
    samples = small_stream(0.5)
    path = record(samples, tmp_path / "a.mcap")
    assert list(read_samples(path, topics=Topics(lidar="/livox/lidar")))
    with pytest.raises(InputError, match=r"no lidar data on /other"):
        list(read_samples(path, topics=Topics(lidar="/other")))


def test_stamps_that_ros_cannot_hold_are_refused(tmp_path: Path) -> None:
    with (
        SensorRecorder(tmp_path / "a.mcap") as recorder,
        pytest.raises(InputError, match="2038"),
    ):
        recorder.write(imu(-5, (0, 0, 9.8)))


def test_other_files_are_refused(tmp_path: Path) -> None:
    for name, content, message in (
        ("a.mcap", b"hello world, no mcap", "not an MCAP file"),
        ("a.mcap", b"", "not an MCAP file"),
        ("a.bag", b"#ROSBAG V2.0\n", "ROS 1 bag"),
    ):
        path = tmp_path / name
        path.write_bytes(content)
        with pytest.raises(InputError, match=message):
            list(read_samples(path))
    with pytest.raises(InputError, match="no such file"):
        list(read_samples(tmp_path / "absent.mcap"))
