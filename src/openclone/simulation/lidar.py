"""A Livox Mid-360 on the G1's head, traced ray by ray from the moving robot.

Every millisecond of a frame is traced from where the sensor is then, so a moving robot
sees a distorted room, as a real one does. Points are in the LiDAR's own frame: the
sensor hangs upside down, which only the site ``lidar`` of the model knows.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from openclone.simulation.scan_pattern import POINTS_PER_SECOND, beam_directions
from openclone.simulation.worlds import GLASS, SOLID, World
from openclone.spatial import rotations

_ROBOT = 3
"""Group of the robot's collision geoms."""


@dataclass(frozen=True)
class Mid360Config:
    """The sensor (Livox's data sheet) and what a room does to its light.

    Attributes:
        frame_s: seconds per frame.
        chunk_s: seconds during which the sensor counts as still.
        range_sigma: metres; the data sheet allows 2 cm at 10 m, here at any range.
        min_range: metres; anything nearer gives no return.
        max_range: metres, for ordinary walls.
        no_return: share of beams that meet a surface and still do not come back;
            indoors about 30 % of a Mid-360's points are (0, 0, 0).
        glass_return: share of beams that dust on a pane sends back.
        glass_reflectance: of a pane (two faces), seen straight on.
    """

    frame_s: float = 0.1
    chunk_s: float = 0.001
    range_sigma: float = 0.02
    min_range: float = 0.1
    max_range: float = 40.0
    no_return: float = 0.3
    glass_return: float = 0.06
    glass_reflectance: float = 0.08

    @property
    def points(self) -> int:
        """Points per frame, 20 000."""
        return round(self.frame_s * POINTS_PER_SECOND)

    @property
    def chunk(self) -> int:
        """Beams per chunk, 200."""
        return round(self.chunk_s * POINTS_PER_SECOND)


@dataclass(frozen=True)
class LidarFrame:
    """One frame.

    Attributes:
        points: (N, 3), metres, LiDAR frame; (0, 0, 0) where nothing came back.
        stamps_ns: (N,), int64, when each beam left, the sensor's clock.
        end_ns: when the frame was complete.
    """

    points: np.ndarray
    stamps_ns: np.ndarray
    end_ns: int


@dataclass(frozen=True)
class Motion:
    """How the robot moved during a frame.

    Attributes:
        stamps_ns: (K,), int64, increasing, from the frame's start to its end.
        qpos: (K, 36), true positions at these times.
    """

    stamps_ns: np.ndarray
    qpos: np.ndarray

    def at(self, stamps_ns: np.ndarray) -> np.ndarray:
        """Positions ``(n, 36)`` at ``stamps_ns (n,)``, evenly between the knots."""
        after = np.searchsorted(self.stamps_ns, stamps_ns, "right")
        low = np.clip(after - 1, 0, len(self.stamps_ns) - 2)
        span = self.stamps_ns[low + 1] - self.stamps_ns[low]
        part = (stamps_ns - self.stamps_ns[low]) / span
        first, second = self.qpos[low], self.qpos[low + 1]
        out = first + part[:, None] * (second - first)
        out[:, 3:7] = rotations.slerp(first[:, 3:7], second[:, 3:7], part)
        return out


