"""Splits of a data set: all takes of one performance stay on one side.

A performance is one person doing one thing, however often it was recorded. Two takes
of it are nearly the same motion: with one in training and the other held out, the held
out one measures memory.
"""

from __future__ import annotations

import hashlib
import re
from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

TRAIN, DEV = "train", "dev"
_SPLIT_PREFIX = re.compile(r"^(train|test|dev|val)[_-]", re.IGNORECASE)
_EXPORT_SUFFIX = re.compile(r"[_-](poses|stageii|stage2|smplx?h?)$", re.IGNORECASE)
_TAKE_INSIDE = re.compile(r"[_-](s|t|take)\d+(?=[_-])", re.IGNORECASE)
_TAKE_AT_END = re.compile(r"[_\- ]*(take|trial|rep|t|s)?[_\- ]?\d+$", re.IGNORECASE)


@dataclass(frozen=True)
class Take:
    """One recording to be put on a side.

    Attributes:
        name: unique.
        performance: takes of one performance share it.
        category: what it shows.
        seconds: how long it is.
        split: the side it was given before, perhaps empty.
    """

    name: str
    performance: str
    category: str
    seconds: float
    split: str = ""


def performance_of(name: str) -> str:
    """The performance that the recording called ``name`` is a take of.

    Numbers of takes and the marks of derived clips (``~mirror``) are dropped. When in
    doubt two recordings are one performance: that costs variety, not honesty.

    Args:
        name: path without suffix, e.g. ``"accad/Female1_B02_WalkToStandT2"``.
    """
    folder, _, stem = name.partition("~")[0].rpartition("/")
    stem = _EXPORT_SUFFIX.sub("", _SPLIT_PREFIX.sub("", stem))
    stem = _TAKE_INSIDE.sub("", stem)
    while True:
        shorter = _TAKE_AT_END.sub("", stem)
        if shorter == stem or not shorter:
            break
        stem = shorter
    return f"{folder}/{stem}".strip("/").lower()


def assign(takes: Sequence[Take], seed: int, dev_share: float) -> dict[str, str]:
    """Name -> split: about ``dev_share`` of the time of each category is held out.

    The order in which performances are considered comes from a hash of the seed and
    the performance's name, so that it does not depend on the other recordings.

    Args:
        takes: all recordings of the data set.
        seed: equal seeds give equal splits.
        dev_share: 0 holds nothing out.
    """
    groups = _grouped(takes)
    by_category: dict[str, list[str]] = defaultdict(list)
    for performance, members in groups.items():
        by_category[_main_category(members)].append(performance)
    held_out: set[str] = set()
    for names in by_category.values():
        names.sort(key=lambda name: hashlib.sha256(f"{seed}/{name}".encode()).digest())
        lengths = {name: sum(t.seconds for t in groups[name]) for name in names}
        held_out |= _choose(names, lengths, dev_share)
    return {t.name: DEV if t.performance in held_out else TRAIN for t in takes}


@dataclass(frozen=True)
class Moved:
    """A take that is not on the side that it was given.

    Attributes:
        name: of the take.
        performance: what it is a take of.
        given, split: the side it was given, and the one it is on.
    """

    name: str
    performance: str
    given: str
    split: str

    def __str__(self) -> str:
        """One line for people."""
        return (
            f"{self.name} is in {self.split}, not in {self.given}: other takes of the "
            f"performance {self.performance!r} are held out"
        )


def settle(
    takes: Sequence[Take], seed: int, dev_share: float
) -> tuple[dict[str, str], tuple[Moved, ...]]:
    """Name -> split: as given where one is given, else as `assign` says.

    What was held out never gets into training: a performance with takes on both sides
    is held out as a whole.

    Returns:
        The splits, and the takes that had to move.
    """
    sides: dict[str, str] = {}
    moved: list[Moved] = []
    free: list[Take] = []
    for performance, members in _grouped(takes).items():
        seconds: dict[str, float] = defaultdict(float)
        for take in members:
            if take.split:
                seconds[take.split] += take.seconds
        if not seconds:
            free += members
            continue
        held_out = sorted(set(seconds) - {TRAIN}) or [TRAIN]
        side = max(held_out, key=lambda name: seconds[name])
        for take in members:
            sides[take.name] = side
            if take.split not in ("", side):
                moved.append(Moved(take.name, performance, take.split, side))
    sides.update(assign(free, seed, dev_share))
    return sides, tuple(sorted(moved, key=lambda item: item.name))


def _grouped(takes: Sequence[Take]) -> dict[str, list[Take]]:
    groups: dict[str, list[Take]] = defaultdict(list)
    for take in takes:
        groups[take.performance].append(take)
    return groups


def _main_category(members: list[Take]) -> str:
    seconds: dict[str, float] = defaultdict(float)
    for take in members:
        seconds[take.category] += take.seconds
    return max(sorted(seconds), key=lambda name: seconds[name])


def _choose(names: list[str], lengths: dict[str, float], share: float) -> set[str]:
    """Performances of one category to hold out; one at least stays, one at least goes.

    Those that would hold out far too much are passed over.
    """
    if share <= 0 or len(names) < 2:
        return set()
    wanted = share * sum(lengths.values())
    chosen: set[str] = set()
    held = 0.0
    for name in names:
        if held >= wanted or len(chosen) == len(names) - 1:
            break
        if held + lengths[name] <= 1.5 * wanted:
            chosen.add(name)
            held += lengths[name]
    return chosen or {min(names, key=lambda name: (lengths[name], name))}
