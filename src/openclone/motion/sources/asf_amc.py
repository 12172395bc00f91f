"""ASF/AMC recordings (Acclaim; HDM05, CMU): a skeleton file and a motion file."""

from __future__ import annotations

import re
from array import array
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from openclone.errors import InputError
from openclone.motion.skeleton import JOINTS, MAX_FRAMES, HumanMotion, make_motion
from openclone.motion.skeleton_maps import SkeletonMap, maps_for, to_body_axes
from openclone.motion.sources.text_lines import (
    DAMAGED,
    MAX_VALUES,
    Lines,
    parse_count,
    parse_numbers,
)
from openclone.spatial import rotations

INCH = 0.0254
DEFAULT_FPS = 120.0
MAX_BONES = 256
MAX_SKELETON_BYTES = 2**20
_ROOT_ORDER = "TX TY TZ RX RY RZ"
_CHUNK = 4096
"""Frames posed at once, which bounds the memory."""


@dataclass
class _Bone:
    """One bone: ``vector`` is direction times length, file units, file axes."""

    name: str
    vector: np.ndarray = field(default_factory=lambda: np.zeros(3))
    axis: np.ndarray = field(default_factory=lambda: np.array(rotations.IDENTITY))
    dofs: tuple[str, ...] = ()
    parent: str = ""
    where: str = ""


@dataclass(frozen=True)
class Skeleton:
    """What an ASF file holds.

    Attributes:
        bones: parents first.
        metres: metres per file unit.
        radians: radians per unit of angle.
        order: the root's channels, such as ``("TX", ..., "RZ")``.
        item: the map that knows the bones' names.
    """

    bones: list[_Bone]
    metres: float
    radians: float
    order: tuple[str, ...]
    item: SkeletonMap


def _euler(angles: np.ndarray, order: str) -> np.ndarray:
    """Acclaim angles in radians turn about *fixed* axes, the first named first."""
    return rotations.from_euler(angles[..., ::-1], order[::-1])


