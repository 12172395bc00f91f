"""BVH recordings with the usual joint names (ACCAD, CMU): Y-up, facing +Z."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from openclone.errors import InputError
from openclone.motion.skeleton import (
    JOINTS,
    MAX_FRAMES,
    HumanMotion,
    make_motion,
    scale_to_metres,
)
from openclone.spatial import rotations

MAX_BYTES = 512 * 1024 * 1024
MAX_JOINTS = 512
Z_UP = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
"""World axes of a Y-up file that faces +Z, turned to Z-up facing +X."""
Z_UP_QUAT = rotations.from_matrix(Z_UP)
_SIDE_NAMES = {
    "hip": ("{}UpLeg", "{}Hip", "{}Thigh"),
    "knee": ("{}Leg", "{}Knee", "{}Shin"),
    "ankle": ("{}Foot", "{}Ankle"),
    "toe": ("{}ToeBase", "{}Toe"),
    "shoulder": ("{}Arm", "{}Shoulder"),
    "elbow": ("{}ForeArm", "{}Elbow"),
    "wrist": ("{}Hand", "{}Wrist"),
}
JOINT_NAMES: dict[str, tuple[str, ...]] = {
    "hips": ("Hips",),
    "chest": ("Spine2", "Spine1", "Chest"),
    "neck": ("Neck", "Neck1"),
    "head": ("Head",),
    **{
        f"{side.lower()}_{part}": tuple(name.format(side) for name in names)
        for side in ("Left", "Right")
        for part, names in _SIDE_NAMES.items()
    },
}
"""Canonical joint -> names in files, the first one present wins."""


@dataclass
class _Node:
    """One joint of the hierarchy while it is being read."""

    name: str
    parent: int
    offset: np.ndarray = field(default_factory=lambda: np.zeros(3))
    channels: tuple[str, ...] = ()


class _Tokens:
    """Words of the hierarchy with their line numbers, for errors that name a line."""

    def __init__(self, lines: list[str], path: Path) -> None:
        self._words = [
            (word, number)
            for number, line in enumerate(lines, 1)
            for word in line.split()
        ]
        self._next = 0
        self._path = path

    def where(self) -> str:
        """File and line of the last word taken."""
        last = self._words[max(self._next - 1, 0)] if self._words else ("", 0)
        return f"{self._path}, line {last[1]}"

    def take(self) -> str:
        if self._next >= len(self._words):
            raise InputError(
                "the hierarchy ends too early",
                where=self.where(),
                remedy="the file is truncated; copy it again",
            )
        self._next += 1
        return self._words[self._next - 1][0]

    def expect(self, word: str) -> None:
        found = self.take()
        if found != word:
            raise InputError(
                f"expected {word!r}, found {found[:40]!r}",
                where=self.where(),
                remedy="this is not a well-formed BVH file",
            )

    def number(self) -> float:
        text = self.take()
        try:
            value = float(text)
        except ValueError:
            value = np.nan
        if not np.isfinite(value):
            raise InputError(
                f"expected a number, found {text[:40]!r}",
                where=self.where(),
                remedy="repair the value",
            )
        return value

    def count(self, most: int, what: str) -> int:
        value = self.number()
        if value != int(value) or not 0 <= value <= most:
            raise InputError(
                f"{what} is {value:g}, expected 0 to {most}",
                where=self.where(),
                remedy="repair the count",
            )
        return int(value)


def _read_hierarchy(tokens: _Tokens) -> list[_Node]:
    """The joints in file order (parents first); end sites are left out."""
    tokens.expect("HIERARCHY")
    tokens.expect("ROOT")
    nodes = [_Node(tokens.take(), -1)]
    tokens.expect("{")
    open_nodes = [0]
    while open_nodes:
        word = tokens.take()
        if word == "JOINT":
            if len(nodes) >= MAX_JOINTS:
                raise InputError(
                    f"more than {MAX_JOINTS} joints",
                    where=tokens.where(),
                    remedy="export the body without extra markers",
                )
            nodes.append(_Node(tokens.take(), open_nodes[-1]))
            open_nodes.append(len(nodes) - 1)
            tokens.expect("{")
        elif word == "End":
            for expected in ("Site", "{", "OFFSET"):
                tokens.expect(expected)
            for _ in range(3):
                tokens.number()
            tokens.expect("}")
        elif word == "OFFSET":
            nodes[open_nodes[-1]].offset = np.array([tokens.number() for _ in "xyz"])
        elif word == "CHANNELS":
            count = tokens.count(6, "the number of channels")
            nodes[open_nodes[-1]].channels = tuple(
                _channel(tokens) for _ in range(count)
            )
        elif word == "}":
            open_nodes.pop()
        else:
            raise InputError(
                f"unknown keyword {word[:40]!r}",
                where=tokens.where(),
                remedy="expected JOINT, End, OFFSET, CHANNELS or a closing brace",
            )
    return nodes


def _channel(tokens: _Tokens) -> str:
    name = tokens.take()
    axis, kind = name[:1].upper(), name[1:].lower()
    if axis not in ("X", "Y", "Z") or kind not in ("position", "rotation"):
        raise InputError(
            f"unknown channel {name[:40]!r}",
            where=tokens.where(),
            remedy="use Xposition ... Zposition, Xrotation ... Zrotation",
        )
    return axis + kind[0]


def _read_motion(
    lines: list[str], start: int, width: int, path: Path
) -> tuple[float, np.ndarray]:
    """Frame rate and ``(T, width)`` values; ``start`` is the line after MOTION."""
    remedy = "the file is truncated or damaged; copy it again"
    header = [line.split() for line in lines[start : start + 2]]
    try:
        count = int(header[0][-1])
        frame_time = float(header[1][-1])
        good = header[0][0] == "Frames:" and header[1][0] == "Frame"
    except (IndexError, ValueError):
        good, count, frame_time = False, 0, 0.0
    where = f"{path}, line {start + 1}"
    if not good:
        raise InputError(
            "expected 'Frames: N' and 'Frame Time: s'", where=where, remedy=remedy
        )
    if not 2 <= count <= MAX_FRAMES:
        raise InputError(
            f"{count} frames, expected 2 to {MAX_FRAMES}", where=where, remedy=remedy
        )
    if not 1e-3 <= frame_time <= 0.2:
        raise InputError(
            f"frame time {frame_time:g} s, expected 0.001 to 0.2",
            where=f"{path}, line {start + 2}",
            remedy="correct the frame time",
        )
    rows = [
        (number, line)
        for number, line in enumerate(lines[start + 2 :], start + 3)
        if line.strip()
    ]
    if len(rows) != count:
        raise InputError(
            f"{len(rows)} frames follow, the header promises {count}",
            where=f"{path}, line {len(lines)}",
            remedy=remedy,
        )
    values = np.empty((count, width))
    for index, (number, line) in enumerate(rows):
        try:
            row = np.array(line.split(), dtype=float)
        except ValueError:
            row = np.array([np.nan])
        if len(row) != width or not np.isfinite(row).all():
            raise InputError(
                f"expected {width} finite numbers, found {len(line.split())} words",
                where=f"{path}, line {number}",
                remedy=remedy,
            )
        values[index] = row
    return 1.0 / frame_time, values


def _pose(nodes: list[_Node], values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """World poses ``(T, n, 3)`` (file units) and ``(T, n, 4)``, in the file's axes."""
    frames = len(values)
    positions = np.empty((frames, len(nodes), 3))
    quats = np.empty((frames, len(nodes), 4))
    column = 0
    for index, node in enumerate(nodes):
        part = values[:, column : column + len(node.channels)]
        column += len(node.channels)
        turns = [k for k, name in enumerate(node.channels) if name[1] == "r"]
        order = "".join(node.channels[k][0] for k in turns)
        local = np.broadcast_to(np.array(rotations.IDENTITY), (frames, 4))
        if turns:
            local = rotations.from_euler(np.radians(part[:, turns]), order)
        offset = np.tile(node.offset, (frames, 1))
        for k, name in enumerate(node.channels):
            if name[1] == "p":
                offset[:, "XYZ".index(name[0])] = part[:, k]
        if node.parent < 0:
            positions[:, index], quats[:, index] = offset, local
        else:
            parent = quats[:, node.parent]
            positions[:, index] = positions[:, node.parent] + rotations.rotate(
                parent, offset
            )
            quats[:, index] = rotations.multiply(parent, local)
    return positions, quats