class SimulatedLidar:
    """Traces frames; it has a `MjData` of its own and may run in its own thread."""

    def __init__(
        self, world: World, config: Mid360Config, rng: np.random.Generator
    ) -> None:
        """Mount the sensor on the robot of ``world``; ``rng`` is for noise alone."""
        self._world, self._config, self._rng = world, config, rng
        model = world.model
        self._data = mujoco.MjData(model)
        mujoco.mj_forward(model, self._data)
        self._site = model.site("lidar").id
        self._housing = int(model.site_bodyid[self._site])
        self._own = model.geom_group == _ROBOT
        self._glass = bool((model.geom_group == GLASS).any())
        self._next_beam = 0

    def trace(self, motion: Motion) -> LidarFrame:
        """The frame that the sensor takes during ``motion``."""
        config = self._config
        start_ns = int(motion.stamps_ns[0])
        steps = np.arange(config.points)
        stamps = start_ns + np.round(steps * (1e9 / POINTS_PER_SECOND)).astype(np.int64)
        beams = beam_directions(self._next_beam + steps)
        self._next_beam += config.points
        middles = stamps[:: config.chunk] + round(0.5e9 * config.chunk_s)
        ranges = np.empty(config.points)
        for index, qpos in enumerate(motion.at(middles)):
            part = slice(index * config.chunk, (index + 1) * config.chunk)
            position, matrix = self._pose(qpos, middles[index] * 1e-9)
            ranges[part] = self._ranges(position, beams[part] @ matrix.T)
        points = beams * self._measured(ranges)[:, None]
        return LidarFrame(points, stamps, start_ns + round(config.frame_s * 1e9))

    def _pose(self, qpos: np.ndarray, time_s: float) -> tuple[np.ndarray, np.ndarray]:
        """Move the scene; the sensor's place ``(3,)`` and axes ``(3, 3)``, world."""
        self._data.qpos[:] = qpos
        self._world.move_people(self._data, time_s)
        mujoco.mj_kinematics(self._world.model, self._data)
        matrix = self._data.site_xmat[self._site].reshape(3, 3)
        return self._data.site_xpos[self._site].copy(), matrix.copy()

    def _ranges(self, position_w: np.ndarray, beams_w: np.ndarray) -> np.ndarray:
        """True distances ``(n,)``, metres, along ``beams_w (n, 3)``; inf for nothing.

        A beam that ends on the robot itself counts as nothing: the driver masks it.
        """
        reach, geom, _ = self._cast(position_w, beams_w, (SOLID, _ROBOT))
        if self._glass:
            reach, geom = self._through_glass(position_w, beams_w, reach, geom)
        return np.where((geom >= 0) & self._own[geom], np.inf, reach)

    def _cast(
        self, position_w: np.ndarray, beams_w: np.ndarray, groups: tuple[int, ...]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Distance (inf: none), geom (-1: none) and surface normal of each beam."""
        count = len(beams_w)
        reach, geom = np.empty(count), np.empty(count, dtype=np.int32)
        normal = np.empty(3 * count)
        chosen = np.zeros(mujoco.mjNGROUP, dtype=np.uint8)
        chosen[list(groups)] = 1
        mujoco.mj_multiRay(
            self._world.model, self._data, position_w, beams_w.ravel(), chosen, True,
            self._housing, geom, reach, normal, count, self._config.max_range,
        )  # fmt: skip
        reach[geom < 0] = np.inf
        return reach, geom, normal.reshape(-1, 3)

    def _through_glass(
        self,
        position_w: np.ndarray,
        beams_w: np.ndarray,
        reach: np.ndarray,
        geom: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """What becomes of beams that meet a pane before anything else.

        Dust sends some back; the pane mirrors some, more at grazing angles (Schlick's
        approximation of Fresnel), which then show things behind the glass that stand in
        front of it; the rest passes twice, out and home, and is weaker by as much.
        """
        config = self._config
        reach, geom = reach.copy(), geom.copy()
        pane, pane_geom, normal = self._cast(position_w, beams_w, (GLASS,))
        met = np.flatnonzero(pane < reach)
        cosine = np.abs((beams_w[met] * normal[met]).sum(-1))
        mirrored = config.glass_reflectance
        mirrored = mirrored + (1.0 - mirrored) * (1.0 - cosine) ** 5
        chance, second = self._rng.random(len(met)), self._rng.random(len(met))
        dusty = chance < config.glass_return
        mirror = ~dusty & (chance < config.glass_return + mirrored)
        lost = ~dusty & ~mirror & (second > (1.0 - mirrored) ** 2)
        reach[met[lost]], geom[met[lost]] = np.inf, -1
        reach[met[dusty]], geom[met[dusty]] = pane[met[dusty]], pane_geom[met[dusty]]
        groups = np.zeros(mujoco.mjNGROUP, dtype=np.uint8)
        groups[[SOLID, _ROBOT]] = 1
        hit = np.empty(1, dtype=np.int32)
        for index in met[mirror]:
            beam, face = beams_w[index], normal[index]
            back = beam - 2.0 * (beam @ face) * face
            start = position_w + pane[index] * beam
            far = mujoco.mj_ray(
                self._world.model, self._data, start, back, groups, True,
                self._housing, hit, None,
            )  # fmt: skip
            reach[index] = pane[index] + far if far >= 0.0 else np.inf
            geom[index] = hit[0]
        return reach, geom

    def _measured(self, ranges: np.ndarray) -> np.ndarray:
        """Ranges ``(N,)`` as reported; 0 where there is no return."""
        config = self._config
        noisy = ranges + config.range_sigma * self._rng.standard_normal(len(ranges))
        kept = self._rng.random(len(ranges)) >= config.no_return
        kept &= (ranges >= config.min_range) & (ranges <= config.max_range)
        return np.where(kept, noisy, 0.0)
