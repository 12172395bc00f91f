"""A contact sheet: many clips in one picture, a row of moments each.

As with `video`, MuJoCo picks its renderer when it is first imported, so the pictures
are made in a process of their own: ``python -m openclone.evaluation.contact_sheet``.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from openclone.errors import OpenCloneError
from openclone.motion.clip import Clip, load_clip
from openclone.robot.ghost import MESH_CELL, VISUAL_GROUP, build_picture_model
from openclone.spatial import rotations

_TIMEOUT_SECONDS = 600
_REMEDY = "install a software renderer with `apt-get install libosmesa6`"
_SKY = (0.93, 0.95, 0.98, 1.0)
_GROUND = (0.80, 0.83, 0.86, 1.0)
_LABEL_PIXELS = 14


@dataclass(frozen=True)
class Sheet:
    """Layout of a contact sheet.

    Attributes:
        moments: pictures of each clip, evenly spread over it.
        size: pixels, edge of a picture.
        columns: clips side by side.
    """

    moments: int = 5
    size: int = 112
    columns: int = 2


class _Camera:
    """Renders single poses from the front left, the pelvis in the middle."""

    def __init__(self, size: int) -> None:
        self._model = build_picture_model(2 * MESH_CELL)
        self._model.vis.quality.offsamples = 4
        for geom in range(self._model.ngeom):
            if self._model.geom_group[geom] != VISUAL_GROUP:
                self._model.geom_rgba[geom, 3] = 0.0
        self._data = mujoco.MjData(self._model)
        self._renderer = mujoco.Renderer(self._model, size, size)
        self._camera = mujoco.MjvCamera()
        self._camera.distance = 2.2
        self._camera.elevation = -10.0

    def picture(self, qpos: np.ndarray) -> np.ndarray:
        """(size, size, 3) uint8."""
        self._data.qpos[:] = qpos
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)
        self._camera.lookat[:] = (*qpos[:2], 0.62)
        heading_deg = float(np.degrees(rotations.yaw(qpos[3:7])))
        self._camera.azimuth = heading_deg + 140.0
        self._renderer.update_scene(self._data, self._camera)
        scene = self._renderer.scene
        scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 0
        place = np.array([qpos[0], qpos[1], -0.001])
        slab = scene.geoms[scene.ngeom]
        mujoco.mjv_initGeom(
            slab,
            mujoco.mjtGeom.mjGEOM_BOX,
            np.array([0.9, 0.9, 0.001]),
            place,
            np.eye(3).reshape(-1),
            np.array(_GROUND, dtype=np.float32),
        )
        scene.ngeom += 1
        pixels = self._renderer.render().copy()
        pixels[(pixels == 0).all(axis=-1)] = np.round(255 * np.array(_SKY[:3]))
        return pixels


def draw_sheet(
    clips: Sequence[Clip], labels: Sequence[str], sheet: Sheet
) -> np.ndarray:
    """(height, width, 3) uint8: the clips, row by row. Needs a working `MUJOCO_GL`."""
    from PIL import Image, ImageDraw

    camera = _Camera(sheet.size)
    cells = []
    for clip, label in zip(clips, labels, strict=True):
        at = np.linspace(0, clip.num_frames - 1, sheet.moments).round().astype(int)
        strip = np.concatenate([camera.picture(clip.qpos[k]) for k in at], axis=1)
        title = Image.new("RGB", (strip.shape[1], _LABEL_PIXELS), "white")
        ImageDraw.Draw(title).text((2, 1), label, fill="black")
        cells.append(np.concatenate((np.asarray(title), strip), axis=0))
    while len(cells) % sheet.columns:
        cells.append(np.full_like(cells[0], 255))
    rows = [
        np.concatenate(cells[k : k + sheet.columns], axis=1)
        for k in range(0, len(cells), sheet.columns)
    ]
    return np.concatenate(rows, axis=0)


def write_sheet(
    paths: Sequence[Path],
    labels: Sequence[str],
    picture: Path,
    sheet: Sheet | None = None,
) -> None:
    """Write a JPEG of clip files, in a child process that can render.

    Raises:
        OpenCloneError: this machine cannot render; the message says what to install.
    """
    sheet = sheet or Sheet()
    picture.parent.mkdir(parents=True, exist_ok=True)
    job = "\n".join(f"{p}\t{label}" for p, label in zip(paths, labels, strict=True))
    # `or`: an empty variable means unset to MuJoCo, too.
    renderer = os.environ.get("MUJOCO_GL") or "osmesa"
    numbers = [str(v) for v in (sheet.moments, sheet.size, sheet.columns)]
    command = [sys.executable, "-m", "openclone.evaluation.contact_sheet"]
    try:
        done = subprocess.run(
            [*command, str(picture), *numbers],
            env={**os.environ, "MUJOCO_GL": renderer},
            input=job,
            capture_output=True,
            text=True,
            timeout=_TIMEOUT_SECONDS,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise OpenCloneError(f"the pictures took over {_TIMEOUT_SECONDS} s") from None
    if done.returncode != 0:
        reason = (done.stderr.strip().splitlines() or ["no message"])[-1]
        raise OpenCloneError(
            f"MUJOCO_GL={renderer} cannot render here ({reason}); {_REMEDY}"
        )


def main(picture: Path, moments: int, size: int, columns: int) -> None:
    """The child process; clip files and labels come on the standard input."""
    from PIL import Image

    pairs = [line.rstrip("\n").split("\t", 1) for line in sys.stdin]
    clips = [load_clip(Path(path)) for path, _ in pairs]
    labels = [label for _, label in pairs]
    pixels = draw_sheet(clips, labels, Sheet(moments, size, columns))
    Image.fromarray(pixels).save(picture, quality=80)


if __name__ == "__main__":
    main(Path(sys.argv[1]), *(int(text) for text in sys.argv[2:5]))
