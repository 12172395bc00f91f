"""The world that robots train in: flat ground, rough ground and low obstacles.

All robots of a task share one world (Table A2, terrain type). Flat ground is the plane
at z = 0; the other kinds lie on a plateau far away, so that the plane never touches a
foot there. A robot's origin says where in this world its reference's origin lies, and
the task subtracts it again: rewards and policies see the same numbers everywhere.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import mujoco
import numpy as np

from openclone.errors import InputError
from openclone.robot import g1
from openclone.robot.model import Feet, add_floor, build_spec

TerrainKind = Literal["flat", "rough", "obstacles"]

CELL = 0.1
"""Metres between points of the height field."""
PATCH = 16.0
"""Metres; side of the square of one kind of terrain."""
ROUGHNESS = 0.02
"""Metres; rough ground lies between -ROUGHNESS and +ROUGHNESS."""
OBSTACLE_HEIGHT = 0.05
"""Metres; highest obstacle. Table A2 names the kinds, not their sizes."""
_BUMP = 0.3
_OBSTACLE_AREA = 0.25
_PLATEAU = np.array([100.0, 0.0, 1.0])
_START = 4.0
_STANCE = 0.35
_FIELD = "terrain"


@dataclass(frozen=True)
class Terrain:
    """Heights of the patches of uneven ground, side by side along x.

    Attributes:
        kinds: kinds of ground that robots are spread over, "flat" included.
        patches: the uneven kinds, one patch each, in the order of ``heights``.
        heights: (rows along y, columns along x), metres above the plateau.
    """

    kinds: tuple[TerrainKind, ...]
    patches: tuple[TerrainKind, ...]
    heights: np.ndarray

    def origins(
        self, ids: np.ndarray, start: np.ndarray, rng: np.random.Generator
    ) -> np.ndarray:
        """World positions of the reference's origin for new episodes.

        Args:
            ids: robots; robot i walks on ``kinds[i % len(kinds)]``.
            start: (len(ids), 2), metres, where the robots start in the reference.
            rng: chooses the place on the patch.

        Returns:
            (len(ids), 3), metres; z lifts the start above the ground below it.
        """
        origins = np.zeros((len(ids), 3))
        for index, kind in enumerate(self.patches):
            chosen = np.flatnonzero(
                [self.kinds[robot % len(self.kinds)] == kind for robot in ids]
            )
            place = rng.uniform(-_START, _START, (len(chosen), 2))
            place += self._centre(index)
            origins[chosen, :2] = place - start[chosen]
            origins[chosen, 2] = _PLATEAU[2]
        return origins

    def clearance(self, position: np.ndarray) -> np.ndarray:
        """Highest ground under a standing robot, metres above its origin's level.

        Args:
            position: (k, 2), metres, world.

        Returns:
            (k,): 0 on flat ground.
        """
        reach = round(_STANCE / CELL)
        rows, columns = self.heights.shape
        corner = _PLATEAU[:2] - 0.5 * CELL * np.array([columns - 1, rows - 1])
        cells = np.round((position - corner) / CELL).astype(int)
        lift = np.zeros(len(position))
        for index, (column, row) in enumerate(cells):
            if 0 <= column < columns and 0 <= row < rows:
                window = self.heights[
                    max(row - reach, 0) : row + reach + 1,
                    max(column - reach, 0) : column + reach + 1,
                ]
                lift[index] = window.max()
        return lift

    def _centre(self, index: int) -> np.ndarray:
        offset = (index + 0.5 - 0.5 * len(self.patches)) * PATCH
        return _PLATEAU[:2] + np.array([offset, 0.0])


def build_terrain(
    kinds: tuple[TerrainKind, ...], rng: np.random.Generator
) -> Terrain | None:
    """Random heights for the uneven ones of ``kinds``; None if all ground is flat."""
    patches: tuple[TerrainKind, ...] = tuple(
        kind for kind in dict.fromkeys(kinds) if kind != "flat"
    )
    if not patches:
        return None
    makers = {"rough": _rough, "obstacles": _obstacles}
    heights = np.concatenate([makers[kind](rng) for kind in patches], axis=1)
    return Terrain(kinds, patches, heights)


def _rough(rng: np.random.Generator) -> np.ndarray:
    """Bumps with 0.3 m between independent heights, joined by straight lines."""
    count = round(PATCH / CELL)
    knots = rng.uniform(-ROUGHNESS, ROUGHNESS, (round(PATCH / _BUMP) + 2,) * 2)
    at = np.arange(count) * CELL / _BUMP
    low, part = at.astype(int), at % 1.0
    rows = knots[low] * (1 - part)[:, None] + knots[low + 1] * part[:, None]
    return rows[:, low] * (1 - part) + rows[:, low + 1] * part


def _obstacles(rng: np.random.Generator) -> np.ndarray:
    """Low blocks of 0.3 to 1 m on flat ground; their edges are one cell wide."""
    count = round(PATCH / CELL)
    heights = np.zeros((count, count))
    while (heights > 0).mean() < _OBSTACLE_AREA:
        row, column = rng.integers(0, count, 2)
        depth, width = rng.integers(3, 11, 2)
        block = heights[row : row + depth, column : column + width]
        block[:] = rng.uniform(0.01, OBSTACLE_HEIGHT)
    return heights


def build_training_model(
    terrain: Terrain | None = None,
    *,
    feet: Feet = "spheres",
    file: Path | None = None,
) -> mujoco.MjModel:
    """The model of `robot.model.build_model`, stripped for speed.

    The motion is the same to rounding (a test compares them). Visual meshes go, which
    shrinks a model from 71 MB to 0.3 MB, so that every robot can have its own; islands
    are pointless with one robot; the sparse solver suits its branching tree.

    Args:
        terrain: uneven ground to add.
        feet: shape of the feet.
        file: the robot as `save_training_model` wrote it, where mjlab is missing.
    """
    if file is not None:
        return _carried(file, terrain)
    spec = _lean_spec(feet)
    if terrain is not None:
        _add_plateau(spec, terrain)
    return _tuned(spec.compile())


def save_training_model(path: Path) -> None:
    """Write the training model, flat ground, in MuJoCo's binary format."""
    mujoco.mj_saveModel(build_training_model(), str(path))


