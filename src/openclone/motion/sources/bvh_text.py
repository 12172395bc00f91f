"""The text of a BVH file: the hierarchy of joints and the rows of channel values."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from openclone.errors import InputError
from openclone.motion.skeleton import MAX_FRAMES
from openclone.motion.sources.text_lines import (
    DAMAGED,
    MAX_VALUES,
    Lines,
    parse_count,
    parse_numbers,
)

MAX_JOINTS = 512
MAX_HEADER_LINES = 20_000


@dataclass
class Node:
    """One joint of the hierarchy; ``offset`` (3,) in file units, file axes."""

    name: str
    parent: int
    offset: np.ndarray = field(default_factory=lambda: np.zeros(3))
    channels: tuple[str, ...] = ()


class _Words:
    """Words of the hierarchy, read line by line up to the line MOTION."""

    def __init__(self, lines: Lines) -> None:
        self._lines = lines
        self._words: list[str] = []
        self.ended = False
        self.motion = False

    @property
    def where(self) -> str:
        return self._lines.where

    def peek(self) -> bool:
        """Whether a word follows; reads lines until one does."""
        while not self._words and not self.ended:
            line = self._lines.take()
            if line is None or line == "MOTION":
                self.ended = True
                self.motion = line is not None
            elif self._lines.number > MAX_HEADER_LINES:
                raise InputError(
                    f"no MOTION within {MAX_HEADER_LINES} lines",
                    where=self.where,
                    remedy=DAMAGED,
                )
            else:
                self._words = line.split()[::-1]
        return bool(self._words)

    def take(self) -> str:
        if not self.peek():
            raise InputError(
                "the hierarchy ends too early",
                where=self.where,
                remedy="the file is truncated; copy it again",
            )
        return self._words.pop()

    def expect(self, word: str) -> None:
        found = self.take()
        if found != word:
            raise InputError(
                f"expected {word!r}, found {found[:40]!r}",
                where=self.where,
                remedy="this is not a well-formed BVH file",
            )

    def number(self) -> float:
        text = self.take()
        try:
            return float(parse_numbers([text], 1, self.where)[0])
        except InputError:
            raise InputError(
                f"expected a number, found {text[:40]!r}",
                where=self.where,
                remedy="repair the value",
            ) from None

    def channel(self) -> str:
        name = self.take()
        axis, kind = name[:1].upper(), name[1:].lower()
        if axis not in ("X", "Y", "Z") or kind not in ("position", "rotation"):
            raise InputError(
                f"unknown channel {name[:40]!r}",
                where=self.where,
                remedy="use Xposition ... Zposition, Xrotation ... Zrotation",
            )
        return axis + kind[0]

    def channels(self) -> tuple[str, ...]:
        text = self.take()
        count = parse_count(text)
        if count is None or count > 6:
            raise InputError(
                f"the number of channels is {text[:40]}, expected 0 to 6",
                where=self.where,
                remedy="repair the count",
            )
        names = tuple(self.channel() for _ in range(count))
        if len(set(names)) != count:
            raise InputError(
                f"a channel is listed twice in {' '.join(names)}",
                where=self.where,
                remedy="list every channel of a joint once",
            )
        return names


def _plain(name: str) -> str:
    """A joint's name without the namespace that some exporters put before it."""
    return name.rsplit(":", 1)[-1]


def _next_joint(words: _Words, parent: int, count: int) -> Node:
    if count >= MAX_JOINTS:
        raise InputError(
            f"more than {MAX_JOINTS} joints",
            where=words.where,
            remedy="export the body without extra markers",
        )
    node = Node(_plain(words.take()), parent)
    words.expect("{")
    return node