class _SkeletonReader:
    """Reads an ASF file line by line; sections are methods."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.bones = {"root": _Bone("root")}
        self.scale = 1.0
        self.radians = np.pi / 180
        self.order = tuple(_ROOT_ORDER.split())
        self.section = ""
        self.where = ""

    def read(self) -> None:
        with Lines(self.path, comment="#", most=MAX_SKELETON_BYTES) as lines:
            for line in lines:
                words = line.split()
                if not words:
                    continue
                if words[0].startswith(":"):
                    self.section = words[0][1:].lower()
                elif self.section == "units":
                    self._unit(words, lines.where)
                elif self.section == "root" and words[0] == "order":
                    self._root_order(words[1:], lines.where)
                elif self.section == "bonedata" and words == ["begin"]:
                    self._bone(lines)
                elif self.section == "hierarchy" and words[0] not in ("begin", "end"):
                    self._children(words, lines.where)
            self.where = lines.where

    def _unit(self, words: list[str], where: str) -> None:
        if words[0] == "length":
            self.scale = float(parse_numbers(words[1:2], 1, where)[0])
            if not 1e-6 < self.scale < 1e6:
                raise InputError(
                    f"unit length {self.scale:g}", where=where, remedy="repair it"
                )
        elif words[0] == "angle" and words[1:] in (["rad"], ["radians"]):
            self.radians = 1.0

    def _root_order(self, words: list[str], where: str) -> None:
        order = tuple(word.upper() for word in words)
        if sorted(order) != sorted(_ROOT_ORDER.split()):
            raise InputError(
                f"unknown order of the root {' '.join(words)[:40]!r}",
                where=where,
                remedy=f"name all of {_ROOT_ORDER}",
            )
        self.order = order

    def _bone(self, lines: Lines) -> None:
        """The bone between the lines ``begin`` and ``end``."""
        first = lines.where
        bone = _Bone("", where=first)
        direction, length = np.zeros(3), 0.0
        axis: tuple[np.ndarray, str] = (np.zeros(3), "XYZ")
        for line in lines:
            words, where = line.split(), lines.where
            match words[:1]:
                case ["end"]:
                    break
                case ["name"]:
                    bone.name = words[1] if len(words) > 1 else ""
                case ["direction"]:
                    direction = parse_numbers(words[1:4], 3, where)
                case ["length"]:
                    length = float(parse_numbers(words[1:2], 1, where)[0])
                case ["axis"]:
                    order = _axis_order(words, where)
                    axis = (parse_numbers(words[1:4], 3, where), order)
                case ["dof"]:
                    bone.dofs = _dofs(words[1:], where)
        else:
            raise InputError("a bone without 'end'", where=first, remedy=DAMAGED)
        if not bone.name:
            raise InputError("a bone without a name", where=first, remedy="name it")
        if bone.name in self.bones or len(self.bones) > MAX_BONES:
            raise InputError(
                f"bone {bone.name[:40]!r} is described twice, or there are more than "
                f"{MAX_BONES} bones",
                where=first,
                remedy="describe every bone of the body once",
            )
        bone.axis = _euler(axis[0] * self.radians, axis[1])
        bone.vector = direction * length
        self.bones[bone.name] = bone

    def _children(self, words: list[str], where: str) -> None:
        for child in words[1:]:
            known = child in self.bones and words[0] in self.bones
            if not known or child == "root" or self.bones[child].parent:
                raise InputError(
                    f"unknown bone, or one with two parents, in "
                    f"{' '.join(words)[:60]!r}",
                    where=where,
                    remedy="describe every bone under :bonedata, hang it up once",
                )
            self.bones[child].parent = words[0]


def _axis_order(words: list[str], where: str) -> str:
    order = words[4].upper() if len(words) > 4 else "XYZ"
    if sorted(order) != ["X", "Y", "Z"]:
        raise InputError(
            f"unknown order of axes {order[:20]!r}",
            where=where,
            remedy="write XYZ or another order of the three",
        )
    return order


def _dofs(words: list[str], where: str) -> tuple[str, ...]:
    dofs = tuple(word.lower() for word in words)
    if not set(dofs) <= {"rx", "ry", "rz"} or len(set(dofs)) < len(dofs):
        raise InputError(
            f"unsupported degrees of freedom {' '.join(words)[:40]!r}",
            where=where,
            remedy="only rx, ry and rz are supported, each once",
        )
    return dofs


def read_skeleton(path: Path) -> Skeleton:
    """Read an ASF file.

    Raises:
        InputError: it is missing or malformed, or no skeleton map knows its bones.
    """
    reader = _SkeletonReader(path)
    reader.read()
    return Skeleton(
        bones=_parents_first(reader.bones),
        metres=INCH / reader.scale,
        radians=reader.radians,
        order=reader.order,
        item=_choose_map(reader.bones, path, reader.where),
    )


def _choose_map(bones: dict[str, _Bone], path: Path, where: str) -> SkeletonMap:
    """The first map all of whose joints are bones of this skeleton."""
    problem: tuple[str, tuple[str, ...]] = ("hips", ("root",))
    for item in maps_for("asf", path):
        lacking = [j for j in JOINTS if not any(n in bones for n in item.names[j])]
        if not lacking:
            return item
        problem = (lacking[0], item.names[lacking[0]])
    joint, names = problem
    raise InputError(
        f"no bone {' or '.join(map(repr, names))} for {joint}",
        where=where,
        remedy="use the bone names of HDM05 or CMU skeletons, or put a skeleton map "
        "beside it",
    )


def _parents_first(bones: dict[str, _Bone]) -> list[_Bone]:
    ordered, names = [bones["root"]], {"root"}
    waiting = [bone for bone in bones.values() if bone.name != "root"]
    while waiting:
        ready = [bone for bone in waiting if bone.parent in names]
        if not ready:
            raise InputError(
                f"bone {waiting[0].name[:40]!r} does not hang on the root",
                where=waiting[0].where,
                remedy="complete the :hierarchy section",
            )
        ordered += ready
        names |= {bone.name for bone in ready}
        waiting = [bone for bone in waiting if bone.name not in names]
    return ordered


def _read_frames(path: Path, widths: dict[str, int]) -> dict[str, np.ndarray]:
    """Values of each moving bone, ``(T, width)``, as in the file."""
    rows = {name: array("d") for name in widths}
    frames = 0
    per_frame = sum(widths.values())
    with Lines(path, comment="#") as lines:
        for line in lines:
            words = line.split()
            if not words or words[0].startswith(":"):
                continue
            if len(words) == 1:
                _check_complete(rows, widths, frames, lines.where)
                frames += 1
                if parse_count(words[0]) != frames or frames > MAX_FRAMES:
                    raise InputError(
                        f"expected frame {frames}, found {words[0][:20]!r}",
                        where=lines.where,
                        remedy=f"frames count up from 1 to at most {MAX_FRAMES}",
                    )
                if frames * per_frame > MAX_VALUES:
                    raise InputError(
                        f"more than {MAX_VALUES} numbers",
                        where=lines.where,
                        remedy="cut the recording into pieces",
                    )
            elif words[0] not in widths or len(words) != widths[words[0]] + 1:
                raise InputError(
                    f"{words[0][:40]!r} with {len(words) - 1} values does not fit the "
                    "skeleton",
                    where=lines.where,
                    remedy="use the .asf file that belongs to this recording",
                )
            else:
                if len(rows[words[0]]) >= frames * widths[words[0]]:
                    _check_complete(rows, widths, frames, lines.where, words[0])
                values = parse_numbers(words[1:], len(words) - 1, lines.where)
                rows[words[0]].extend(values.tolist())
        _check_complete(rows, widths, frames, lines.where)
        if not frames:
            raise InputError("there are no frames", where=lines.where, remedy=DAMAGED)
    return {
        name: np.frombuffer(values, dtype=float).reshape(frames, -1)
        for name, values in rows.items()
    }


def _check_complete(
    rows: dict[str, array[float]],
    widths: dict[str, int],
    frames: int,
    where: str,
    twice: str = "",
) -> None:
    """Every bone has ``frames`` rows; ``twice`` names one that has too many."""
    missing = [n for n, values in rows.items() if len(values) != frames * widths[n]]
    name = twice or (missing[0] if missing else "")
    if name:
        raise InputError(
            f"frame {frames} lacks {name[:40]!r} or holds it twice",
            where=where,
            remedy="the file is truncated; copy it again",
        )


def _pose(
    skeleton: Skeleton, frames: dict[str, np.ndarray]
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Start point (file units) and orientation of every bone, in the file's axes."""
    root, order = frames["root"], skeleton.order
    starts = {"root": root[:, [order.index(name) for name in ("TX", "TY", "TZ")]]}
    ends = {"root": starts["root"]}
    turns = [k for k, name in enumerate(order) if name[0] == "R"]
    sequence = "".join(order[k][1] for k in turns)
    quats = {"root": _euler(root[:, turns] * skeleton.radians, sequence)}
    for bone in skeleton.bones[1:]:
        parent = quats[bone.parent]
        quat = parent
        if bone.dofs:
            sequence = "".join(dof[1].upper() for dof in bone.dofs)
            turn = _euler(frames[bone.name] * skeleton.radians, sequence)
            axis = np.broadcast_to(bone.axis, turn.shape)
            turn = rotations.multiply(
                rotations.multiply(axis, turn), rotations.conjugate(axis)
            )
            quat = rotations.multiply(parent, turn)
        starts[bone.name] = ends[bone.parent]
        ends[bone.name] = ends[bone.parent] + rotations.rotate(quat, bone.vector)
        quats[bone.name] = quat
    return starts, quats