def _upright_again(nodes: list[_Node], values: np.ndarray) -> np.ndarray:
    """Undo a known export fault of CMU's BVH files in the root's ZYX angles.

    In such a file Z and Y have the wrong sign wherever X is beyond 90 degrees: the
    body flips over and walks on mirrored. The repair is kept only where it removes
    flips, so that sound files stay as they are.
    """
    names = nodes[0].channels
    columns = [k for k, name in enumerate(names) if name[1] == "r"]
    if "".join(names[k][0] for k in columns) != "ZYX":
        return values
    repaired = values.copy()
    beyond = np.abs(rotations.wrap_angle(np.radians(values[:, columns[2]]))) > np.pi / 2
    repaired[:, columns[:2]] *= np.where(beyond, -1.0, 1.0)[:, None]

    def flips(candidate: np.ndarray) -> int:
        quat = rotations.from_euler(np.radians(candidate[:, columns]), "ZYX")
        return int((rotations.angle_between(quat[8:], quat[:-8]) > 1.0).sum())

    return repaired if flips(repaired) < 0.8 * flips(values) else values


def _find_joints(nodes: list[_Node], path: Path) -> list[int]:
    names = [node.name for node in nodes]
    found = []
    for joint in JOINTS:
        match = [name for name in JOINT_NAMES[joint] if name in names]
        if not match:
            raise InputError(
                f"no joint for {joint}",
                where=str(path),
                remedy="name it one of " + ", ".join(JOINT_NAMES[joint]),
            )
        found.append(names.index(match[0]))
    return found


