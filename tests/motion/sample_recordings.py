"""A small human motion, and files of every format that describe it.

The motion is worked out with SciPy's rotations, not with OpenClone's, and written by
these few lines, so the readers are compared with something independent of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

# joint: parent, offset in metres; x forward, y left, z up: a T-pose of 1.7 m.
BODY: dict[str, tuple[str, tuple[float, float, float]]] = {
    "hips": ("", (0, 0, 0)),
    "chest": ("hips", (0, 0, 0.25)),
    "neck": ("chest", (0, 0, 0.25)),
    "head": ("neck", (0.02, 0, 0.10)),
    "left_shoulder": ("chest", (0, 0.18, 0.20)),
    "left_elbow": ("left_shoulder", (0, 0.28, 0)),
    "left_wrist": ("left_elbow", (0, 0.25, 0)),
    "right_shoulder": ("chest", (0, -0.18, 0.20)),
    "right_elbow": ("right_shoulder", (0, -0.28, 0)),
    "right_wrist": ("right_elbow", (0, -0.25, 0)),
    "left_hip": ("hips", (0, 0.09, 0)),
    "left_knee": ("left_hip", (0, 0, -0.42)),
    "left_ankle": ("left_knee", (0, 0, -0.41)),
    "left_toe": ("left_ankle", (0.13, 0, -0.07)),
    "right_hip": ("hips", (0, -0.09, 0)),
    "right_knee": ("right_hip", (0, 0, -0.42)),
    "right_ankle": ("right_knee", (0, 0, -0.41)),
    "right_toe": ("right_ankle", (0.13, 0, -0.07)),
}
NAMES = list(BODY)


def _named(text: str) -> dict[str, str]:
    """Joint of `BODY` -> its name in some file format."""
    return dict(zip(NAMES, text.split(), strict=True))


ACCAD = _named(
    "Hips Spine1 Neck Head LeftArm LeftForeArm LeftHand RightArm RightForeArm "
    "RightHand LeftUpLeg LeftLeg LeftFoot LeftToeBase RightUpLeg RightLeg "
    "RightFoot RightToeBase"
)
XSENS = _named(
    "Hips Chest4 Neck Head LeftShoulder LeftElbow LeftWrist RightShoulder "
    "RightElbow RightWrist LeftHip LeftKnee LeftAnkle LeftToe RightHip RightKnee "
    "RightAnkle RightToe"
)
ASF = _named(
    "root thorax lowerneck head lhumerus lradius lhand rhumerus rradius rhand "
    "lfemur ltibia lfoot ltoes rfemur rtibia rfoot rtoes"
)
SEGMENTS = _named(
    "Pelvis T8 Neck Head LeftUpperArm LeftForeArm LeftHand RightUpperArm "
    "RightForeArm RightHand LeftUpperLeg LeftLowerLeg LeftFoot LeftToe "
    "RightUpperLeg RightLowerLeg RightFoot RightToe"
)
Y_UP = np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]])
"""World (x forward, z up) from a file with x left, y up, z forward."""
Z_UP = np.eye(3)


@dataclass(frozen=True)
class Truth:
    """A motion: local and global rotations and positions of every joint of `BODY`."""

    fps: float
    local: dict[str, Rotation]
    turn: dict[str, Rotation]
    place: dict[str, np.ndarray]

    @property
    def frames(self) -> int:
        return len(self.place["hips"])


def make_truth(frames: int = 6, fps: float = 60.0, swing: float = 0.4) -> Truth:
    """Every joint swings about an axis of its own while the body walks a curve."""
    rng = np.random.default_rng(5)
    time = np.arange(frames) / fps
    local, turn, place = {}, {}, {}
    for name, (parent, offset) in BODY.items():
        axis = rng.normal(size=3)
        angle = swing * np.sin(2 * time + rng.uniform(0, 6))
        local[name] = Rotation.from_rotvec(angle[:, None] * axis / np.linalg.norm(axis))
        if not parent:
            path = np.stack((time, 0.3 * np.sin(time), 0.92 + 0 * time), 1)
            turn[name], place[name] = local[name], path
            continue
        turn[name] = turn[parent] * local[name]
        place[name] = place[parent] + turn[parent].apply(np.array(offset, float))
    return Truth(fps, local, turn, place)


def _children(name: str) -> list[str]:
    return [child for child, (parent, _) in BODY.items() if parent == name]


def bvh(
    truth: Truth,
    *,
    names: dict[str, str] = ACCAD,
    order: str = "ZXY",
    channels: int = 3,
    unit: float = 0.01,
    world: np.ndarray = Y_UP,
    axes: dict[str, np.ndarray] | None = None,
    added: bool = False,
    prefix: str = "",
) -> str:
    """BVH text.

    Args:
        truth: the motion.
        names: joint names in the file.
        order: Euler order of the channels.
        channels: 3 or 6 for the joints below the root.
        unit: metres per file unit.
        world: canonical world from file world.
        axes: T-pose body axes from a joint's axes; those of the world if None.
        added: 6 channels hold the displacement from OFFSET, not the whole.
        prefix: put before every name.
    """
    frame = {name: (axes or {}).get(name, world) for name in NAMES}
    matrix = {n: world.T @ truth.turn[n].as_matrix() @ frame[n] for n in NAMES}
    lines, rows = ["HIERARCHY"], []
    rotation = " ".join(f"{letter}rotation" for letter in order)
    position = "Xposition Yposition Zposition "

    def add(name: str, depth: int) -> None:
        parent, offset = BODY[name]
        pad = "\t" * depth
        local = frame[parent].T @ np.array(offset, float) / unit if parent else [0] * 3
        six = channels == 6 or not parent
        kind = f"{pad}JOINT" if parent else "ROOT"
        lines.extend([f"{kind} {prefix}{names[name]}", pad + "{"])
        lines.append(f"{pad}\tOFFSET " + " ".join(f"{x:.9f}" for x in local))
        text = f"6 {position}{rotation}" if six else f"3 {rotation}"
        lines.append(f"{pad}\tCHANNELS {text}")
        if not parent:
            rows.append(truth.place[name] @ world / unit)
            rows.append(Rotation.from_matrix(matrix[name]).as_euler(order, True))
        else:
            if six:
                whole = np.zeros(3) if added else np.asarray(local)
                rows.append(np.tile(whole, (truth.frames, 1)))
            turn = np.swapaxes(matrix[parent], 1, 2) @ matrix[name]
            rows.append(Rotation.from_matrix(turn).as_euler(order, True))
        for child in _children(name):
            add(child, depth + 1)
        if not _children(name):
            lines.extend([f"{pad}\tEnd Site", pad + "\t{"])
            lines.extend([f"{pad}\t\tOFFSET 0 1 0", pad + "\t}"])
        lines.append(pad + "}")

    add("hips", 0)
    lines += ["MOTION", f"Frames: {truth.frames}", f"Frame Time: {1 / truth.fps:.9f}"]
    values = np.concatenate(rows, axis=1)
    lines += [" ".join(f"{x:.9f}" for x in row) for row in values]
    return "\n".join(lines) + "\n"


def asf(*, angle: str = "deg", root_order: str = "TX TY TZ RX RY RZ") -> str:
    """An Acclaim skeleton in units of 1 m, Y up; bones without length turn."""
    lines = [":version 1.10", ":units", "  length 0.0254", f"  angle {angle}"]
    lines += [":root", f"  order {root_order}", "  axis XYZ", ":bonedata"]
    hierarchy = []
    for name, (parent, offset) in BODY.items():
        if not parent:
            continue
        link = f"{ASF[parent]}_{ASF[name]}"
        x, y, z = Y_UP.T @ np.array(offset, float)
        size = float(np.linalg.norm(offset))
        lines += ["  begin", f"    name {link}"]
        lines += [f"    direction {x / size} {y / size} {z / size}"]
        lines += [f"    length {size}", "    axis 0 0 0 XYZ", "  end"]
        lines += ["  begin", f"    name {ASF[name]}", "    direction 0 1 0"]
        lines += ["    length 0", "    axis 0 0 0 XYZ", "    dof rx ry rz", "  end"]
        hierarchy += [f"    {ASF[parent]} {link}", f"    {link} {ASF[name]}"]
    return "\n".join([*lines, ":hierarchy", "  begin", *hierarchy, "  end"]) + "\n"


def amc(truth: Truth, *, degrees: bool = True, root_first: bool = True) -> str:
    """The motion for `asf`; the root's rotations may come before its position."""
    lines = ["#!a comment", ":FULLY-SPECIFIED", ":DEGREES" if degrees else ":RADIANS"]
    turn = {
        name: Rotation.from_matrix(
            Y_UP.T @ truth.local[name].as_matrix() @ Y_UP
        ).as_euler("xyz", degrees)
        for name in NAMES
    }
    place = truth.place["hips"] @ Y_UP
    for frame in range(truth.frames):
        lines.append(str(frame + 1))
        for name in NAMES:
            parts = [turn[name][frame]]
            if name == "hips":
                parts.insert(0 if root_first else 1, place[frame])
            values = " ".join(f"{x:.9f}" for x in np.concatenate(parts))
            lines.append(f"{ASF[name]} {values}")
    return "\n".join(lines) + "\n"


