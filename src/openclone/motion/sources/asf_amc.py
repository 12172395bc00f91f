"""ASF/AMC recordings (Acclaim format; HDM05): a skeleton file and a motion file."""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from openclone.errors import InputError
from openclone.motion.skeleton import JOINTS, MAX_FRAMES, HumanMotion, make_motion
from openclone.motion.sources.bvh import MAX_BYTES, Z_UP, Z_UP_QUAT
from openclone.spatial import rotations

INCH = 0.0254
DEFAULT_FPS = 120.0
BONE_NAMES = {
    "hips": "root",
    "chest": "thorax",
    "neck": "lowerneck",
    "head": "head",
    **{
        f"{side}_{joint}": side[0] + bone
        for side in ("left", "right")
        for joint, bone in (
            ("hip", "femur"),
            ("knee", "tibia"),
            ("ankle", "foot"),
            ("toe", "toes"),
            ("shoulder", "humerus"),
            ("elbow", "radius"),
            ("wrist", "hand"),
        )
    },
}
"""Canonical joint -> the bone that starts there."""


@dataclass
class _Bone:
    """One bone: ``vector`` is direction times length, file units, file axes."""

    name: str
    vector: np.ndarray = field(default_factory=lambda: np.zeros(3))
    axis: np.ndarray = field(default_factory=lambda: np.array(rotations.IDENTITY))
    dofs: tuple[str, ...] = ()
    parent: str = ""


def _numbers(words: list[str], count: int, where: str) -> np.ndarray:
    try:
        values = np.array(words[:count], dtype=float)
    except ValueError:
        values = np.array([np.nan])
    if len(values) != count or not np.isfinite(values).all():
        raise InputError(
            f"expected {count} finite numbers",
            where=where,
            remedy="the file is truncated or damaged; copy it again",
        )
    return values


def _euler(angles: np.ndarray, order: str) -> np.ndarray:
    """Acclaim angles in degrees turn about *fixed* axes, the first named first."""
    return rotations.from_euler(np.radians(angles[..., ::-1]), order[::-1])


def _read_lines(path: Path) -> list[str]:
    if not path.is_file():
        raise InputError(
            "no such file",
            where=str(path),
            remedy="an .amc file needs its .asf skeleton beside it",
        )
    if path.stat().st_size > MAX_BYTES:
        raise InputError("larger than 512 MB", where=str(path), remedy="split it")
    text = path.read_text(encoding="latin-1")
    return [line.split("#")[0].strip() for line in text.splitlines()]


def _read_bone(lines: list[str], first: int, last: int, path: Path) -> _Bone:
    """The bone between the lines ``begin`` and ``end``."""
    bone = _Bone("")
    direction, length = np.zeros(3), 0.0
    for number in range(first, last):
        words = lines[number].split()
        where = f"{path}, line {number + 1}"
        match words[:1]:
            case ["name"]:
                bone.name = words[1] if len(words) > 1 else ""
            case ["direction"]:
                direction = _numbers(words[1:], 3, where)
            case ["length"]:
                length = float(_numbers(words[1:], 1, where)[0])
            case ["axis"]:
                order = words[4].upper() if len(words) > 4 else "XYZ"
                if sorted(order) != ["X", "Y", "Z"]:
                    raise InputError(
                        f"unknown order of axes {order[:20]!r}",
                        where=where,
                        remedy="write XYZ or another order of the three",
                    )
                bone.axis = _euler(_numbers(words[1:], 3, where), order)
            case ["dof"]:
                bone.dofs = tuple(word.lower() for word in words[1:])
                if not set(bone.dofs) <= {"rx", "ry", "rz"}:
                    raise InputError(
                        f"unsupported degrees of freedom {' '.join(words[1:])[:40]!r}",
                        where=where,
                        remedy="only rx, ry and rz are supported",
                    )
    if not bone.name:
        raise InputError(
            "a bone without a name", where=f"{path}, line {first}", remedy="name it"
        )
    bone.vector = direction * length
    return bone


def read_skeleton(path: Path) -> tuple[list[_Bone], float]:
    """Bones of an ASF file, parents first, and metres per file unit."""
    lines = _read_lines(path)
    bones = {"root": _Bone("root")}
    scale, section, number = 1.0, "", 0
    while number < len(lines):
        words = lines[number].split()
        where = f"{path}, line {number + 1}"
        if words and words[0].startswith(":"):
            section = words[0][1:]
        elif words[:1] == ["length"] and section == "units":
            scale = float(_numbers(words[1:], 1, where)[0])
        elif words == ["begin"] and section == "bonedata":
            last = number
            while last < len(lines) and lines[last] != "end":
                last += 1
            bone = _read_bone(lines, number + 1, last, path)
            bones[bone.name] = bone
            number = last
        elif words and section == "hierarchy" and words[0] not in ("begin", "end"):
            for child in words[1:]:
                if child not in bones or words[0] not in bones:
                    raise InputError(
                        f"unknown bone in {' '.join(words)[:60]!r}",
                        where=where,
                        remedy="describe every bone under :bonedata",
                    )
                bones[child].parent = words[0]
        number += 1
    if not 1e-6 < scale < 1e6:
        raise InputError(f"unit length {scale:g}", where=str(path), remedy="repair it")
    return _parents_first(bones, path), INCH / scale