def _carried(file: Path, terrain: Terrain | None) -> mujoco.MjModel:
    remedy = "write it with `openclone train model` and this version of MuJoCo"
    if terrain is not None:
        raise InputError(
            "a model file has flat ground only, and the preset wants uneven ground",
            where=str(file),
            remedy="train without --model",
        )
    if not file.is_file():
        raise InputError("no such model", where=str(file), remedy=remedy)
    try:
        model = mujoco.MjModel.from_binary_path(str(file))
    except ValueError as error:
        reason = str(error).splitlines()[0]
        raise InputError(
            f"not a model that MuJoCo {mujoco.__version__} reads ({reason})",
            where=str(file),
            remedy=remedy,
        ) from None
    if model.nu != g1.NUM_JOINTS or model.nsensor == 0:
        raise InputError("not the G1 of this project", where=str(file), remedy=remedy)
    return model


def _lean_spec(feet: Feet) -> mujoco.MjSpec:
    spec = build_spec(feet=feet)
    for geom in list(spec.geoms):
        if geom.type == mujoco.mjtGeom.mjGEOM_MESH:
            spec.delete(geom)
    for mesh in list(spec.meshes):
        spec.delete(mesh)
    add_floor(spec)
    return spec


def _tuned(model: mujoco.MjModel) -> mujoco.MjModel:
    model.opt.disableflags |= mujoco.mjtDisableBit.mjDSBL_ISLAND
    model.opt.jacobian = mujoco.mjtJacobian.mjJAC_SPARSE
    return model


def _add_plateau(spec: mujoco.MjSpec, terrain: Terrain) -> None:
    heights = terrain.heights
    rows, columns = heights.shape
    span = float(np.ptp(heights))
    spec.add_hfield(
        name=_FIELD,
        nrow=rows,
        ncol=columns,
        # Half lengths between the outer points; the compiler scales heights to 0..1.
        size=[0.5 * CELL * (columns - 1), 0.5 * CELL * (rows - 1), span, 0.5],
        userdata=heights.ravel().tolist(),
    )
    spec.worldbody.add_geom(
        name=_FIELD,
        type=mujoco.mjtGeom.mjGEOM_HFIELD,
        hfieldname=_FIELD,
        pos=_PLATEAU + np.array([0.0, 0.0, heights.min()]),
        contype=1,
        conaffinity=1,
        condim=3,
    )
