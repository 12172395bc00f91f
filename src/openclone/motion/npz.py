"""Arrays of an ``.npz`` file from a stranger: no pickle, and no memory on a promise.

NumPy allocates what an array's header asks for before it reads the data, so the header
is compared with the size of the packed data first.
"""

from __future__ import annotations

import lzma
import math
import struct
import zipfile
import zlib
from pathlib import Path

import numpy as np

from openclone.errors import InputError

MAX_BYTES = 256 * 1024 * 1024
MAX_ARRAY_BYTES = 256 * 1024 * 1024
UNREADABLE = (
    OSError, ValueError, KeyError, TypeError, AttributeError, EOFError, IndexError,
    RuntimeError, OverflowError, MemoryError, SyntaxError, struct.error,
    zipfile.BadZipFile, zlib.error, lzma.LZMAError,
)  # fmt: skip
"""What zipfile, its decompressors and NumPy's header parser raise on damaged files."""


def _broken(path: Path, what: str) -> InputError:
    return InputError(
        what, where=str(path), remedy="the file is truncated or damaged; copy it again"
    )


def array_names(path: Path) -> frozenset[str]:
    """Names of the arrays in the file.

    Raises:
        InputError: the file is missing, too large or no npz file.
    """
    if not path.is_file():
        raise InputError("no such file", where=str(path), remedy="check the path")
    if path.stat().st_size > MAX_BYTES:
        raise InputError("larger than 256 MB", where=str(path), remedy="split it")
    try:
        with zipfile.ZipFile(path) as archive:
            names = archive.namelist()
    except UNREADABLE as error:
        raise _broken(path, f"not a readable npz file ({error})") from error
    return frozenset(name.removesuffix(".npy") for name in names)


def _read_member(archive: zipfile.ZipFile, name: str) -> np.ndarray:
    """One array; `ValueError` says what is wrong with it."""
    size = archive.getinfo(f"{name}.npy").file_size
    if size > MAX_ARRAY_BYTES:
        raise ValueError(f"larger than {MAX_ARRAY_BYTES // 2**20} MB")
    with archive.open(f"{name}.npy") as stream:
        version = np.lib.format.read_magic(stream)
        if version == (1, 0):
            header = np.lib.format.read_array_header_1_0(stream)
        elif version == (2, 0):
            header = np.lib.format.read_array_header_2_0(stream)
        else:
            raise ValueError(f"npy version {version}")
        shape, fortran, dtype = header
        if dtype.hasobject or dtype.kind not in "fiubSU":
            raise ValueError(f"values of type {dtype}, expected numbers or text")
        if any(length < 0 for length in shape):
            raise ValueError(f"shape {shape}")
        wanted = math.prod(shape) * dtype.itemsize
        data = bytearray(stream.read(min(wanted, size) + 1))  # writable
    if len(data) != wanted:
        raise ValueError(f"{len(data)} bytes of data, shape {shape} needs {wanted}")
    values = np.frombuffer(data, dtype=dtype) if wanted else np.empty(0, dtype)
    return values.reshape(shape, order="F" if fortran else "C")


def unpack(path: Path, name: str) -> np.ndarray:
    """The array called ``name``, of numbers or text; one of `UNREADABLE` if not."""
    with zipfile.ZipFile(path) as archive:
        return _read_member(archive, name)


def read_array(path: Path, name: str) -> np.ndarray:
    """The array called ``name``, of numbers or text.

    Raises:
        InputError: it is missing, damaged, giant, or would need pickle.
    """
    try:
        return unpack(path, name)
    except UNREADABLE as error:
        raise _broken(path, f"the array {name!r} is not readable ({error})") from error


def read_numbers(path: Path, name: str, shape: tuple[int | None, ...]) -> np.ndarray:
    """A float64 array of finite numbers; None in ``shape`` is any length.

    Raises:
        InputError: it is missing, damaged, or of another shape.
    """
    values = read_array(path, name)
    fits = len(values.shape) == len(shape) and all(
        want is None or have == want
        for have, want in zip(values.shape, shape, strict=True)
    )
    if not fits or values.dtype.kind not in "fiu":
        text = ", ".join("any" if want is None else str(want) for want in shape)
        raise InputError(
            f"{name} is {values.dtype} of shape {values.shape}, expected numbers of "
            f"shape ({text})",
            where=str(path),
            remedy="check which program wrote the file",
        )
    values = values.astype(np.float64)
    bad = np.argwhere(~np.isfinite(values))
    if len(bad):
        place = ", ".join(map(str, bad[0]))
        raise InputError(
            f"{name}[{place}] is not a finite number",
            where=str(path),
            remedy="repair or drop this frame",
        )
    return values


def read_scalar(path: Path, name: str) -> float:
    """One finite number, stored as such or as a list of one.

    Raises:
        InputError: it is missing, damaged, or something else.
    """
    values = read_array(path, name)
    if values.size == 1 and values.dtype.kind in "fiu":
        number = float(values.reshape(-1)[0])
        if math.isfinite(number):
            return number
    raise InputError(
        f"{name} is not one finite number", where=str(path), remedy="repair it"
    )
