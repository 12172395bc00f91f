"""Films a run without a display: robot, translucent reference and operator's targets.

MuJoCo picks its renderer from the environment when it is first imported, so the
pictures are made in a process of their own: ``python -m openclone.evaluation.video``.
"""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

import mujoco
import numpy as np

from openclone.errors import OpenCloneError
from openclone.robot.ghost import build_ghost_model, ghost_qpos
from openclone.spatial import rotations

FPS = 25
WIDTH, HEIGHT = 640, 480
STILL_WIDTH, STILL_HEIGHT = 1280, 960
_TIMEOUT_SECONDS = 600
_POINT_COLOURS = ((0.95, 0.55, 0.1, 1), (0.2, 0.75, 0.3, 1), (0.8, 0.25, 0.6, 1))
_AXIS_COLOURS = ((0.9, 0.1, 0.1, 1), (0.1, 0.7, 0.1, 1), (0.1, 0.2, 0.9, 1))
_REMEDY = (
    "install a software renderer with `apt-get install libosmesa6`, "
    "or set MUJOCO_GL to egl or glfw where there is a GPU or a display"
)


@dataclass(frozen=True)
class Film:
    """What is to be seen, T frames at the control rate.

    Attributes:
        qpos, reference_qpos: (T, 36), robot and reference.
        target_position: (T, 3, 3), metres, world: head and hands as commanded.
        target_quat: (T, 3, 4), wxyz, world from point.
        period: seconds between frames.
    """

    qpos: np.ndarray
    reference_qpos: np.ndarray
    target_position: np.ndarray
    target_quat: np.ndarray
    period: float


class Camera:
    """Renders single pictures; follows the robot from the front left."""

    def __init__(self, width: int, height: int, samples: int) -> None:
        """Build the model and the off-screen renderer.

        Args:
            width: of the pictures; at most 1280.
            height: of the pictures; at most 960.
            samples: of antialiasing; 4 double the time of a picture in software.
        """
        self._model = build_ghost_model()
        self._model.vis.quality.offsamples = samples
        self._data = mujoco.MjData(self._model)
        self._renderer = mujoco.Renderer(self._model, height, width)
        self._camera = mujoco.MjvCamera()
        self._camera.distance = 2.9
        self._camera.azimuth = 140.0
        self._camera.elevation = -14.0

    def close(self) -> None:
        """Free the renderer."""
        self._renderer.close()

    def picture(self, film: Film, frame: int) -> np.ndarray:
        """(height, width, 3) uint8 of ``film`` at ``frame``."""
        both = ghost_qpos(film.qpos[frame], film.reference_qpos[frame])
        self._data.qpos[:] = both
        mujoco.mj_kinematics(self._model, self._data)
        mujoco.mj_comPos(self._model, self._data)
        mujoco.mj_camlight(self._model, self._data)
        # A second of averaging keeps the picture from swaying with each step.
        half = round(0.5 / film.period)
        around = film.qpos[max(0, frame - half) : frame + half + 1, :2]
        self._camera.lookat[:] = (*around.mean(axis=0), 0.7)
        self._renderer.update_scene(self._data, self._camera)
        scene = self._renderer.scene
        # In software, shadows take three times as long as everything else.
        scene.flags[mujoco.mjtRndFlag.mjRND_SHADOW] = 0
        scene.flags[mujoco.mjtRndFlag.mjRND_REFLECTION] = 0
        _draw_shadow(scene, film.qpos[frame])
        for point in range(3):
            colour = _POINT_COLOURS[point]
            _draw_target(
                scene,
                film.target_position[frame, point],
                film.target_quat[frame, point],
                colour,
            )
        return self._renderer.render()


def _draw_shadow(scene: mujoco.MjvScene, qpos: np.ndarray) -> None:
    """A dim disc below the pelvis: without any shadow the robot seems to float."""
    place = np.array([qpos[0], qpos[1], 0.001])
    for radius in np.linspace(0.12, 0.3, 8):
        size = np.array([radius, radius, 0.0005])
        _add_geom(
            scene, mujoco.mjtGeom.mjGEOM_ELLIPSOID, size, place, (0.0, 0.0, 0.0, 0.04)
        )


