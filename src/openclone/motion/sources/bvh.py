"""BVH recordings: ACCAD, CMU, LAFAN1, Xsens MVN, Mixamo and others.

The joints' names and axes come from a skeleton map; unit, Euler order, number of
channels and, in the usual maps, the directions of the axes come from the file.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from openclone.errors import InputError
from openclone.motion.skeleton import JOINTS, HumanMotion, make_motion, scale_to_metres
from openclone.motion.skeleton_maps import SkeletonMap, maps_for, to_body_axes
from openclone.motion.sources.bvh_text import Node, read_frames, read_hierarchy
from openclone.motion.sources.text_lines import Lines
from openclone.spatial import rotations

MAX_TILT_DEG = 60.0
"""Largest angle of a rest pose's spine or leg to the vertical."""
MAX_ARM_TILT_DEG = 30.0
"""Beyond this angle to the side a rest pose's arm counts as hanging."""
_CHUNK = 4096
"""Frames posed at once, which bounds the memory."""
_NAMES: dict[str, int] = {joint: index for index, joint in enumerate(JOINTS)}


def _pose(nodes: list[Node], values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
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


def _needed(
    nodes: list[Node], values: np.ndarray, chosen: list[int]
) -> tuple[list[Node], np.ndarray, list[int]]:
    """Leave out joints, such as fingers, on which no chosen joint depends."""
    keep: set[int] = set()
    for index in chosen:
        while index >= 0 and index not in keep:
            keep.add(index)
            index = nodes[index].parent
    order = sorted(keep)
    starts = np.cumsum([0] + [len(node.channels) for node in nodes])
    columns = np.concatenate([np.arange(starts[k], starts[k + 1]) for k in order])
    place = {old: new for new, old in enumerate(order)}
    kept = [replace(nodes[k], parent=place.get(nodes[k].parent, -1)) for k in order]
    return kept, values[:, columns], [place[k] for k in chosen]


def _whole_positions(nodes: list[Node], values: np.ndarray) -> None:
    """Make position channels below the root absolute, in place.

    A position channel replaces the OFFSET; but some exporters write the displacement
    from it, which is next to nothing, and would leave limbs without length.
    """
    column = 0
    for node in nodes:
        spots = [k for k, name in enumerate(node.channels) if name[1] == "p"]
        if node.parent >= 0 and len(spots) == 3:
            places = [column + k for k in spots]
            offset = node.offset[["XYZ".index(node.channels[k][0]) for k in spots]]
            size = np.linalg.norm(np.median(values[:, places], axis=0))
            if size < 0.1 * np.linalg.norm(offset):
                values[:, places] += offset
        column += len(node.channels)


def _upright_again(nodes: list[Node], values: np.ndarray) -> np.ndarray:
    """Undo a known export fault of CMU's BVH files in the root's ZYX angles.

    In such a file Z and Y have the wrong sign wherever X is beyond 90 degrees: the
    body flips over and walks on mirrored. The repair is kept only where it removes
    flips, so that sound files stay as they are.
    """
    names = nodes[0].channels
    columns = [k for k, name in enumerate(names) if name[1] == "r"]
    if "".join(names[k][0] for k in columns) != "ZYX":
        return values
    repaired = values[:, : len(names)].copy()
    beyond = np.abs(rotations.wrap_angle(np.radians(values[:, columns[2]]))) > np.pi / 2
    repaired[:, columns[:2]] *= np.where(beyond, -1.0, 1.0)[:, None]

    def flips(candidate: np.ndarray) -> int:
        quat = rotations.from_euler(np.radians(candidate[:, columns]), "ZYX")
        return int((rotations.angle_between(quat[8:], quat[:-8]) > 1.0).sum())

    if flips(repaired) < 0.8 * flips(values):
        values = np.concatenate((repaired, values[:, len(names) :]), axis=1)
    return values


def _find_joints(nodes: list[Node], item: SkeletonMap) -> list[int] | str:
    """Index of every canonical joint, or the first one that is missing."""
    names = [node.name for node in nodes]
    found = []
    for joint in JOINTS:
        match = [name for name in item.names[joint] if name in names]
        if not match:
            return joint
        found.append(names.index(match[0]))
    return found


def _rest_axes(rest: np.ndarray) -> np.ndarray | None:
    """(3, 3) body axes from file axes, judged by the rest pose ``(18, 3)``."""
    up = rest[_NAMES["neck"]] - rest[_NAMES["hips"]]
    left = rest[_NAMES["left_hip"]] - rest[_NAMES["right_hip"]]
    rows = np.zeros((3, 3))
    for row, vector in ((2, up), (1, left)):
        largest = int(np.abs(vector).argmax())
        rows[row, largest] = np.sign(vector[largest])
    rows[0] = np.cross(rows[1], rows[2])
    return rows if np.abs(rows[0]).sum() == 1 else None


def _angle_deg(a: np.ndarray, b: np.ndarray) -> float:
    """Angle of two directions; 180 if one has no length."""
    size = float(np.linalg.norm(a) * np.linalg.norm(b))
    cosine = float(a @ b) / size if size > 0 and np.isfinite(size) else -1.0
    return float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))


def _rest_pose(nodes: list[Node], chosen: list[int]) -> np.ndarray:
    """(18, 3) positions of the canonical joints without rotations, file units."""
    places = np.zeros((len(nodes), 3))
    for index, node in enumerate(nodes[1:], 1):
        places[index] = places[node.parent] + node.offset
    return places[chosen]


