"""Data sets of motions: a folder of recordings with a manifest, or of clip files.

The manifest is ``manifest.tsv``: tab-separated columns split, category, path (relative
to the folder), format, seconds, licence. Recordings are retargeted on the way and kept
as clip files in a cache.
"""

from __future__ import annotations

import csv
import hashlib
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING

from openclone.errors import InputError
from openclone.motion.clip import CATEGORIES, Clip, ClipInfo, load_clip, save_clip
from openclone.motion.skeleton import HumanMotion
from openclone.motion.sources import asf_amc, bvh, deepmimic

if TYPE_CHECKING:
    from openclone.motion.retarget import Solver

MANIFEST = "manifest.tsv"
COLUMNS = ("split", "category", "path", "format", "seconds", "licence")
MAX_ROWS = 100_000
_READERS: dict[str, Callable[[Path], HumanMotion]] = {
    ".bvh": bvh.read,
    ".amc": asf_amc.read,
    ".txt": deepmimic.read,
    ".json": deepmimic.read,
}


@dataclass(frozen=True)
class Entry:
    """One row of a manifest.

    Attributes:
        name: the path without its suffix, e.g. ``"accad/Female1_B03_Walk1"``.
        path: the recording or clip file.
        split, category, licence: as in the manifest.
    """

    name: str
    path: Path
    split: str
    category: str
    licence: str


