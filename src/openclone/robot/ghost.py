"""A model for pictures: the robot and its translucent double that shows the reference.

The G1's meshes have 400 000 triangles, most of them smaller than a pixel; without a
GPU that is a third of a second per picture. They are thinned out here.
"""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np

from openclone.robot.model import add_floor, build_spec, g1_xml
from openclone.spatial import rotations

GHOST_RGBA = (0.15, 0.55, 0.95, 0.28)
PREFIX = "ghost_"
VISUAL_GROUP = 2
"""Geom group of the G1's visual meshes."""
MESH_CELL = 0.006
"""Metres; details of the meshes smaller than this are dropped."""

_STL_TRIANGLE = np.dtype(
    [("normal", "<f4", 3), ("corners", "<f4", (3, 3)), ("attribute", "<u2")]
)


def read_stl(path: Path) -> np.ndarray:
    """Triangles ``(n, 3, 3)`` of a binary STL file, metres."""
    return np.fromfile(path, _STL_TRIANGLE, offset=84)["corners"]


def _join(triples: np.ndarray) -> np.ndarray:
    """Pack integers ``(n, 3)`` of up to 20 bits into one ``(n,)``, fast to sort."""
    low = triples - triples.min(axis=0)
    return (low[:, 0] << 40) | (low[:, 1] << 20) | low[:, 2]


def thin_out(triangles: np.ndarray, cell: float) -> tuple[np.ndarray, np.ndarray]:
    """Merge all corners that share a cubic cell and drop what collapses.

    Args:
        triangles: (n, 3, 3), metres.
        cell: edge of the cells, metres.

    Returns:
        Vertices (v, 3), the mean of each cell's corners, and faces (f, 3).
    """
    corners = triangles.reshape(-1, 3).astype(np.float64)
    keys = _join(np.floor(corners / cell).astype(np.int64))
    _, owner = np.unique(keys, return_inverse=True)
    counts = np.bincount(owner)
    columns = [np.bincount(owner, corners[:, k]) / counts for k in range(3)]
    faces = owner.reshape(-1, 3)
    a, b, c = faces.T
    faces = faces[(a != b) & (b != c) & (c != a)]
    # Corners of one cell may come from both sides of a thin wall: keep one of each.
    _, first = np.unique(_join(np.sort(faces, axis=1)), return_index=True)
    return np.stack(columns, axis=1), faces[np.sort(first)]


def _thin_out_meshes(specs: tuple[mujoco.MjSpec, ...], cell: float) -> None:
    """Replace the mesh files of equal ``specs`` by thinned-out vertices and faces."""
    folder = g1_xml().parent / specs[0].meshdir
    for twins in zip(*(spec.meshes for spec in specs), strict=True):
        vertices, faces = thin_out(read_stl(folder / twins[0].file), cell)
        for mesh in twins:
            mesh.file = ""
            mesh.uservert = vertices.reshape(-1)
            mesh.userface = faces.reshape(-1)


def build_picture_model(cell: float = MESH_CELL) -> mujoco.MjModel:
    """The robot alone, without a floor; ``cell`` as in `thin_out`."""
    spec = build_spec()
    _thin_out_meshes((spec,), cell)
    return spec.compile()


def visual_mesh(model: mujoco.MjModel, body: int) -> tuple[np.ndarray, np.ndarray]:
    """All visual meshes of a body as one: vertices ``(v, 3)`` in its frame, faces.

    Args:
        model: with the G1's bodies.
        body: its number.
    """
    vertices, faces, count = [np.empty((0, 3))], [np.empty((0, 3), dtype=int)], 0
    for geom in np.flatnonzero(model.geom_bodyid == body):
        mesh = int(model.geom_dataid[geom])
        if model.geom_group[geom] != VISUAL_GROUP or mesh < 0:
            continue
        first, size = int(model.mesh_vertadr[mesh]), int(model.mesh_vertnum[mesh])
        corner, sides = int(model.mesh_faceadr[mesh]), int(model.mesh_facenum[mesh])
        turn = np.tile(model.geom_quat[geom], (size, 1))
        local = model.mesh_vert[first : first + size].astype(float)
        vertices.append(rotations.rotate(turn, local) + model.geom_pos[geom])
        faces.append(model.mesh_face[corner : corner + sides] + count)
        count += size
    return np.concatenate(vertices), np.concatenate(faces)


def build_ghost_model() -> mujoco.MjModel:
    """Robot, floor, sky and ghost; ``qpos`` (72,) is the robot's, then the ghost's.

    For `mujoco.mj_kinematics` only: the ghost has no motors and touches nothing.
    """
    spec = build_spec()
    add_floor(spec)
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[0.93, 0.95, 0.98],
        rgb2=[0.62, 0.70, 0.80],
        width=256,
        height=256 * 6,
    )
    ghost = build_spec()
    _thin_out_meshes((spec, ghost), MESH_CELL)
    for element in [*ghost.actuators, *ghost.sensors]:
        ghost.delete(element)
    for geom in list(ghost.geoms):
        if geom.group != VISUAL_GROUP:
            ghost.delete(geom)
            continue
        geom.material = ""
        geom.rgba = list(GHOST_RGBA)
        geom.contype = geom.conaffinity = 0
    spec.attach(ghost, prefix=PREFIX, frame=spec.worldbody.add_frame())
    spec.visual.headlight.ambient = [0.35, 0.35, 0.35]
    spec.visual.headlight.diffuse = [0.55, 0.55, 0.55]
    spec.visual.global_.offwidth, spec.visual.global_.offheight = 1280, 960
    return spec.compile()


def ghost_qpos(robot: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Both robots' positions ``(..., 36)`` as the model's ``(..., 72)``."""
    return np.concatenate((robot, reference), axis=-1)