def _read_entry(word: str, words: _Words, node: Node) -> None:
    """What a joint's block holds besides joints."""
    if word == "OFFSET":
        node.offset = np.array([words.number() for _ in "xyz"])
    elif word == "CHANNELS":
        node.channels = words.channels()
    elif word == "End":
        for expected in ("Site", "{", "OFFSET"):
            words.expect(expected)
        for _ in range(3):
            words.number()
        words.expect("}")
    else:
        raise InputError(
            f"unknown keyword {word[:40]!r}",
            where=words.where,
            remedy="expected JOINT, End, OFFSET, CHANNELS or a closing brace",
        )


def read_hierarchy(lines: Lines) -> list[Node]:
    """The joints in file order (parents first); end sites are left out.

    Afterwards ``lines`` stands behind the line MOTION.

    Raises:
        InputError: the hierarchy is malformed, or no motion follows.
    """
    words = _Words(lines)
    words.expect("HIERARCHY")
    words.expect("ROOT")
    nodes = [Node(_plain(words.take()), -1)]
    words.expect("{")
    open_nodes = [0]
    while open_nodes:
        word = words.take()
        if word == "JOINT":
            nodes.append(_next_joint(words, open_nodes[-1], len(nodes)))
            open_nodes.append(len(nodes) - 1)
        elif word == "}":
            open_nodes.pop()
        else:
            _read_entry(word, words, nodes[open_nodes[-1]])
    if words.peek():
        raise InputError(
            f"{words.take()[:40]!r} follows the first skeleton",
            where=words.where,
            remedy="export every actor to a file of its own",
        )
    if not any(node.channels for node in nodes):
        raise InputError(
            "no joint has a channel", where=words.where, remedy="export the motion too"
        )
    if not words.motion:
        raise InputError(
            "there is no MOTION section",
            where=words.where,
            remedy="the file is truncated; copy it again",
        )
    return nodes


def _read_header(lines: Lines, width: int) -> tuple[int, float]:
    """Number of frames and seconds per frame."""
    first = (lines.take() or "").split()
    where = lines.where
    second = (lines.take() or "").split()
    count = parse_count(first[-1]) if first else None
    try:
        frame_time = float(second[-1])
        good = first[0] == "Frames:" and second[0] == "Frame" and count is not None
    except (IndexError, ValueError):
        good, frame_time = False, 0.0
    if not good or count is None:
        raise InputError(
            "expected 'Frames: N' and 'Frame Time: s'", where=where, remedy=DAMAGED
        )
    if not 2 <= count <= MAX_FRAMES:
        raise InputError(
            f"{count} frames, expected 2 to {MAX_FRAMES}",
            where=where,
            remedy="cut the recording into pieces, or copy it again if it is damaged",
        )
    if not 1e-3 <= frame_time <= 0.2:
        raise InputError(
            f"frame time {frame_time:g} s, expected 0.001 to 0.2",
            where=lines.where,
            remedy="correct the frame time",
        )
    if count * width > MAX_VALUES:
        raise InputError(
            f"{count} frames of {width} channels are more than {MAX_VALUES} numbers",
            where=where,
            remedy="cut the recording into pieces, or copy it again if it is damaged",
        )
    return count, frame_time


def read_frames(lines: Lines, width: int, path: Path) -> tuple[float, np.ndarray]:
    """Frame rate and ``(T, width)`` values: degrees, file units.

    ``lines`` stands behind the line MOTION.

    Raises:
        InputError: the header or a row is malformed.
    """
    count, frame_time = _read_header(lines, width)
    # A number takes two characters or more: memory is not lent on a promise.
    most = path.stat().st_size // (2 * max(width, 1)) + 1
    values = np.empty((min(count, most), width))
    done = 0
    for line in lines:
        if not line:
            continue
        if done == count:
            raise InputError(
                f"more frames follow than the {count} that the header promises",
                where=lines.where,
                remedy=DAMAGED,
            )
        values[done] = parse_numbers(line.split(), width, lines.where)
        done += 1
    if done < count:
        raise InputError(
            f"{done} frames follow, the header promises {count}",
            where=lines.where,
            remedy=DAMAGED,
        )
    return 1.0 / frame_time, values
