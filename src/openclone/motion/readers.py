"""One reader per file format, chosen by the file's suffix and, for npz, its arrays.

Recordings of humans become a `HumanMotion`, which needs retargeting; motions of the G1
become a `Clip` directly.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from openclone.errors import InputError
from openclone.motion.clip import Clip, load_clip
from openclone.motion.npz import array_names
from openclone.motion.skeleton import HumanMotion
from openclone.motion.skeleton_maps import map_files
from openclone.motion.sources import (
    amass,
    asf_amc,
    bvh,
    deepmimic,
    g1_csv,
    gmr_npz,
    mjlab_npz,
    mvnx,
)

HUMAN: dict[str, Callable[[Path], HumanMotion]] = {
    ".bvh": bvh.read,
    ".amc": asf_amc.read,
    ".txt": deepmimic.read,
    ".json": deepmimic.read,
    ".mvnx": mvnx.read,
}
"""Suffix -> reader of human recordings; ``.npz`` is told apart by its arrays."""
SUFFIXES = (*HUMAN, ".csv", ".npz")
"""Suffixes of files that may hold a motion."""
_SUPPORTED = (
    "use .bvh, .amc (with its .asf beside it), .mvnx, AMASS .npz, DeepMimic's .txt or "
    ".json; or G1 motions: clips, .csv, .npz of mjlab, BeyondMimic or GMR"
)
_SNIFFED = 65_536
"""Bytes that are looked into to tell what a file is."""
_PICKLES = (".pkl", ".pickle", ".p", ".pt", ".pth")


def looks_like_motion(path: Path) -> bool:
    """Whether a file found in a folder is to be read as a motion.

    Suffixes that other files have too (.txt, .json, .csv) are looked into.
    """
    suffix = path.suffix.lower()
    if suffix not in SUFFIXES or not path.is_file():
        return False
    if suffix not in (".txt", ".json", ".csv"):
        return True
    with path.open("rb") as stream:
        start = stream.read(_SNIFFED)
    if suffix == ".csv":
        return start.split(b"\n")[0].count(b",") == g1_csv.COLUMNS - 1
    return b'"Frames"' in start


def source_files(path: Path) -> list[Path]:
    """All files that decide what `read_motion` makes of ``path``, itself first.

    Raises:
        InputError: an ``.amc`` file lacks its skeleton.
    """
    files = [path]
    if path.suffix.lower() == ".amc":
        files.append(asf_amc.skeleton_path(path))
    return files + map_files(path)


def read_recording(path: Path) -> HumanMotion:
    """Read a human recording of any supported format.

    Raises:
        InputError: the suffix is unknown or the file malformed.
    """
    motion = read_motion(path)
    if isinstance(motion, Clip):
        raise InputError(
            "this is a motion of the G1, not a human recording",
            where=str(path),
            remedy="make it a clip with `openclone motions import`",
        )
    return motion


def read_motion(path: Path) -> HumanMotion | Clip:
    """Read a human recording or a motion of the G1, of any supported format.

    A clip from a foreign format is named after its file; its category is "transition"
    and its licence "unknown", since such files do not say.

    Raises:
        InputError: the suffix is unknown or the file malformed.
    """
    suffix = path.suffix.lower()
    if suffix in HUMAN:
        return HUMAN[suffix](path)
    if suffix == ".csv":
        return g1_csv.read(path)
    if suffix == ".npz":
        return _read_npz(path)
    if suffix in _PICKLES:
        raise InputError(
            "pickle can run any code and is never read",
            where=str(path),
            remedy="convert the file to .npz with the program that wrote it",
        )
    raise InputError(
        f"no reader for {path.suffix or 'a file without suffix'!r}",
        where=str(path),
        remedy=_SUPPORTED,
    )


def _read_npz(path: Path) -> HumanMotion | Clip:
    names = array_names(path)
    if "metadata" in names:
        return load_clip(path)
    if mjlab_npz.is_mjlab(names):
        return mjlab_npz.read(path)
    if gmr_npz.is_gmr(names):
        return gmr_npz.read(path)
    if amass.is_amass(names):
        return amass.read(path)
    shown = ", ".join(sorted(name[:40] for name in names)[:8])
    raise InputError(
        f"an npz file of an unknown kind, with {shown or 'no arrays'}",
        where=str(path),
        remedy=_SUPPORTED,
    )