def _fit(rest: np.ndarray, item: SkeletonMap) -> tuple[float, SkeletonMap]:
    """How far, in degrees, the T-pose is from upright; the map with axes filled in."""
    if item.world is None:
        matrix = _rest_axes(rest)
        if matrix is None:
            return 180.0, item
        item = replace(item, world=matrix, axes=dict.fromkeys(JOINTS, matrix))
    tilts = []
    bones = [("hips", "neck", 1.0)]
    for side in ("left", "right"):
        bones += [(f"{side}_hip", f"{side}_knee", -1.0)]
        bones += [(f"{side}_knee", f"{side}_ankle", -1.0)]
    for upper, lower, sign in bones:
        bone = item.axes[upper] @ (rest[_NAMES[lower]] - rest[_NAMES[upper]])
        tilts.append(_angle_deg(bone, np.array([0.0, 0.0, sign])))
    return max(tilts), item


def _raise_arms(rest: np.ndarray, item: SkeletonMap) -> SkeletonMap:
    """Correct the axes of arms that hang in the rest pose: the T-pose has them up."""
    axes = dict(item.axes)
    for side, sign in (("left", 1.0), ("right", -1.0)):
        target = np.array([0.0, sign, 0.0])
        turn = np.eye(3)
        for upper, lower in (("shoulder", "elbow"), ("elbow", "wrist"), ("wrist", "")):
            joint = f"{side}_{upper}"
            if lower:
                bone = item.axes[joint] @ (
                    rest[_NAMES[f"{side}_{lower}"]] - rest[_NAMES[joint]]
                )
                turn = np.eye(3)
                if MAX_ARM_TILT_DEG < _angle_deg(bone, target) < 179.0:
                    axis = np.cross(bone, target)
                    angle = np.radians(_angle_deg(bone, target))
                    quat = rotations.from_axis_angle(axis / np.linalg.norm(axis), angle)
                    turn = rotations.to_matrix(quat)
            axes[joint] = turn @ item.axes[joint]
    return replace(item, axes=axes)


def choose_map(
    nodes: list[Node], path: Path, where: str
) -> tuple[SkeletonMap, list[int]]:
    """The map whose T-pose is the most upright, and the canonical joints' indices.

    Raises:
        InputError: no map knows the names, or none makes an upright body of them.
    """
    best: tuple[float, SkeletonMap, list[int]] | None = None
    missing: list[tuple[int, str, SkeletonMap]] = []
    for item in maps_for("bvh", path):
        found = _find_joints(nodes, item)
        if isinstance(found, str):
            missing.append((_NAMES[found], found, item))
            continue
        tilt, filled = _fit(_rest_pose(nodes, found), item)
        if best is None or tilt < best[0] - 1.0:
            best = (tilt, filled, found)
    if best is None:
        _, joint, item = max(missing, key=lambda entry: entry[0])
        raise InputError(
            f"no joint for {joint}",
            where=where,
            remedy="name it one of "
            + ", ".join(item.names[joint])
            + ", or put a skeleton map beside it",
        )
    tilt, item, found = best
    if tilt > MAX_TILT_DEG:
        raise InputError(
            f"the T-pose would have a leg or the spine {tilt:.0f} degrees from upright",
            where=where,
            remedy="put a skeleton map beside it that names the joints' axes",
        )
    return _raise_arms(_rest_pose(nodes, found), item), found


def _calibration_frames(positions: np.ndarray, fps: float) -> int:
    """1 when the first frame is a T-pose from which the body jumps, else 0."""
    if len(positions) < 4:
        return 0
    relative = positions[:4] - positions[:4, :1]
    jumps = np.linalg.norm(np.diff(relative[:3], axis=0), axis=-1).max(-1)
    return int(jumps[0] * fps > 10.0 and jumps[0] > 5 * jumps[1])


def read(path: Path) -> HumanMotion:
    """Read a BVH file.

    Raises:
        InputError: the file is missing, truncated, malformed or no human body.
    """
    with Lines(path) as lines, np.errstate(all="ignore"):
        nodes = read_hierarchy(lines)
        where = lines.where
        item, chosen = choose_map(nodes, path, where)
        width = sum(len(node.channels) for node in nodes)
        fps, values = read_frames(lines, width, path)
        values = _upright_again(nodes, values)
        _whole_positions(nodes, values)
        nodes, values, chosen = _needed(nodes, values, chosen)
        positions = np.empty((len(values), len(JOINTS), 3))
        quats = np.empty((len(values), len(JOINTS), 4))
        for start in range(0, len(values), _CHUNK):
            part = slice(start, start + _CHUNK)
            place, turn = _pose(nodes, values[part])
            positions[part], quats[part] = place[:, chosen], turn[:, chosen]
        leg = [JOINTS.index(f"left_{part}") for part in ("hip", "knee", "ankle")]
        bones = np.linalg.norm(np.diff(positions[0, leg], axis=0), axis=-1)
        positions *= scale_to_metres(float(bones.sum()), where)
        first = _calibration_frames(positions, fps)
        assert item.world is not None  # filled in by choose_map
        positions = (positions @ item.world.T)[first:]
        quats = to_body_axes(quats, item)[first:]
        return make_motion(path.stem, fps, positions, quats, where)