def default_cache() -> Path:
    """Folder for retargeted clips: ``$XDG_CACHE_HOME`` or ``~/.cache``."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "openclone" / "clips"


def read_recording(path: Path) -> HumanMotion:
    """Read a human recording of any supported format.

    Raises:
        InputError: the suffix is unknown or the file malformed.
    """
    reader = _READERS.get(path.suffix.lower())
    if reader is None:
        raise InputError(
            f"no reader for {path.suffix or 'a file without suffix'!r}",
            where=str(path),
            remedy="use .bvh, .amc (with its .asf beside it) or DeepMimic's .txt",
        )
    return reader(path)


def _entry(row: dict[str, str | None], root: Path, where: str) -> Entry:
    """Check one row of the manifest."""
    values = {column: row.get(column) or "" for column in COLUMNS}
    for column in ("split", "category", "path"):
        if not values[column]:
            raise InputError(
                f"no {column}",
                where=where,
                remedy="fill the tab-separated columns " + ", ".join(COLUMNS),
            )
    if values["category"] not in CATEGORIES:
        raise InputError(
            f"unknown category {values['category']!r}",
            where=where,
            remedy="use one of " + ", ".join(CATEGORIES),
        )
    relative = PurePosixPath(values["path"])
    if relative.is_absolute() or ".." in relative.parts:
        raise InputError(
            f"the path {values['path']!r} leaves the folder",
            where=where,
            remedy="give paths inside the folder of the manifest",
        )
    return Entry(
        name=str(relative.with_suffix("")),
        path=root / relative,
        split=values["split"],
        category=values["category"],
        licence=values["licence"] or "unknown",
    )


def read_manifest(root: Path) -> list[Entry]:
    """All entries of ``root``'s manifest.

    Raises:
        InputError: the manifest is missing or malformed; the message names the line.
    """
    path = root / MANIFEST
    if not path.is_file():
        raise InputError("no such file", where=str(path), remedy="write a manifest")
    with path.open(encoding="utf-8", errors="replace", newline="") as stream:
        rows = csv.DictReader(stream, delimiter="\t", quoting=csv.QUOTE_NONE)
        missing = [name for name in COLUMNS if name not in (rows.fieldnames or ())]
        if missing:
            raise InputError(
                f"no column {missing[0]!r}",
                where=f"{path}, line 1",
                remedy="the tab-separated columns are " + ", ".join(COLUMNS),
            )
        entries: dict[str, Entry] = {}
        for number, row in enumerate(rows, 2):
            where = f"{path}, line {number}"
            if number > MAX_ROWS:
                raise InputError("too many rows", where=where, remedy="split the set")
            entry = _entry(row, root, where)
            if entry.name in entries:
                raise InputError(
                    f"{entry.name!r} is listed twice",
                    where=where,
                    remedy="give every motion one row and a name of its own",
                )
            entries[entry.name] = entry
    return list(entries.values())


def _choose(
    entries: list[Entry], split: str, categories: tuple[str, ...] | None, where: str
) -> list[Entry]:
    splits = sorted({entry.split for entry in entries})
    if split not in splits:
        raise InputError(
            f"there is no split {split!r}",
            where=where,
            remedy="use one of " + ", ".join(splits),
        )
    chosen = [entry for entry in entries if entry.split == split]
    _check_categories(categories, {entry.category for entry in chosen}, where)
    return [e for e in chosen if categories is None or e.category in categories]


def _check_categories(
    wanted: tuple[str, ...] | None, present: set[str], where: str
) -> None:
    for name in wanted or ():
        if name not in present:
            raise InputError(
                f"there is no motion of category {name!r}",
                where=where,
                remedy="use one of " + ", ".join(c for c in CATEGORIES if c in present),
            )


def _cache_path(entry: Entry, cache: Path) -> Path:
    """Name of the cached clip: content of the recording and version of the method."""
    from openclone.motion.retarget import VERSION

    digest = hashlib.sha256(f"{VERSION}\n".encode())
    files = [entry.path]
    if entry.path.suffix.lower() == ".amc":
        files.append(asf_amc.skeleton_path(entry.path))
    for file in files:
        if not file.is_file():
            raise InputError(
                "no such file", where=str(file), remedy="correct the manifest"
            )
        digest.update(hashlib.sha256(file.read_bytes()).digest())
    return cache / f"{digest.hexdigest()[:32]}.npz"


def _cached(path: Path) -> Clip | None:
    """The clip at ``path``; None if there is none or it is damaged."""
    try:
        return load_clip(path) if path.is_file() else None
    except InputError:
        return None


def _load_entries(
    entries: list[Entry], cache: Path, report: Callable[[str], None]
) -> list[Clip]:
    from openclone.motion.retarget import CannotFollowError, Solver, retarget

    clips: list[Clip] = []
    solver: Solver | None = None
    for number, entry in enumerate(entries, 1):
        source = entry.name + entry.path.suffix
        info = ClipInfo(entry.name, entry.category, source, entry.licence, 50.0)
        if entry.path.suffix == ".npz":
            clip = load_clip(entry.path)
            clips.append(replace(clip, info=replace(info, fps=clip.info.fps)))
            continue
        path = _cache_path(entry, cache)
        clip = _cached(path)
        if clip is None:
            solver = solver or Solver()
            try:
                clip, quality = retarget(read_recording(entry.path), info, solver)
            except CannotFollowError as error:
                report(f"[{number}/{len(entries)}] left out: {error}")
                continue
            save_clip(clip, path)
            report(f"[{number}/{len(entries)}] {entry.name}: {quality}")
        clips.append(replace(clip, info=info))
    return clips


def _load_folder(
    root: Path, split: str, categories: tuple[str, ...] | None
) -> list[Clip]:
    """Ready clips: ``root/<split>/*.npz`` or, without such folders, ``root/*.npz``."""
    folders = sorted({path.parent.name for path in root.glob("*/*.npz")})
    if not any(root.glob("*.npz")):
        if not folders:
            raise InputError(
                "neither a manifest nor clip files",
                where=str(root),
                remedy=f"add {MANIFEST}, or make clips with `openclone motions`",
            )
        if split not in folders:
            raise InputError(
                f"there is no split {split!r}",
                where=str(root),
                remedy="use one of " + ", ".join(folders),
            )
        root = root / split
    clips = [load_clip(path) for path in sorted(root.glob("*.npz"))]
    _check_categories(categories, {clip.info.category for clip in clips}, str(root))
    return [c for c in clips if categories is None or c.info.category in categories]


def load_clips(
    root: Path,
    split: str,
    categories: tuple[str, ...] | None,
    cache: Path,
    report: Callable[[str], None],
) -> list[Clip]:
    """Load the motions of one split as clips of the G1.

    Args:
        root: folder with a manifest, or with clip files (``<split>/*.npz``, ``*.npz``).
        split: e.g. ``"train"``.
        categories: only these; None for all.
        cache: folder that keeps the retargeted clips.
        report: receives a line per newly retargeted motion.

    Raises:
        InputError: a file is missing or malformed, or the split or a category unknown.
    """
    for name in categories or ():
        if name not in CATEGORIES:
            raise InputError(
                f"unknown category {name!r}",
                remedy="use one of " + ", ".join(CATEGORIES),
            )
    if not root.is_dir():
        raise InputError(
            "no such folder", where=str(root), remedy="check the path of the motions"
        )
    if not (root / MANIFEST).is_file():
        return _load_folder(root, split, categories)
    chosen = _choose(read_manifest(root), split, categories, str(root / MANIFEST))
    return _load_entries(chosen, cache, report)
