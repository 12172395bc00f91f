"""Skeleton maps: what a file's joints are called and how they stand in the T-pose.

A map is a TOML file, so a new skeleton needs no code. The shipped ones lie in
``skeletons/``; a file ``NAME.skeleton.toml`` beside a recording is tried before them.

Directions are words seen from the body in its T-pose: forward, back, left, right, up,
down. ``axes = "left up forward"`` says that x points left, y up and z forward. Where a
map of a BVH skeleton says ``"rest"``, the joints' axes are those of the file's world in
the rest pose (the pose without rotations), and the rest pose tells which way it faces.
"""

from __future__ import annotations

import tomllib
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from openclone.errors import InputError
from openclone.motion.skeleton import JOINTS
from openclone.spatial import rotations

FOLDER = Path(__file__).parent / "skeletons"
SUFFIX = ".skeleton.toml"
REST = "rest"
FORMATS = ("bvh", "asf", "mvnx", "amass", "deepmimic")
KINDS = {"fixed": 0, "hinge_z": 1, "quaternion": 4, "rotation_vector": 3}
"""Columns that one joint of a fixed skeleton takes in the file."""
MAX_BYTES = 65_536
MAX_FIXED_JOINTS = 128
_KEYS = {"format", "world", "axes", "names", "axes_of", "joints"}
_DIRECTIONS = {
    "forward": (1.0, 0.0, 0.0),
    "back": (-1.0, 0.0, 0.0),
    "left": (0.0, 1.0, 0.0),
    "right": (0.0, -1.0, 0.0),
    "up": (0.0, 0.0, 1.0),
    "down": (0.0, 0.0, -1.0),
}


@dataclass(frozen=True)
class FixedJoint:
    """One joint of a skeleton whose bone lengths the file does not hold.

    Attributes:
        name: its name; canonical joints have canonical names.
        parent: index of the parent, -1 for the root; parents come first.
        offset: metres from the parent, file axes.
        column: first column of its rotation.
        kind: key of `KINDS`; a hinge turns about z.
    """

    name: str
    parent: int
    offset: tuple[float, float, float]
    column: int
    kind: str


@dataclass(frozen=True)
class SkeletonMap:
    """How a file's skeleton becomes the canonical one.

    Attributes:
        path: the TOML file.
        format: one of `FORMATS`.
        world: (3, 3), canonical world from the file's world; None for "rest".
        axes: canonical joint -> (3, 3), T-pose body axes from the joint's axes; empty
            for "rest".
        names: canonical joint -> names in files, the first one present wins.
        joints: the fixed skeleton; empty where the file holds its own.
    """

    path: Path
    format: str
    world: np.ndarray | None
    axes: dict[str, np.ndarray]
    names: dict[str, tuple[str, ...]]
    joints: tuple[FixedJoint, ...]


def direction_matrix(text: object, where: str) -> np.ndarray:
    """(3, 3) matrix whose columns are the directions that x, y and z point to."""
    words = text.split() if isinstance(text, str) else []
    columns = [_DIRECTIONS.get(word) for word in words]
    known = [column for column in columns if column is not None]
    if len(words) == len(known) == 3:
        matrix = np.array(known).T
        if abs(np.linalg.det(matrix) - 1.0) < 1e-9:
            return matrix
    raise InputError(
        f"{text!r} are no right-handed axes",
        where=where,
        remedy="name where x, y and z point, such as 'left up forward'",
    )


def _axes(value: object, where: str) -> np.ndarray:
    """Axes from words, or from ``{axes = words, turn_z_deg = angle}``."""
    if not isinstance(value, dict):
        return direction_matrix(value, where)
    angle = value.get("turn_z_deg", 0.0)
    if set(value) - {"axes", "turn_z_deg"} or not isinstance(angle, (int, float)):
        raise InputError("unknown entry", where=where, remedy="use axes and turn_z_deg")
    turn = rotations.from_axis_angle(np.array([0.0, 0, 1]), np.radians(float(angle)))
    return direction_matrix(value.get("axes"), where) @ rotations.to_matrix(turn)


def _names(table: object, where: str) -> dict[str, tuple[str, ...]]:
    if not isinstance(table, dict) or set(table) != set(JOINTS):
        raise InputError(
            "the table [names] lacks joints or has others",
            where=where,
            remedy="name exactly " + ", ".join(JOINTS),
        )
    names = {}
    for joint in JOINTS:
        value = table[joint]
        items = [value] if isinstance(value, str) else value
        if not isinstance(items, list) or not all(isinstance(x, str) for x in items):
            raise InputError(
                f"names.{joint} is no list of names", where=where, remedy="repair it"
            )
        names[joint] = tuple(items)
    return names


def _fixed_joints(table: object, where: str) -> tuple[FixedJoint, ...]:
    if not isinstance(table, dict) or not 1 <= len(table) <= MAX_FIXED_JOINTS:
        raise InputError("no table [joints]", where=where, remedy="list the joints")
    order = list(table)
    joints = []
    for index, (name, row) in enumerate(table.items()):
        place = f"{where}, joints.{name}"
        fields = row if isinstance(row, dict) else {}
        parent, offset = fields.get("parent", ""), fields.get("offset", [])
        column, kind = fields.get("column", 0), fields.get("kind", "fixed")
        good = (
            (parent in order[:index] if index else parent == "")
            and isinstance(offset, list)
            and len(offset) == 3
            and all(isinstance(x, (int, float)) and abs(x) < 10 for x in offset)
            and isinstance(column, int)
            and 0 <= column < 10_000
            and kind in KINDS
        )
        if not good:
            raise InputError(
                "not a joint",
                where=place,
                remedy="give a parent listed before it, offset = [x, y, z] in metres, "
                f"column, and kind = one of {', '.join(KINDS)}",
            )
        above = order.index(parent) if index else -1
        x, y, z = map(float, offset)
        joints.append(FixedJoint(name, above, (x, y, z), column, kind))
    missing = [joint for joint in JOINTS if joint not in order]
    if missing:
        raise InputError(f"no joint {missing[0]}", where=where, remedy="add it")
    return tuple(joints)


