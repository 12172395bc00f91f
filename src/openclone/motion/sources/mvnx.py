"""Xsens MVNX recordings: XML with the poses of 23 body segments; metres, Z up.

The file is parsed as a stream. Document types and entities, which no recording needs,
are refused, and so is whatever would make the parser collect memory.
"""

from __future__ import annotations

from array import array
from pathlib import Path
from xml.parsers import expat

import numpy as np

from openclone.errors import InputError
from openclone.motion.skeleton import JOINTS, MAX_FRAMES, HumanMotion, make_motion
from openclone.motion.skeleton_maps import SkeletonMap, maps_for, to_body_axes
from openclone.motion.sources.text_lines import DAMAGED, check_file, parse_numbers

MAX_BYTES = 4 * 1024**3
MAX_DEPTH = 32
MAX_SEGMENTS = 128
MAX_NAMES = 2_000
"""Names of elements and attributes, which the parser keeps."""
MAX_TEXT = 65_536
"""Characters of one element's text."""
_BLOCK = 65_536
_MAX_TOKEN = 1024 * 1024
_WANTED = {"orientation": 4, "position": 3}
"""Elements of a frame -> numbers per segment."""


class _Reader:
    """Collects what a recording holds while the XML passes by."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.fps = 0.0
        self.segments: list[str] = []
        self.item: SkeletonMap | None = None
        self.rows = {name: array("d") for name in _WANTED}
        self._chosen: list[int] = []
        self._names: set[str] = set()
        self._open: list[str] = []
        self._frame: dict[str, np.ndarray] | None = None
        self._text: list[str] | None = None
        self._size = 0
        self._parser = parser = expat.ParserCreate("UTF-8")
        parser.StartDoctypeDeclHandler = self._refuse_doctype
        parser.EntityDeclHandler = self._refuse_doctype
        parser.StartElementHandler = self._start
        parser.EndElementHandler = self._end
        parser.CharacterDataHandler = self._characters

    @property
    def where(self) -> str:
        """File and line, for errors."""
        return f"{self.path}, line {self._parser.CurrentLineNumber}"

    def parse(self) -> None:
        done = 0
        with self.path.open("rb") as stream:
            while block := stream.read(_BLOCK):
                self._feed(block, last=False)
                done += len(block)
                if done - self._parser.CurrentByteIndex > _MAX_TOKEN:
                    raise InputError(
                        "an endless tag or comment", where=self.where, remedy=DAMAGED
                    )
        self._feed(b"", last=True)

    def _feed(self, block: bytes, *, last: bool) -> None:
        try:
            self._parser.Parse(block, last)
        except expat.ExpatError as error:
            raise InputError(
                f"not well-formed XML ({error})", where=self.where, remedy=DAMAGED
            ) from error

    def _refuse_doctype(self, *_: object) -> None:
        raise InputError(
            "a document type or entity",
            where=self.where,
            remedy="remove it; MVNX files have none",
        )

    def _start(self, name: str, attributes: dict[str, str]) -> None:
        self._names.add(name)
        self._names.update(attributes)
        self._open.append(name)
        if len(self._open) > MAX_DEPTH or len(self._names) > MAX_NAMES:
            raise InputError(
                f"more than {MAX_DEPTH} nested elements or {MAX_NAMES} names",
                where=self.where,
                remedy="this is no MVNX recording",
            )
        if len(self._open) == 1 and name != "mvnx":
            raise InputError(
                f"the root element is {name[:40]!r}",
                where=self.where,
                remedy="use an MVNX recording",
            )
        if name == "subject":
            self._begin_subject(attributes)
        elif name == "segment" and self._open[-2:-1] == ["segments"]:
            self._add_segment(attributes)
        elif name == "frame" and self._open[-2:-1] == ["frames"]:
            self._begin_frame(attributes)
        elif name in _WANTED and self._frame is not None:
            self._text, self._size = [], 0

    def _begin_subject(self, attributes: dict[str, str]) -> None:
        if self.fps:
            raise InputError(
                "a second subject",
                where=self.where,
                remedy="export every actor to a file of its own",
            )
        self.fps = float(
            parse_numbers(attributes.get("frameRate", "").split(), 1, self.where)[0]
        )
        if not 5 <= self.fps <= 1000:
            raise InputError(
                f"frameRate is {self.fps:g}, expected 5 to 1000",
                where=self.where,
                remedy="repair it",
            )

    def _add_segment(self, attributes: dict[str, str]) -> None:
        label = attributes.get("label", "")
        if label in self.segments or len(self.segments) >= MAX_SEGMENTS or self._chosen:
            raise InputError(
                f"segment {label[:40]!r} comes twice, too late, or as one too many",
                where=self.where,
                remedy=DAMAGED,
            )
        self.segments.append(label)

    def _begin_frame(self, attributes: dict[str, str]) -> None:
        if not self._chosen:
            self._choose_map()
        if attributes.get("type", "normal") != "normal":
            return  # calibration poses
        self._frame = {}
        if len(self.rows["position"]) >= MAX_FRAMES * len(JOINTS) * 3:
            raise InputError(
                f"more than {MAX_FRAMES} frames",
                where=self.where,
                remedy="cut the recording into pieces",
            )

    def _choose_map(self) -> None:
        if not self.fps:
            raise InputError("no subject", where=self.where, remedy=DAMAGED)
        lacking = "hips"
        for item in maps_for("mvnx", self.path):
            found = [
                [self.segments.index(n) for n in item.names[j] if n in self.segments]
                for j in JOINTS
            ]
            if all(found):
                self.item, self._chosen = item, [places[0] for places in found]
                return
            lacking = next(j for j, f in zip(JOINTS, found, strict=True) if not f)
        raise InputError(
            f"no segment for {lacking}",
            where=self.where,
            remedy="export the full body, or put a skeleton map beside the file",
        )

    def _characters(self, text: str) -> None:
        if self._text is None:
            return
        self._size += len(text)
        if self._size > MAX_TEXT:
            raise InputError("an endless element", where=self.where, remedy=DAMAGED)
        self._text.append(text)

    def _end(self, name: str) -> None:
        self._open.pop()
        if self._frame is None:
            return
        if self._text is not None and name in _WANTED:
            words = "".join(self._text).split()
            width = _WANTED[name]
            if name in self._frame:
                raise InputError(f"{name} twice", where=self.where, remedy=DAMAGED)
            values = parse_numbers(words, width * len(self.segments), self.where)
            self._frame[name] = values.reshape(-1, width)[self._chosen]
            self._text = None
        elif name == "frame":
            self._end_frame(self._frame)
            self._frame = None

    def _end_frame(self, frame: dict[str, np.ndarray]) -> None:
        for name in _WANTED:
            if name not in frame:
                raise InputError(
                    f"a frame without {name}",
                    where=self.where,
                    remedy="export positions and orientations of the segments",
                )
        lengths = np.sqrt(np.minimum(frame["orientation"] ** 2, 1e6).sum(1))
        if np.abs(lengths - 1).max() > 0.05:
            raise InputError(
                f"a quaternion has length {lengths[np.abs(lengths - 1).argmax()]:.3g}",
                where=self.where,
                remedy="orientations are unit quaternions, w first",
            )
        for name, values in frame.items():
            self.rows[name].extend(values.ravel().tolist())


def read(path: Path) -> HumanMotion:
    """Read an MVNX recording.

    Raises:
        InputError: the file is missing, malformed, or lacks segments.
    """
    check_file(path, MAX_BYTES)
    reader = _Reader(path)
    with np.errstate(all="ignore"):
        reader.parse()
        if reader.item is None or reader.item.world is None:
            raise InputError("no frames", where=reader.where, remedy=DAMAGED)
        shape = (-1, len(JOINTS))
        position = np.frombuffer(reader.rows["position"]).reshape(*shape, 3)
        quat = np.frombuffer(reader.rows["orientation"]).reshape(*shape, 4)
        return make_motion(
            path.stem,
            reader.fps,
            position @ reader.item.world.T,
            to_body_axes(quat, reader.item),
            reader.where,
        )
