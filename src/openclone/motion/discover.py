"""Finding the recordings in what a user points at."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from openclone.errors import InputError
from openclone.motion import library
from openclone.motion.clip import CATEGORIES, ClipInfo, load_clip
from openclone.motion.library import Entry
from openclone.motion.proportions import FPS
from openclone.motion.readers import looks_like_motion
from openclone.motion.splits import performance_of

_WORDS = (
    ("crouchwalk", "sneak|stealth|crouch.?walk"),
    ("pickup", "pick.?up|deposit|lift|put.?down|grab.?floor"),
    ("squat", "squat|crouch|kneel"),
    ("jump", "jump|hop|leap|skip"),
    ("punch", "punch|box|kick|fight|spar"),
    ("wave", "wave|signal|gesture|conversation|greet|clap"),
    ("reach", "reach|grab|wash|point"),
    ("stepside", "side.?step|step.?side|sideways"),
    ("turn", "turn|circle|spin"),
    ("backward", "back"),
    ("forward", "walk|run|jog|march|sprint"),
    ("stand", "stand|idle|wait|sway|look"),
)
"""Categories and the words in a name that mean them; the first that fits counts."""


@dataclass(frozen=True)
class Recording:
    """A motion that a build may use.

    Attributes:
        entry: its place and, perhaps, its split.
        info: what its clip will say about itself.
        performance: what it is a take of.
    """

    entry: Entry
    info: ClipInfo
    performance: str

    @property
    def name(self) -> str:
        """Unique in the build."""
        return self.info.name


def guess_category(name: str) -> str:
    """Category by the words in a recording's name, ``transition`` if none fits."""
    for category, words in _WORDS:
        if re.search(words, name.rpartition("/")[2], re.IGNORECASE):
            return category
    return "transition"


def discover(
    sources: Sequence[Path], category: str = "", licence: str = "unknown"
) -> list[Recording]:
    """All recordings and clips of ``sources``, in a fixed order, names unique.

    Args:
        sources: files, folders with a manifest, or folders that are searched.
        category: of what no manifest describes; empty to judge by the names.
        licence: of what no manifest describes.

    Raises:
        InputError: nothing there, a malformed manifest, or two of one name.
    """
    if category and category not in CATEGORIES:
        raise InputError(
            f"unknown category {category!r}", remedy="use " + ", ".join(CATEGORIES)
        )
    found: dict[str, Recording] = {}
    for source in sources:
        for recording in _in_source(source, category, licence):
            if recording.name in found:
                recording = _renamed(recording, source)
            if recording.name in found:
                raise InputError(
                    f"two motions are called {recording.name!r}",
                    where=str(source),
                    remedy="give every source once, and folders different names",
                )
            found[recording.name] = recording
    if not found:
        raise InputError(
            "no recordings found",
            where=", ".join(str(source) for source in sources),
            remedy="give folders or files of a supported format",
        )
    return list(found.values())


def _renamed(recording: Recording, source: Path) -> Recording:
    """The same with the name of its source in front."""
    name = f"{source.resolve().name}/{recording.name}"
    return replace(recording, info=replace(recording.info, name=name))


def _in_source(source: Path, category: str, licence: str) -> list[Recording]:
    if source.is_dir() and (source / library.MANIFEST).is_file():
        return [_recording(entry) for entry in library.read_manifest(source)]
    if source.is_dir():
        paths = sorted(p for p in source.rglob("*") if looks_like_motion(p))
        root = source
    elif source.is_file():
        paths, root = [source], source.parent
    else:
        raise InputError("no such file or folder", where=str(source))
    found = []
    for path in paths:
        name = path.relative_to(root).with_suffix("").as_posix()
        kind = category or guess_category(name)
        found.append(_recording(Entry(name, path, "", kind, licence), category))
    return found


def _recording(entry: Entry, category: str = "") -> Recording:
    """Describe ``entry``; a ready clip brings its own name, source and category."""
    source = entry.name + entry.path.suffix
    info = ClipInfo(entry.name, entry.category, source, entry.licence, FPS)
    if library.is_clip(entry.path):
        try:
            own = load_clip(entry.path).info
        except InputError:
            own = info  # reading it again will say what is wrong
        licence = own.licence if entry.licence == "unknown" else entry.licence
        info = replace(
            own,
            category=category or (own.category if not entry.split else entry.category),
            licence=licence,
        )
    return Recording(entry, info, entry.performance or performance_of(info.name))
