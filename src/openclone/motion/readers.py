"""One reader per file format, chosen by the file's suffix and, for npz, its arrays."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from openclone.errors import InputError
from openclone.motion.skeleton import HumanMotion
from openclone.motion.sources import asf_amc, bvh, deepmimic

HUMAN: dict[str, Callable[[Path], HumanMotion]] = {
    ".bvh": bvh.read,
    ".amc": asf_amc.read,
    ".txt": deepmimic.read,
    ".json": deepmimic.read,
}


def read_recording(path: Path) -> HumanMotion:
    """Read a human recording of any supported format.

    Raises:
        InputError: the suffix is unknown or the file malformed.
    """
    reader = HUMAN.get(path.suffix.lower())
    if reader is None:
        raise InputError(
            f"no reader for {path.suffix or 'a file without suffix'!r}",
            where=str(path),
            remedy="use .bvh, .amc (with its .asf beside it) or DeepMimic's .txt",
        )
    return reader(path)