def _draw_target(
    scene: mujoco.MjvScene,
    position: np.ndarray,
    quat: np.ndarray,
    colour: tuple[float, ...],
) -> None:
    """A ball with three axes, 12 cm long."""
    kinds = mujoco.mjtGeom
    _add_geom(scene, kinds.mjGEOM_SPHERE, np.full(3, 0.025), position, colour)
    for axis, tip in enumerate(0.12 * rotations.to_matrix(quat).T):
        zero = np.zeros(3)
        geom = _add_geom(scene, kinds.mjGEOM_CAPSULE, zero, zero, _AXIS_COLOURS[axis])
        end = position + tip
        mujoco.mjv_connector(geom, kinds.mjGEOM_CAPSULE, 0.006, position, end)


def _add_geom(
    scene: mujoco.MjvScene,
    kind: mujoco.mjtGeom,
    size: np.ndarray,
    position: np.ndarray,
    colour: tuple[float, ...],
) -> mujoco.MjvGeom:
    geom = scene.geoms[scene.ngeom]
    rgba = np.array(colour, dtype=np.float32)
    mujoco.mjv_initGeom(geom, kind, size, position, np.eye(3).reshape(-1), rgba)
    scene.ngeom += 1
    return geom


def write_film(film: Film, video: Path, still: Path) -> None:
    """Render ``film`` to an MP4 and its most eventful picture to a PNG.

    Needs a working `MUJOCO_GL`; `film_run` sees to that.
    """
    import av
    from matplotlib import image

    camera = Camera(STILL_WIDTH, STILL_HEIGHT, samples=4)
    image.imsave(still, camera.picture(film, _eventful(film)))
    camera.close()  # two open off-screen contexts disturb each other
    camera = Camera(WIDTH, HEIGHT, samples=0)
    every = max(1, round(1.0 / (FPS * film.period)))
    frames = range(0, len(film.qpos), every)
    codec = "libx264" if "libx264" in av.codecs_available else "mpeg4"
    with av.open(str(video), "w") as container:
        stream = container.add_stream(codec, rate=Fraction(1 / (every * film.period)))
        stream.width, stream.height, stream.pix_fmt = WIDTH, HEIGHT, "yuv420p"
        stream.bit_rate = 2_000_000
        for index in frames:
            picture = av.VideoFrame.from_ndarray(camera.picture(film, index), "rgb24")
            container.mux(stream.encode(picture))
        container.mux(stream.encode())
    camera.close()


def _eventful(film: Film) -> int:
    """The frame in which the hands are furthest from where they usually are."""
    relative = film.target_position[:, 1:] - film.target_position[:, :1]
    unusual = np.linalg.norm(relative - np.median(relative, axis=0), axis=-1)
    return int(np.argmax(unusual.sum(axis=1)))


def film_run(film: Film, folder: Path) -> tuple[Path, Path]:
    """Write ``video.mp4`` and ``frame.png`` into ``folder``, in a child process.

    Raises:
        OpenCloneError: this machine cannot render; the message says what to install.
    """
    source = folder / "run.npz"
    np.savez_compressed(source, **vars(film))
    video, still = folder / "video.mp4", folder / "frame.png"
    # `or`: an empty variable means unset to MuJoCo, too.
    renderer = os.environ.get("MUJOCO_GL") or "osmesa"
    command = [sys.executable, "-m", "openclone.evaluation.video"]
    try:
        done = subprocess.run(
            [*command, str(source), str(video), str(still)],
            env={**os.environ, "MUJOCO_GL": renderer},
            capture_output=True,
            text=True,
            timeout=_TIMEOUT_SECONDS,
            check=False,
        )
    except subprocess.TimeoutExpired:
        raise OpenCloneError(f"the video took over {_TIMEOUT_SECONDS} s") from None
    finally:
        source.unlink(missing_ok=True)
    if done.returncode != 0:
        reason = (done.stderr.strip().splitlines() or ["no message"])[-1]
        raise OpenCloneError(
            f"no video: MUJOCO_GL={renderer} cannot render here ({reason}); {_REMEDY}"
        )
    return video, still


def main(source: Path, video: Path, still: Path) -> None:
    """The child process."""
    with np.load(source, allow_pickle=False) as data:
        arrays = {name: data[name] for name in data.files}
    period = float(arrays.pop("period"))
    film = Film(period=period, **arrays)
    write_film(film, video, still)


if __name__ == "__main__":
    main(*(Path(argument) for argument in sys.argv[1:4]))