def _calibration_frames(positions: np.ndarray, fps: float) -> int:
    """1 when the first frame is a T-pose from which the body jumps, else 0."""
    if len(positions) < 4:
        return 0
    relative = positions - positions[:, :1]
    jumps = np.linalg.norm(np.diff(relative[:3], axis=0), axis=-1).max(-1)
    return int(jumps[0] * fps > 10.0 and jumps[0] > 5 * jumps[1])


def read(path: Path) -> HumanMotion:
    """Read a BVH file.

    Raises:
        InputError: the file is missing, truncated, malformed or no human body.
    """
    if not path.is_file():
        raise InputError("no such file", where=str(path), remedy="check the path")
    if path.stat().st_size > MAX_BYTES:
        raise InputError("larger than 512 MB", where=str(path), remedy="split it")
    lines = path.read_text(encoding="utf-8", errors="replace").splitlines()
    motion_lines = [k for k, line in enumerate(lines) if line.strip() == "MOTION"]
    end = motion_lines[0] if motion_lines else len(lines)
    nodes = _read_hierarchy(_Tokens(lines[:end], path))
    if not motion_lines:
        raise InputError(
            "there is no MOTION section",
            where=f"{path}, line {len(lines)}",
            remedy="the file is truncated; copy it again",
        )
    chosen = _find_joints(nodes, path)
    width = sum(len(node.channels) for node in nodes)
    fps, values = _read_motion(lines, end + 1, width, path)
    positions, quats = _pose(nodes, _upright_again(nodes, values))
    positions, quats = positions[:, chosen], quats[:, chosen]
    leg = [JOINTS.index(f"left_{part}") for part in ("hip", "knee", "ankle")]
    bones = np.linalg.norm(np.diff(positions[0, leg], axis=0), axis=-1)
    positions = positions * scale_to_metres(float(bones.sum()), str(path))
    first = _calibration_frames(positions, fps)
    turn = np.broadcast_to(Z_UP_QUAT, quats.shape)
    quats = rotations.multiply(
        rotations.multiply(turn, quats), rotations.conjugate(turn)
    )
    return make_motion(
        path.stem, fps, (positions @ Z_UP.T)[first:], quats[first:], str(path)
    )