def _parents_first(bones: dict[str, _Bone], path: Path) -> list[_Bone]:
    for joint, name in BONE_NAMES.items():
        if name not in bones:
            raise InputError(
                f"no bone {name!r} for {joint}",
                where=str(path),
                remedy="use the bone names of HDM05 or CMU skeletons",
            )
    ordered, names = [bones["root"]], {"root"}
    waiting = [bone for bone in bones.values() if bone.name != "root"]
    while waiting:
        ready = [bone for bone in waiting if bone.parent in names]
        if not ready:
            raise InputError(
                f"bone {waiting[0].name!r} does not hang on the root",
                where=str(path),
                remedy="complete the :hierarchy section",
            )
        ordered += ready
        names |= {bone.name for bone in ready}
        waiting = [bone for bone in waiting if bone.name not in names]
    return ordered


def _read_frames(path: Path, widths: dict[str, int]) -> dict[str, np.ndarray]:
    """Values of each moving bone, ``(T, width)``, degrees (root: position first)."""
    rows: dict[str, list[np.ndarray]] = {name: [] for name in widths}
    frames = 0
    lines = _read_lines(path)
    for number, line in enumerate(lines, 1):
        words = line.split()
        where = f"{path}, line {number}"
        if not words or words[0].startswith(":"):
            continue
        if len(words) == 1:
            _check_complete(rows, frames, where)
            frames += 1
            if words[0] != str(frames) or frames > MAX_FRAMES:
                raise InputError(
                    f"expected frame {frames}, found {words[0][:20]!r}",
                    where=where,
                    remedy="frames count up from 1; copy the file again",
                )
        elif words[0] not in widths or len(words) != widths[words[0]] + 1:
            raise InputError(
                f"{words[0][:40]!r} with {len(words) - 1} values does not fit the "
                "skeleton",
                where=where,
                remedy="use the .asf file that belongs to this recording",
            )
        else:
            rows[words[0]].append(_numbers(words[1:], len(words) - 1, where))
    where = f"{path}, line {len(lines)}"
    _check_complete(rows, frames, where)
    if not frames:
        raise InputError(
            "there are no frames",
            where=where,
            remedy="the file is truncated; copy it again",
        )
    return {name: np.array(values) for name, values in rows.items()}


def _check_complete(rows: dict[str, list[np.ndarray]], frames: int, where: str) -> None:
    missing = [name for name, values in rows.items() if len(values) != frames]
    if missing:
        raise InputError(
            f"frame {frames} lacks {missing[0]!r} or holds it twice",
            where=where,
            remedy="the file is truncated; copy it again",
        )


def _pose(
    bones: list[_Bone], frames: dict[str, np.ndarray]
) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    """Start point (file units) and orientation of every bone, in the file's axes."""
    root = frames["root"]
    starts = {"root": root[:, :3]}
    ends = {"root": root[:, :3]}
    quats = {"root": _euler(root[:, 3:], "XYZ")}
    for bone in bones[1:]:
        parent = quats[bone.parent]
        quat = parent
        if bone.dofs:
            order = "".join(dof[1].upper() for dof in bone.dofs)
            turn = _euler(frames[bone.name], order)
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

    The frame rate is the number at the end of the name (``..._120.amc``), else 120.

    Raises:
        InputError: a file is missing, truncated, malformed, or they do not fit.
    """
    bones, scale = read_skeleton(skeleton_path(path))
    widths = {bone.name: len(bone.dofs) for bone in bones if bone.dofs}
    widths["root"] = 6
    starts, quats = _pose(bones, _read_frames(path, widths))
    names = [BONE_NAMES[joint] for joint in JOINTS]
    position = np.stack([starts[name] for name in names], 1) * scale
    quat = np.stack([quats[name] for name in names], 1)
    turn = np.broadcast_to(Z_UP_QUAT, quat.shape)
    quat = rotations.multiply(rotations.multiply(turn, quat), rotations.conjugate(turn))
    rate = re.search(r"_(\d{2,3})$", path.stem)
    fps = float(rate.group(1)) if rate else DEFAULT_FPS
    return make_motion(path.stem, fps, position @ Z_UP.T, quat, str(path))
