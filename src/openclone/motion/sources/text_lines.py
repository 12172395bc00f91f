"""Lines of a text file from a stranger: streamed, bounded, and numbered for errors."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import TracebackType

import numpy as np

from openclone.errors import InputError

MAX_BYTES = 512 * 1024 * 1024
MAX_LINE = 256 * 1024
"""Characters; no frame of a recording needs more."""
MAX_VALUES = 20_000_000
"""Numbers kept of one recording (160 MB): 25 minutes of 120 channels at 120 Hz."""
DAMAGED = "the file is truncated or damaged; copy it again"


def check_file(path: Path, most: int = MAX_BYTES) -> None:
    """Refuse a missing or giant file.

    Raises:
        InputError: it is not there, or has more than ``most`` bytes.
    """
    if not path.is_file():
        raise InputError("no such file", where=str(path), remedy="check the path")
    if path.stat().st_size > most:
        raise InputError(
            f"larger than {most // 2**20} MB", where=str(path), remedy="split it"
        )


class Lines:
    """Iterates over a file's lines, stripped; use it in a ``with`` statement.

    Attributes:
        number: number of the line last handed out, from 1.
    """

    def __init__(self, path: Path, *, comment: str = "", most: int = MAX_BYTES) -> None:
        """Open ``path``; text after ``comment`` is left out.

        Raises:
            InputError: the file is missing or larger than ``most`` bytes.
        """
        check_file(path, most)
        self.number = 0
        self._path = path
        self._comment = comment
        self._stream = path.open(encoding="utf-8-sig", errors="replace")

    def __enter__(self) -> Lines:
        """Close the file afterwards."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Close the file."""
        self._stream.close()

    def __iter__(self) -> Iterator[str]:
        """The remaining lines."""
        while (line := self.take()) is not None:
            yield line

    @property
    def where(self) -> str:
        """File and line, for errors."""
        return f"{self._path}, line {max(self.number, 1)}"

    def take(self) -> str | None:
        """The next line, None at the end.

        Raises:
            InputError: it is too long.
        """
        line = self._stream.readline(MAX_LINE)
        if not line:
            return None
        self.number += 1
        if len(line) >= MAX_LINE:
            raise InputError("the line is too long", where=self.where, remedy=DAMAGED)
        if self._comment:
            line = line.split(self._comment, 1)[0]
        return line.strip()


def parse_numbers(words: list[str], count: int, where: str) -> np.ndarray:
    """Exactly ``count`` finite numbers, plain decimal notation.

    Raises:
        InputError: there are more, fewer, or others; it names ``where``.
    """
    try:
        values = np.array(words, dtype=float)
    except ValueError:
        values = np.empty(0)
    if len(values) == count and np.isfinite(values).all() and "_" not in "".join(words):
        return values
    raise InputError(
        f"expected {count} finite numbers, found {len(words)} words",
        where=where,
        remedy=DAMAGED,
    )


def parse_count(word: str) -> int | None:
    """A whole number without a sign, None if ``word`` is something else."""
    return int(word) if word.isascii() and word.isdigit() and len(word) < 16 else None
