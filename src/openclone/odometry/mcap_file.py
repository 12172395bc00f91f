"""Messages of an MCAP file, read from front to back with every size checked.

The `mcap` package trusts the sizes in a file and unpacks chunks of any claimed size.
Here each record is bounded by the file and by a limit before it is read, compressed
chunks are bounded before they are unpacked, and checksums are verified, so a damaged
or hostile file ends in an `InputError` that names the byte offset. Everything before
that offset has been delivered by then: a recorder that lost power loses its last
second only.
"""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from pathlib import Path
from typing import BinaryIO

import zstandard
from lz4.frame import LZ4FrameDecompressor
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError
from mcap.opcode import Opcode
from mcap.records import Channel, Chunk, Schema

from openclone.errors import InputError

MAGIC = b"\x89MCAP0\r\n"
MAX_RECORD_BYTES = 128 * 2**20
"""A chunk holds a few scans; recorders write chunks of 1 to 8 MB."""


@dataclass(frozen=True)
class RawMessage:
    """A message as stored.

    Attributes:
        topic: where it was published.
        type_name: ROS 2 name, such as ``sensor_msgs/msg/Imu``.
        encoding: of ``data``; ``cdr`` for ROS 2.
        log_ns: when it was received.
        data: the serialized message.
        where: file and place, for error messages.
    """

    topic: str
    type_name: str
    encoding: str
    log_ns: int
    data: bytes
    where: str


@dataclass
class _Directory:
    """Schemas and channels met so far."""

    schemas: dict[int, Schema] = field(default_factory=dict)
    channels: dict[int, Channel] = field(default_factory=dict)


def read_mcap(path: Path) -> Iterator[RawMessage]:
    """Yield the messages of ``path`` in file order.

    Raises:
        InputError: not MCAP, truncated or damaged, with the byte offset.
    """
    with path.open("rb") as file:
        if file.read(len(MAGIC)) != MAGIC:
            raise InputError(
                "not an MCAP file", where=str(path), remedy="its first bytes are wrong"
            )
        directory = _Directory()
        size = path.stat().st_size
        while True:
            offset = file.tell()
            where = f"{path}, byte {offset}"
            opcode, body = _read_record(file, size, where)
            try:
                yield from _messages(opcode, body, directory, where)
            except (McapError, struct.error, ValueError, zstandard.ZstdError) as error:
                raise InputError(
                    f"damaged record ({error or type(error).__name__})", where=where
                ) from error
            except RuntimeError as error:  # lz4 has no error class of its own
                raise InputError(f"damaged chunk ({error})", where=where) from error
            if opcode == Opcode.FOOTER:
                break
        if file.read() != MAGIC:
            raise InputError("damaged or truncated at its end", where=str(path))


def _read_record(file: BinaryIO, size: int, where: str) -> tuple[int, bytes]:
    head = file.read(9)
    remedy = "what comes before this place is intact"
    if len(head) < 9:
        raise InputError("the file is truncated", where=where, remedy=remedy)
    opcode, length = struct.unpack("<BQ", head)
    if length > MAX_RECORD_BYTES:
        raise InputError(
            f"a record of {length} bytes; the limit is {MAX_RECORD_BYTES}",
            where=where,
            remedy="the file is damaged, or was written with too large chunks",
        )
    if length > size - file.tell():
        raise InputError("the file is truncated", where=where, remedy=remedy)
    return opcode, file.read(length)


def _messages(
    opcode: int, body: bytes, directory: _Directory, where: str
) -> Iterator[RawMessage]:
    """The messages in one record of the file; schemas and channels are remembered."""
    if opcode == Opcode.CHUNK:
        content = _unpack_chunk(Chunk.read(ReadDataStream(BytesIO(body))))
        start = 0
        while start < len(content):
            inner, length = struct.unpack_from("<BQ", content, start)
            start += 9
            if length > len(content) - start:
                raise ValueError("a record reaches beyond its chunk")
            if inner != Opcode.CHUNK:
                part = content[start : start + length]
                yield from _messages(inner, part, directory, where)
            start += length
    elif opcode == Opcode.SCHEMA:
        schema = Schema.read(ReadDataStream(BytesIO(body)))
        directory.schemas[schema.id] = schema
    elif opcode == Opcode.CHANNEL:
        channel = Channel.read(ReadDataStream(BytesIO(body)))
        directory.channels[channel.id] = channel
    elif opcode == Opcode.MESSAGE:
        yield _message(body, directory, where)


def _message(body: bytes, directory: _Directory, where: str) -> RawMessage:
    channel_id, sequence, log_ns, _ = struct.unpack_from("<HIQQ", body)
    channel = directory.channels.get(channel_id)
    if channel is None:
        raise ValueError(f"message of the unknown channel {channel_id}")
    schema = directory.schemas.get(channel.schema_id)
    return RawMessage(
        channel.topic,
        schema.name if schema else "",
        channel.message_encoding,
        log_ns,
        body[22:],
        f"{where}, {channel.topic} number {sequence}",
    )


def _unpack_chunk(chunk: Chunk) -> bytes:
    """The records of a chunk, with its size and its checksum verified."""
    size = chunk.uncompressed_size
    if size > MAX_RECORD_BYTES:
        raise ValueError(f"a chunk of {size} bytes; the limit is {MAX_RECORD_BYTES}")
    if chunk.compression == "zstd":
        # The frame's own header decides what is allocated, so it is asked first.
        if zstandard.frame_content_size(chunk.data) not in (-1, size):
            raise ValueError("a chunk whose two sizes differ")
        decompressor = zstandard.ZstdDecompressor()
        content = decompressor.decompress(chunk.data, max_output_size=max(size, 1))
    elif chunk.compression == "lz4":
        content = LZ4FrameDecompressor().decompress(chunk.data, max_length=size + 1)
    elif chunk.compression == "":
        content = chunk.data
    else:
        raise ValueError(f"unknown compression {chunk.compression!r}")
    if len(content) != size:
        raise ValueError(f"a chunk of {len(content)} bytes that claims {size}")
    if chunk.uncompressed_crc and zlib.crc32(content) != chunk.uncompressed_crc:
        raise ValueError("a chunk whose checksum is wrong")
    return content