def mvnx(truth: Truth) -> str:
    """MVNX text with two calibration frames before the motion."""
    labels = list(SEGMENTS.values())
    head = '<?xml version="1.0" encoding="UTF-8"?>\n'
    head += '<mvnx xmlns="http://www.xsens.com/mvn/mvnx" version="4">\n'
    head += f'<subject label="a" frameRate="{truth.fps:g}" segmentCount="18">\n'
    head += "<segments>\n"
    for index, label in enumerate(labels, 1):
        head += f'<segment label="{label}" id="{index}"><points/></segment>\n'
    lines = [head + "</segments>\n<frames>"]
    zeros = " ".join("0" for _ in range(54))
    still = " ".join("1 0 0 0" for _ in labels)
    for kind in ("identity", "tpose"):
        lines.append(f'<frame time="0" type="{kind}">')
        lines.append(f"<orientation>{still}</orientation>")
        lines.append(f"<position>{zeros}</position></frame>")
    for frame in range(truth.frames):
        quats = np.stack([truth.turn[n].as_quat()[frame] for n in NAMES])
        places = np.stack([truth.place[n][frame] for n in NAMES])
        lines.append(f'<frame time="{frame * 17}" type="normal" index="{frame}">')
        for name, values in (
            ("orientation", quats[:, [3, 0, 1, 2]]),
            ("position", places),
            ("velocity", 0 * places),
        ):
            text = " ".join(f"{x:.9f}" for x in values.ravel())
            lines.append(f"<{name}>{text}</{name}>")
        lines.append("</frame>")
    return "\n".join([*lines, "</frames>\n</subject>\n</mvnx>"]) + "\n"


def deepmimic(frames: int = 6) -> str:
    """DeepMimic text: upright, arms hanging, one knee bending."""
    rows = []
    for index in range(frames):
        row = [0.0] * 44
        row[0], row[2], row[20] = 0.0333, 0.9, -0.1 * index
        for column in (4, 8, 12, 16, 21, 25, 30, 35, 39):
            row[column] = 1.0
        rows.append("[" + ", ".join(f"{x:.6f}" for x in row) + "]")
    head = '{\n"Loop": "none",\n"RightJoints": [3, 4, 5],\n\n"Frames":\n[\n'
    return head + ",\n".join(rows) + "\n]\n}\n"


def g1_csv(frames: int = 6) -> str:
    """G1 CSV text: standing, the left shoulder pitching."""
    rows = []
    for index in range(frames):
        row = [0.0] * 36
        row[2], row[6], row[7 + 15] = 0.79, 1.0, 0.05 * index
        rows.append(",".join(f"{x:.6f}" for x in row))
    return "\n".join(rows) + "\n"
