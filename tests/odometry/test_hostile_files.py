"""Files from outside: truncated, flipped and forged ones end in one-line errors."""

from __future__ import annotations

import resource
import time
import zlib
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest
import zstandard
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag2 import StoragePlugin, Writer

from openclone.errors import InputError
from openclone.odometry.mcap_file import MAGIC, MAX_RECORD_BYTES
from openclone.odometry.recording import SensorRecorder, read_samples
from openclone.odometry.ros_encode import encode
from openclone.odometry.ros_types import type_store
from openclone.odometry.samples import (
    ImuSample,
    LidarScan,
    PoseSample,
    SensorSample,
    check_sample,
)
from openclone.odometry.trajectory import read_tum
from room_stream import RoomStreamConfig, room_stream

TOPICS = {ImuSample: "/livox/imu", LidarScan: "/livox/lidar", PoseSample: "/truth"}
BUDGET_S = 20.0


@pytest.fixture(scope="module")
def samples() -> list[SensorSample]:
    return list(room_stream(RoomStreamConfig(seconds=0.3, points=30)))


@pytest.fixture(scope="module")
def recording(
    samples: list[SensorSample], tmp_path_factory: pytest.TempPathFactory
) -> bytes:
    path = tmp_path_factory.mktemp("a") / "a.mcap"
    with SensorRecorder(path) as recorder:
        for sample in samples:
            recorder.write(sample)
    return path.read_bytes()


@pytest.fixture(scope="module")
def bare_recording(samples: list[SensorSample]) -> bytes:
    """Without chunks and checksums: every flip reaches the message decoders."""
    stream = BytesIO()
    writer = McapWriter(
        stream,
        use_chunking=False,
        compression=CompressionType.NONE,
        enable_crcs=False,
    )
    writer.start("ros2")
    channels = {}
    for sample in samples:
        kind, stamp_ns, data = encode(sample)
        if kind not in channels:
            schema = writer.register_schema(kind, "ros2msg", b"")
            topic = TOPICS[type(sample)]
            channels[kind] = writer.register_channel(topic, "cdr", schema)
        writer.add_message(channels[kind], stamp_ns, data, stamp_ns)
    writer.finish()
    return stream.getvalue()


def read(path: Path) -> tuple[list[SensorSample], InputError | None]:
    """What a file gives, and the error it ends in; any other error fails the test."""
    got: list[SensorSample] = []
    error = None
    try:
        got.extend(read_samples(path, say=lambda text: None))
    except InputError as caught:
        error = caught
    if error is not None:
        assert "\n" not in str(error)
        assert len(str(error)) < 600
        assert path.name in str(error)
    for sample in got:
        check_sample(sample, "test")
    return got, error


def flipped(data: bytes, rng: np.random.Generator, most: int = 4) -> bytes:
    """``data`` with one to ``most`` random bytes replaced."""
    damaged = bytearray(data)
    for place in rng.integers(0, len(data), rng.integers(1, most + 1)):
        damaged[place] = rng.integers(256)
    return bytes(damaged)


def test_truncation_anywhere_is_an_error(recording: bytes, tmp_path: Path) -> None:
    path, size = tmp_path / "cut.mcap", len(recording)
    rng = np.random.default_rng(0)
    ends = {*range(60), *range(size - 60, size), *rng.integers(0, size, 80).tolist()}
    begin = time.process_time()
    for end in sorted(ends):
        path.write_bytes(recording[:end])
        _, error = read(path)
        assert error is not None, f"cut at {end} of {size} was not noticed"
    assert time.process_time() - begin < BUDGET_S


def test_flips_in_a_recording(
    recording: bytes, samples: list[SensorSample], tmp_path: Path
) -> None:
    """Checksums: a flip is either refused or outside of the data."""
    path, rng = tmp_path / "flip.mcap", np.random.default_rng(1)
    begin = time.process_time()
    refused = 0
    for _ in range(100):
        path.write_bytes(flipped(recording, rng))
        got, error = read(path)
        refused += error is not None
        if error is None:
            assert len(got) == len(samples)
    assert refused > 50
    assert time.process_time() - begin < BUDGET_S