def skeleton_path(path: Path) -> Path:
    """The .asf beside ``path``: the longest one whose name starts the motion's."""
    fits = [
        item for item in path.parent.glob("*.asf") if path.stem.startswith(item.stem)
    ]
    if not fits:
        raise InputError(
            "no .asf skeleton beside it",
            where=str(path),
            remedy="put the actor's .asf (e.g. HDM_bd.asf) into the same folder",
        )
    return max(fits, key=lambda item: len(item.stem))


def read(path: Path) -> HumanMotion:
    """Read an AMC file with the ASF skeleton beside it.

    The frame rate is the number at the end of a name like HDM05's
    (``..._001_120.amc``), else 120.

    Raises:
        InputError: a file is missing, truncated, malformed, or they do not fit.
    """
    skeleton = read_skeleton(skeleton_path(path))
    widths = {bone.name: len(bone.dofs) for bone in skeleton.bones if bone.dofs}
    widths["root"] = 6
    frames = _read_frames(path, widths)
    count = len(frames["root"])
    item = skeleton.item
    bones = {bone.name for bone in skeleton.bones}
    names = [next(n for n in item.names[joint] if n in bones) for joint in JOINTS]
    positions = np.empty((count, len(JOINTS), 3))
    quats = np.empty((count, len(JOINTS), 4))
    with np.errstate(all="ignore"):
        for start in range(0, count, _CHUNK):
            part = slice(start, start + _CHUNK)
            starts, turns = _pose(skeleton, {n: v[part] for n, v in frames.items()})
            positions[part] = np.stack([starts[name] for name in names], 1)
            quats[part] = np.stack([turns[name] for name in names], 1)
        assert item.world is not None  # maps of this format name their axes
        positions = (positions * skeleton.metres) @ item.world.T
        quats = to_body_axes(quats, item)
        rate = re.search(r"_\d{3}_(\d{2,3})$", path.stem)
        fps = float(rate.group(1)) if rate else DEFAULT_FPS
        return make_motion(path.stem, fps, positions, quats, f"{path}, line 1")