def _parse(path: Path) -> dict[str, Any]:
    if path.stat().st_size > MAX_BYTES:
        raise InputError("larger than 64 kB", where=str(path), remedy="shorten it")
    try:
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise InputError(
            f"not valid TOML ({error})", where=str(path), remedy="repair the map"
        ) from error
    unknown = set(table) - _KEYS
    if unknown or table.get("format") not in FORMATS:
        raise InputError(
            f"unknown entry {min(unknown)!r}" if unknown else "unknown format",
            where=str(path),
            remedy="see the maps that OpenClone ships",
        )
    return table


def load_map(path: Path) -> SkeletonMap:
    """Read and check one map.

    Raises:
        InputError: the file is no TOML, or an entry is missing or makes no sense.
    """
    table = _parse(path)
    where = str(path)
    fixed = table["format"] in ("amass", "deepmimic")
    axes: dict[str, np.ndarray] = {}
    world = None
    if table.get("axes") != REST or table.get("world") != REST:
        world = direction_matrix(table.get("world"), f"{where}, world")
        overrides = table.get("axes_of", {})
        if not isinstance(overrides, dict) or set(overrides) - set(JOINTS):
            raise InputError(
                "axes_of names an unknown joint",
                where=where,
                remedy="use " + ", ".join(JOINTS),
            )
        axes = {
            joint: _axes(overrides.get(joint, table.get("axes")), f"{where}, axes")
            for joint in JOINTS
        }
    elif table["format"] != "bvh":
        raise InputError('"rest" is for BVH only', where=where, remedy="name the axes")
    return SkeletonMap(
        path=path,
        format=table["format"],
        world=world,
        axes=axes,
        names={} if fixed else _names(table.get("names"), where),
        joints=_fixed_joints(table.get("joints"), where) if fixed else (),
    )


@cache
def _shipped() -> tuple[SkeletonMap, ...]:
    return tuple(load_map(path) for path in sorted(FOLDER.glob("*.toml")))


def map_files(recording: Path) -> list[Path]:
    """The maps that lie beside ``recording``."""
    return sorted(recording.parent.glob(f"*{SUFFIX}"))


def maps_for(kind: str, recording: Path) -> list[SkeletonMap]:
    """Maps of one format, those beside the recording first.

    Raises:
        InputError: a map beside the recording is malformed.
    """
    own = [load_map(path) for path in map_files(recording)]
    return [item for item in (*own, *_shipped()) if item.format == kind]


def to_body_axes(quats: np.ndarray, item: SkeletonMap) -> np.ndarray:
    """Turn orientations of the canonical joints into the canonical convention.

    Args:
        quats: (T, 18, 4), file world from joint.
        item: a map with axes.

    Returns:
        (T, 18, 4), world from joint, identity in the T-pose.
    """
    if item.world is None:
        raise ValueError("a map that says 'rest' has no axes of its own")
    world = np.broadcast_to(rotations.from_matrix(item.world), quats.shape)
    tpose = rotations.from_matrix(np.stack([item.axes[joint] for joint in JOINTS]))
    turned = rotations.multiply(world, quats)
    back = np.broadcast_to(rotations.conjugate(tpose), quats.shape)
    return rotations.multiply(turned, back)


def pose_fixed(
    joints: tuple[FixedJoint, ...], root: np.ndarray, values: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Pose a fixed skeleton.

    Args:
        joints: parents first.
        root: (T, 3), metres, file world: position of the first joint.
        values: (T, n) columns of rotations, as the joints' ``column`` and ``kind`` say.

    Returns:
        Positions (T, 18, 3), metres, and orientations (T, 18, 4) of the canonical
        joints, file world and file axes.
    """
    positions: list[np.ndarray] = []
    quats: list[np.ndarray] = []
    for joint in joints:
        turn = _turn(joint, values)
        if joint.parent < 0:
            positions.append(root)
            quats.append(turn)
            continue
        parent = quats[joint.parent]
        offset = np.array(joint.offset)
        positions.append(positions[joint.parent] + rotations.rotate(parent, offset))
        quats.append(rotations.multiply(parent, turn))
    order = [joint.name for joint in joints]
    chosen = [order.index(name) for name in JOINTS]
    return (
        np.stack([positions[k] for k in chosen], 1),
        np.stack([quats[k] for k in chosen], 1),
    )


def _turn(joint: FixedJoint, values: np.ndarray) -> np.ndarray:
    """(T, 4) rotation of a joint against its parent."""
    part = values[:, joint.column : joint.column + KINDS[joint.kind]]
    if joint.kind == "quaternion":
        return rotations.normalize(part)
    if joint.kind == "rotation_vector":
        return rotations.from_rotation_vector(part)
    angle = part[:, 0] if joint.kind == "hinge_z" else np.zeros(len(values))
    return rotations.from_axis_angle(np.array([0.0, 0, 1]), angle)