def test_flips_without_checksums(bare_recording: bytes, tmp_path: Path) -> None:
    path, rng = tmp_path / "flip.mcap", np.random.default_rng(2)
    begin = time.process_time()
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    errors = [read_flipped(bare_recording, path, rng) for _ in range(150)]
    assert sum(errors) > 10
    assert time.process_time() - begin < BUDGET_S
    # kB: no size in a file may be believed before it is checked.
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - peak < 300_000


def read_flipped(data: bytes, path: Path, rng: np.random.Generator) -> bool:
    path.write_bytes(flipped(data, rng, most=60))
    return read(path)[1] is not None


def test_damaged_sqlite_bags(samples: list[SensorSample], tmp_path: Path) -> None:
    bag = tmp_path / "bag"
    with Writer(bag, version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connections = {}
        for sample in samples[:100]:
            kind, stamp_ns, data = encode(sample)
            if kind not in connections:
                connections[kind] = writer.add_connection(
                    TOPICS[type(sample)], kind, typestore=type_store()
                )
            writer.write(connections[kind], stamp_ns, data)
    path = next(bag.glob("*.db3"))
    whole, rng = path.read_bytes(), np.random.default_rng(3)
    begin = time.process_time()
    for count in range(60):
        end = int(rng.integers(0, len(whole)))
        path.write_bytes(whole[:end] if count % 2 else flipped(whole, rng))
        read(bag if count % 3 else path)
    path.write_bytes(whole)
    metadata = bag / "metadata.yaml"
    text = metadata.read_bytes()
    for _ in range(25):
        metadata.write_bytes(flipped(text, rng))
        read(bag)
    metadata.write_bytes(text)
    assert read(bag)[1] is None
    assert time.process_time() - begin < BUDGET_S


def chunk(content: bytes, claimed: int, compression: bytes, data: bytes) -> bytes:
    """A forged MCAP file with one chunk."""
    body = (0).to_bytes(16, "little") + claimed.to_bytes(8, "little")
    body += zlib.crc32(content).to_bytes(4, "little")
    body += len(compression).to_bytes(4, "little") + compression
    body += len(data).to_bytes(8, "little") + data
    return MAGIC + b"\x06" + len(body).to_bytes(8, "little") + body


@pytest.mark.parametrize("claimed", [0, 100, 10**9, 2**63])
@pytest.mark.parametrize("known", [True, False])
def test_bombs_are_not_unpacked(tmp_path: Path, claimed: int, known: bool) -> None:
    """200 MB of zeros in a few kilobytes, with and without the size in the frame."""
    packer = zstandard.ZstdCompressor().compressobj(size=200_000_000 if known else -1)
    block = bytes(1_000_000)
    bomb = b"".join(packer.compress(block) for _ in range(200)) + packer.flush()
    path = tmp_path / "bomb.mcap"
    path.write_bytes(chunk(b"", claimed, b"zstd", bomb))
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    _, error = read(path)
    assert error is not None
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - peak < 50_000


def test_a_record_of_any_claimed_size(tmp_path: Path) -> None:
    path = tmp_path / "big.mcap"
    for size in (MAX_RECORD_BYTES + 1, 2**40, 2**64 - 1):
        path.write_bytes(MAGIC + b"\x06" + size.to_bytes(8, "little") + b"xx")
        with pytest.raises(InputError, match=rf"byte 8: a record of {size} bytes"):
            list(read_samples(path))


def test_damaged_tum_files(tmp_path: Path) -> None:
    path, rng = tmp_path / "t.tum", np.random.default_rng(4)
    good = b"# t\n" + b"".join(b"%d.5 1 2 3 0 0 0 1\n" % n for n in range(20))
    path.write_bytes(good)
    assert len(read_tum(path)) == 20
    errors = []
    for _ in range(200):
        path.write_bytes(flipped(good, rng))
        try:
            path_read = read_tum(path)
        except InputError as error:
            errors.append(str(error))
        else:
            assert np.isfinite(path_read.positions).all()
    assert len(errors) > 60
    assert all("t.tum, line" in text for text in errors)
