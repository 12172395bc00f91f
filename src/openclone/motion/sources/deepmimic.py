"""DeepMimic's JSON recordings (``humanoid3d_*.txt``): Y-up, facing +X, arms hanging.

The file is parsed frame by frame, so that a damaged one cannot fill the memory and an
error names the line.
"""

from __future__ import annotations

import json
import re
from array import array
from pathlib import Path

import numpy as np

from openclone.errors import InputError
from openclone.motion.skeleton import MAX_FRAMES, HumanMotion, make_motion
from openclone.motion.skeleton_maps import maps_for, pose_fixed, to_body_axes
from openclone.motion.sources.text_lines import check_file

FRAME_SIZE = 44
MAX_BYTES = 64 * 1024 * 1024
MAX_ENTRY = 65_536
"""Characters of a frame, or of another entry beside the frames."""
_SPACE = re.compile(r"[ \t\r\n]*")
_NUMBERS = re.compile(r"[-+0-9.eE, \t\r\n]*\]")


class _Json:
    """A place in a JSON text; every step is checked and bounded."""

    def __init__(self, path: Path) -> None:
        check_file(path, MAX_BYTES)
        self.path = path
        try:
            self.text = path.read_text(encoding="utf-8-sig")
        except UnicodeDecodeError as error:
            line = error.object.count(b"\n", 0, error.start) + 1
            raise InputError(
                f"not UTF-8 text (byte {error.start})",
                where=f"{path}, line {line}",
                remedy="use a DeepMimic motion file",
            ) from None
        self.at = 0

    @property
    def where(self) -> str:
        """File and line, for errors."""
        return f"{self.path}, line {self.text.count(chr(10), 0, self.at) + 1}"

    def bad(self, what: str) -> InputError:
        return InputError(
            f"not valid JSON ({what})",
            where=self.where,
            remedy="the file is truncated or damaged; copy it again",
        )

    def peek(self) -> str:
        """The next character that is no white space, empty at the end."""
        match = _SPACE.match(self.text, self.at)
        self.at = match.end() if match else self.at
        return self.text[self.at : self.at + 1]

    def expect(self, wanted: str) -> str:
        found = self.peek()
        if not found or found not in wanted:
            raise self.bad(f"expected one of {wanted}, found {found!r}")
        self.at += 1
        return found

    def value(self) -> object:
        """Any value of at most `MAX_ENTRY` characters."""
        self.peek()
        piece = self.text[self.at : self.at + MAX_ENTRY]
        try:
            value, length = json.JSONDecoder().raw_decode(piece)
        except (ValueError, RecursionError) as error:
            raise self.bad(str(error)[:80]) from None
        self.at += length
        return value

    def row(self, index: int) -> list[float]:
        """A list of `FRAME_SIZE` finite numbers."""
        self.peek()
        match = None
        if self.text.startswith("[", self.at):
            match = _NUMBERS.match(self.text, self.at + 1, self.at + MAX_ENTRY)
        value = self.value() if match else None
        try:
            if isinstance(value, list) and len(value) == FRAME_SIZE:
                numbers = [float(item) for item in value]
                if np.isfinite(numbers).all():
                    return numbers
        except OverflowError:
            pass
        if not match and not self.text.find("]", self.at, self.at + MAX_ENTRY) >= 0:
            raise self.bad("a frame has no end")
        raise InputError(
            f"Frames[{index}]: expected {FRAME_SIZE} finite numbers",
            where=self.where,
            remedy="use the humanoid3d format: duration, root pose, 12 joints",
        )


def _read_list(text: _Json) -> tuple[np.ndarray, list[int]]:
    """Frames ``(T, 44)`` and the character at which each starts."""
    values, starts = array("d"), []
    text.expect("[")
    mark = "," if text.peek() != "]" else text.expect("]")
    while mark == ",":
        if len(starts) >= MAX_FRAMES:
            break
        text.peek()
        starts.append(text.at)
        values.extend(text.row(len(starts) - 1))
        mark = text.expect(",]")
    if mark == "," or len(starts) < 2:
        raise InputError(
            f'no list "Frames" of 2 to {MAX_FRAMES} frames',
            where=text.where,
            remedy="use a DeepMimic motion file",
        )
    return np.frombuffer(values, dtype=float).reshape(-1, FRAME_SIZE), starts


def _read_frames(path: Path) -> tuple[np.ndarray, list[str]]:
    """``(T, 44)`` finite numbers, and the place of every frame."""
    text = _Json(path)
    frames: tuple[np.ndarray, list[int]] | None = None
    mark = text.expect("{") if text.peek() == "{" else "}"
    while mark in "{,":
        name = text.value() if text.peek() == '"' else None
        if not isinstance(name, str):
            raise text.bad("expected a name")
        text.expect(":")
        if name != "Frames":
            text.value()
        elif frames is None and text.peek() == "[":
            frames = _read_list(text)
        else:
            raise text.bad("Frames twice, or no list")
        mark = text.expect(",}")
    if frames is None or text.peek():
        raise InputError(
            f'no list "Frames" of 2 to {MAX_FRAMES} frames'
            if frames is None
            else "something follows the end",
            where=text.where,
            remedy="use a DeepMimic motion file",
        )
    values, starts = frames
    places, line, last = [], 1, 0
    for index, start in enumerate(starts):
        line, last = line + text.text.count("\n", last, start), start
        places.append(f"{path}, line {line}, Frames[{index}]")
    return values, places


def read(path: Path) -> HumanMotion:
    """Read a DeepMimic motion on a fixed skeleton of average size.

    Raises:
        InputError: the file is missing, truncated, malformed or of another body.
    """
    values, places = _read_frames(path)
    item = maps_for("deepmimic", path)[0]
    for joint in item.joints:
        if joint.kind == "quaternion":
            part = values[:, joint.column : joint.column + 4]
            lengths = np.sqrt(np.minimum(part * part, 1e6).sum(1))
            worst = int(np.abs(lengths - 1).argmax())
            if abs(lengths[worst] - 1) > 0.5:  # blended by some exporters
                raise InputError(
                    f"the quaternion of {joint.name} has length {lengths[worst]:.3g}",
                    where=places[worst],
                    remedy="write unit quaternions, w first",
                )
    steps = values[:-1, 0]
    if not (steps > 0).all():
        raise InputError(
            f"duration {steps.min():g} s",
            where=places[int(steps.argmin())],
            remedy="every frame but the last lasts longer than zero",
        )
    with np.errstate(all="ignore"):
        positions, quats = pose_fixed(item.joints, values[:, 1:4], values)
        assert item.world is not None  # maps of this format name their axes
        fps = 1.0 / float(np.median(steps))
        return make_motion(
            path.stem,
            fps,
            positions @ item.world.T,
            to_body_axes(quats, item),
            places[0],
        )
