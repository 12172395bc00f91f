"""Compiling the package's C for the processor at hand, once."""

from __future__ import annotations

import ctypes
import hashlib
import os
import platform
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

from openclone.errors import InputError
from openclone.motion.library import default_cache

_FLAGS = (
    "-O3", "-march=native", "-fPIC", "-shared", "-std=gnu11", "-ffp-contract=fast",
    "-fno-math-errno", "-fno-trapping-math", "-fno-signed-zeros", "-freciprocal-math",
    "-fassociative-math",
)  # fmt: skip
"""Not -ffast-math: with it, GCC makes the whole process round tiny numbers to zero as
soon as the library is loaded."""
_WIDE = "-mprefer-vector-width=512"
"""Without it GCC uses half of a 512-bit register."""


def compiler() -> str | None:
    """The C compiler: ``$CC``, else cc, gcc or clang; None if there is none."""
    names = (os.environ.get("CC", ""), "cc", "gcc", "clang")
    return next((path for name in names if name and (path := shutil.which(name))), None)


def load(source: Path) -> ctypes.CDLL:
    """The shared library of ``source``, compiled on first use and kept in the cache.

    It is compiled anew when the file, or a header whose name begins with its, changes.

    Raises:
        InputError: there is no compiler, or it fails.
    """
    command = compiler()
    if command is None:
        raise InputError(
            "there is no C compiler on this machine",
            remedy="install gcc, or train with --physics threaded",
        )
    wide = platform.machine() in ("x86_64", "AMD64")
    flags = (*_FLAGS, _WIDE) if wide else _FLAGS
    parts = sorted((source, *source.parent.glob(f"{source.stem}*.h")))
    text = b"".join(part.read_bytes() for part in parts)
    key = hashlib.sha256(
        text + " ".join((command, *flags)).encode() + _processor()
    ).hexdigest()[:16]
    library = default_cache().parent / "native" / f"{source.stem}-{key}.so"
    if not library.is_file():
        _compile(command, flags, source, library)
    return ctypes.CDLL(str(library))


def _processor() -> bytes:
    """What distinguishes processors that may share a cache: code is made for one."""
    if sys.platform == "linux":
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        flags = [line for line in lines if line.startswith(("flags", "Features"))]
        if flags:
            return flags[0].encode()
    return platform.processor().encode()


def _compile(command: str, flags: tuple[str, ...], source: Path, library: Path) -> None:
    library.parent.mkdir(parents=True, exist_ok=True)
    # Processes that begin together all compile; each puts a whole file in place.
    with tempfile.TemporaryDirectory(dir=library.parent) as folder:
        partial = Path(folder) / library.name
        run = subprocess.run(
            [command, *flags, str(source), "-o", str(partial)],
            capture_output=True,
            text=True,
            check=False,
        )
        if run.returncode != 0:
            first = (run.stderr.strip().splitlines() or ["no message"])[0]
            raise InputError(
                f"{command} does not compile it ({first})",
                where=str(source),
                remedy="update the compiler, or train with --physics threaded",
            )
        partial.replace(library)
