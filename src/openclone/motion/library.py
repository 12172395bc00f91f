"""Data sets of motions: a folder of recordings with a manifest, or of clip files.

The manifest is ``manifest.tsv``: tab-separated columns split, category, path (relative
to the folder), format, seconds, licence. Recordings are retargeted on the way and kept
as clip files in a cache.
"""

from __future__ import annotations

import csv
import os
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

from openclone.errors import InputError
from openclone.motion.batch import Job, Outcome, digest_of, run_jobs
from openclone.motion.clip import CATEGORIES, Clip, ClipInfo, load_clip
from openclone.motion.proportions import FPS
from openclone.motion.quality import Gate, faults
from openclone.motion.readers import SUFFIXES, source_files
from openclone.motion.readers import read_recording as read_recording
from openclone.motion.splits import performance_of

MANIFEST = "manifest.tsv"
COLUMNS = ("split", "category", "path", "format", "seconds", "licence")
MAX_ROWS = 100_000
_GATE = Gate(min_seconds=0.0)
"""A manifest may list short recordings on purpose."""


@dataclass(frozen=True)
class Entry:
    """One row of a manifest.

    Attributes:
        name: the path without its suffix, e.g. ``"accad/Female1_B03_Walk1"``.
        path: the recording or clip file.
        split, category, licence: as in the manifest.
        performance: what it is a take of; empty where the manifest does not say.
    """

    name: str
    path: Path
    split: str
    category: str
    licence: str
    performance: str = ""


def default_cache() -> Path:
    """Folder for retargeted clips: ``$XDG_CACHE_HOME`` or ``~/.cache``."""
    base = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(base) / "openclone" / "clips"


def suffixes() -> tuple[str, ...]:
    """Lower-case suffixes of files that may hold a motion."""
    return SUFFIXES


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
        performance=row.get("performance") or "",
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


def with_takes_elsewhere(entries: list[Entry], split: str) -> list[Entry]:
    """The entries of ``split`` whose performance has takes in another split.

    Two takes of one performance are nearly the same motion, see `splits`.
    """

    def performance(entry: Entry) -> str:
        name = entry.name.removeprefix(f"{entry.split}/")
        return entry.performance or performance_of(name)

    elsewhere = {performance(entry) for entry in entries if entry.split != split}
    return [e for e in entries if e.split == split and performance(e) in elsewhere]


def job_of(entry: Entry, cache: Path) -> Job:
    """What `batch.run_jobs` is to do for ``entry``.

    Raises:
        InputError: a file is missing.
    """
    from openclone.motion.retarget import VERSION

    source = entry.name + entry.path.suffix
    info = ClipInfo(entry.name, entry.category, source, entry.licence, FPS)
    ready = is_clip(entry.path)
    digest = digest_of(source_files(entry.path), "clip" if ready else str(VERSION))
    return Job(info, entry.path, cache / digest, ready)


def is_clip(path: Path) -> bool:
    """Whether the file is a clip of the G1 rather than a recording of a human."""
    if path.suffix != ".npz":
        return False
    try:
        with zipfile.ZipFile(path) as archive:
            return {"metadata.npy", "joint_angles.npy"} <= set(archive.namelist())
    except (OSError, zipfile.BadZipFile):
        return False


def _load_entries(
    entries: list[Entry], cache: Path, report: Callable[[str], None], workers: int
) -> list[Clip]:
    recordings = [entry for entry in entries if not is_clip(entry.path)]
    count = 0

    def tell(outcome: Outcome) -> None:
        nonlocal count
        count += 1
        name = f"[{count}/{len(recordings)}] {outcome.job.info.name}"
        if outcome.error:
            raise InputError(outcome.error)
        reasons = faults(outcome.quality, _GATE) if outcome.quality else ()
        if reasons:
            report(f"{name} left out: {'; '.join(reasons)}")
        elif outcome.fresh:
            report(f"{name}: {outcome.quality}")

    jobs = [job_of(entry, cache) for entry in recordings]
    outcomes = run_jobs(jobs, workers, tell)
    made = {outcome.job.info.name: outcome for outcome in outcomes}
    clips: list[Clip] = []
    for entry in entries:
        outcome = made.get(entry.name)
        if outcome is None:
            clip = load_clip(entry.path)
            given = {"category": entry.category, "licence": entry.licence}
            clips.append(replace(clip, info=replace(clip.info, **given)))
        elif outcome.quality is not None and not faults(outcome.quality, _GATE):
            clip = load_clip(outcome.clip_path)
            clips.append(replace(clip, info=outcome.job.info))
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
    workers: int = 1,
    apart: bool = False,
) -> list[Clip]:
    """Load the motions of one split as clips of the G1.

    Recordings that do not pass the gate of `quality` are left out and reported.

    Args:
        root: folder with a manifest, or with clip files (``<split>/*.npz``, ``*.npz``).
        split: e.g. ``"train"``.
        categories: only these; None for all.
        cache: folder that keeps the retargeted clips.
        report: receives a line per motion that is new or left out.
        workers: processes that retarget; see `batch.run_jobs` before asking for more.
        apart: leave out, and report, motions whose performance has takes in another
            split of the manifest: nothing like what is held out gets into training.

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
    entries = read_manifest(root)
    chosen = _choose(entries, split, categories, str(root / MANIFEST))
    if apart:
        shared = with_takes_elsewhere(entries, split)
        left_out = [entry.name for entry in chosen if entry in shared]
        chosen = [entry for entry in chosen if entry not in shared]
        if left_out:
            report(
                f"{len(left_out)} motions of {split!r} left out, as other takes of "
                f"their performances are held out: {', '.join(left_out)}"
            )
    return _load_entries(chosen, cache, report, workers)
