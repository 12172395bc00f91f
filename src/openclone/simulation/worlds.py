"""Worlds for the simulated robot: rooms around the G1, composed onto its model.

The robot stands at the origin and looks along +X. World geometry is static and
collides with the robot. Groups tell the LiDAR what a ray meets: `SOLID` returns it,
`GLASS` mostly lets it pass. Training never sees these worlds; its model is
`robot.model.build_model`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from typing import Literal, get_args

import mujoco
import numpy as np

from openclone.errors import InputError
from openclone.robot.model import add_floor, build_spec

WorldName = Literal["flat", "room", "corridor", "hall", "glass", "people"]
WORLD_NAMES: tuple[WorldName, ...] = get_args(WorldName)

SOLID, GLASS = 0, 4
"""Geom groups; the robot's collision geoms are group 3 (`robot.model`)."""

Box = tuple[float, float, float, float, float, float]
"""x, y, z of the centre, then length, width, height: metres, world."""

_PAINT = [0.93, 0.92, 0.88, 1.0]
_WOOD = [0.72, 0.56, 0.4, 1.0]
_PANE = [0.6, 0.8, 0.9, 0.25]
_CLOTH = [0.35, 0.42, 0.55, 1.0]
_CEILING_M = 2.7
_WALL_M = 0.1


@dataclass(frozen=True)
class Person:
    """Somebody who walks up and down between two places and turns there.

    Attributes:
        first, second: (x, y), metres, world.
        speed: metres per second.
        start_s: seconds into the walk at time zero.
    """

    first: tuple[float, float]
    second: tuple[float, float]
    speed: float
    start_s: float = 0.0

    def position(self, time_s: float) -> np.ndarray:
        """Feet at ``time_s``, ``(3,)``, metres, world."""
        way = np.subtract(self.second, self.first)
        lap_s = float(np.linalg.norm(way)) / self.speed
        phase = ((time_s + self.start_s) / lap_s) % 2.0
        part = phase if phase < 1.0 else 2.0 - phase
        return np.array([*(np.array(self.first) + part * way), 0.0])


@dataclass(frozen=True)
class World:
    """A model of the robot in its surroundings, and who moves there.

    Attributes:
        name: one of `WORLD_NAMES`.
        model: the G1 in its world; 36 positions, like the model without a world.
        people: they are the model's mocap bodies, in this order.
    """

    name: str
    model: mujoco.MjModel
    people: tuple[Person, ...] = ()

    def move_people(self, data: mujoco.MjData, time_s: float) -> None:
        """Put the people of ``data`` where they are at ``time_s``."""
        for index, person in enumerate(self.people):
            data.mocap_pos[index] = person.position(time_s)


def build_world(name: str) -> World:
    """Compose a world around the G1.

    Raises:
        InputError: there is no such world.
    """
    if name not in _BUILDERS:
        raise InputError(
            f"unknown world {name!r}", remedy="use one of " + ", ".join(WORLD_NAMES)
        )
    spec = build_spec()
    add_floor(spec)
    people = _BUILDERS[name](spec)
    for index in range(len(people)):
        _add_person(spec, index)
    return World(name, spec.compile(), people)


def _add_boxes(
    spec: mujoco.MjSpec,
    boxes: Iterable[Box],
    rgba: list[float] = _PAINT,
    group: int = SOLID,
) -> None:
    for x, y, z, length, width, height in boxes:
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_BOX,
            pos=[x, y, z],
            size=[0.5 * length, 0.5 * width, 0.5 * height],
            rgba=rgba,
            group=group,
            contype=1,
            conaffinity=0,
            condim=3,
        )


def _add_pillars(
    spec: mujoco.MjSpec,
    places: Iterable[tuple[float, float]],
    radius: float,
    top: float,
) -> None:
    for x, y in places:
        spec.worldbody.add_geom(
            type=mujoco.mjtGeom.mjGEOM_CYLINDER,
            pos=[x, y, 0.5 * top],
            size=[radius, 0.5 * top, 0],
            rgba=_PAINT,
            group=SOLID,
            contype=1,
            conaffinity=0,
            condim=3,
        )


def _add_person(spec: mujoco.MjSpec, index: int) -> None:
    """Legs, trunk and head: 1.75 m. People step aside, so they do not collide."""
    body = spec.worldbody.add_body(name=f"person{index + 1}", mocap=True)
    capsule = mujoco.mjtGeom.mjGEOM_CAPSULE
    parts = (
        (capsule, (0.0, 0.1, 0.45), (0.085, 0.37)),
        (capsule, (0.0, -0.1, 0.45), (0.085, 0.37)),
        (capsule, (0.0, 0.0, 1.15), (0.19, 0.2)),
        (mujoco.mjtGeom.mjGEOM_SPHERE, (0.0, 0.0, 1.63), (0.12, 0.0)),
    )
    for kind, place, (radius, half) in parts:
        body.add_geom(
            type=kind,
            pos=list(place),
            size=[radius, half, 0],
            rgba=_CLOTH,
            group=SOLID,
            contype=0,
            conaffinity=0,
        )


def _walls(
    low: tuple[float, float], high: tuple[float, float], top: float
) -> list[Box]:
    """Four walls with their inner faces on the rectangle from ``low`` to ``high``."""
    (x0, y0), (x1, y1) = low, high
    length, width = x1 - x0 + 2 * _WALL_M, y1 - y0
    cx, cy, half = 0.5 * (x0 + x1), 0.5 * (y0 + y1), 0.5 * _WALL_M
    return [
        (cx, y0 - half, 0.5 * top, length, _WALL_M, top),
        (cx, y1 + half, 0.5 * top, length, _WALL_M, top),
        (x0 - half, cy, 0.5 * top, _WALL_M, width, top),
        (x1 + half, cy, 0.5 * top, _WALL_M, width, top),
    ]


def _ceiling(low: tuple[float, float], high: tuple[float, float], top: float) -> Box:
    (x0, y0), (x1, y1) = low, high
    return (0.5 * (x0 + x1), 0.5 * (y0 + y1), top + 0.05, x1 - x0, y1 - y0, 0.1)


def _table(x: float, y: float, length: float, width: float) -> list[Box]:
    """A table 0.74 m high on four legs."""
    legs: list[Box] = [
        (x + sx * (0.5 * length - 0.05), y + sy * (0.5 * width - 0.05), 0.355,
         0.06, 0.06, 0.71)
        for sx in (-1, 1) for sy in (-1, 1)
    ]  # fmt: skip
    return [(x, y, 0.725, length, width, 0.03), *legs]


def _shelf(x: float, y: float, length: float, width: float) -> list[Box]:
    """A shelf 1.9 m high: two sides and five boards."""
    along_x = length > width
    side = (0.03, width) if along_x else (length, 0.03)
    reach = 0.5 * (length if along_x else width) - 0.015
    step = (reach, 0.0) if along_x else (0.0, reach)
    sides: list[Box] = [
        (x + sign * step[0], y + sign * step[1], 0.95, *side, 1.9) for sign in (-1, 1)
    ]
    boards: list[Box] = [
        (x, y, 0.05 + 0.45 * level, length, width, 0.03) for level in range(5)
    ]
    return sides + boards


def _chair(x: float, y: float, back: float) -> list[Box]:
    """A stool-like chair; its back stands ``back`` metres behind the seat's middle."""
    return [
        (x, y, 0.44, 0.42, 0.42, 0.04),
        (x, y, 0.21, 0.08, 0.08, 0.42),
        (x, y + back, 0.68, 0.4, 0.03, 0.44),
    ]


_ROOM = (-4.5, -2.0), (4.5, 7.0)
"""Furnished room; a circle of 2.6 m radius about (0, 2.3) is free."""


def _furniture(spec: mujoco.MjSpec) -> None:
    solid: list[Box] = [
        (-3.9, 5.6, 0.4, 0.9, 2.0, 0.8),  # sofa: seat and back
        (-4.3, 5.6, 0.7, 0.2, 2.0, 0.6),
        (4.2, -1.5, 0.9, 0.6, 0.9, 1.8),  # cupboard
        (4.15, 2.0, 0.4, 0.7, 1.6, 0.8),  # sideboard
        (-4.2, -1.0, 0.45, 0.6, 0.6, 0.9),
        (-4.35, 2.4, 0.25, 0.3, 1.2, 0.5),
        (2.2, -1.85, 0.45, 0.9, 0.3, 0.9),
        (-4.4, 0.9, 1.5, 0.2, 1.2, 0.08),  # board on the wall
        (3.8, 6.75, 1.1, 0.9, 0.5, 2.2),
    ]
    boards = _shelf(0.5, 6.82, 2.4, 0.34) + _shelf(-1.9, -1.83, 1.6, 0.32)
    desks = _table(3.6, 4.6, 1.4, 0.8) + _table(-2.9, 0.2, 0.0 + 0.8, 1.0)
    seats = _chair(3.2, 5.5, 0.2) + _chair(2.6, 5.9, -0.2)
    _add_boxes(spec, solid + boards + desks + seats, _WOOD)
    _add_pillars(spec, [(-1.6, 6.6)], 0.16, 1.3)


def _flat(_: mujoco.MjSpec) -> tuple[Person, ...]:
    """Floor alone: nothing that a LiDAR could hold on to."""
    return ()


def _room(spec: mujoco.MjSpec) -> tuple[Person, ...]:
    """A furnished room of 9 x 9 m."""
    _add_boxes(spec, [*_walls(*_ROOM, _CEILING_M), _ceiling(*_ROOM, _CEILING_M)])
    # A door frame and a window sill break up the two barest walls.
    frames: list[Box] = [
        (4.44, -0.2, 1.05, 0.12, 0.1, 2.1),
        (4.44, 0.8, 1.05, 0.12, 0.1, 2.1),
    ]
    _add_boxes(spec, [*frames, (-2.4, 6.94, 0.95, 1.6, 0.2, 0.06)])
    _furniture(spec)
    return ()


def _people(spec: mujoco.MjSpec) -> tuple[Person, ...]:
    """The furnished room while four people walk about."""
    _room(spec)
    return (
        Person((-1.0, 2.3), (1.0, 2.6), 0.7),
        Person((-3.4, 4.0), (2.4, 5.9), 1.1, 2.0),
        Person((-3.3, -1.2), (3.2, -1.2), 1.3, 1.0),
        Person((3.2, -1.0), (3.3, 3.6), 0.9),
    )


def _corridor(spec: mujoco.MjSpec) -> tuple[Person, ...]:
    """A corridor of 60 x 2.4 m: doors, and little that tells how far one has come."""
    low, high = (-20.0, -1.2), (40.0, 1.2)
    _add_boxes(spec, [*_walls(low, high, _CEILING_M), _ceiling(low, high, _CEILING_M)])
    frames: list[Box] = []
    for index, x in enumerate(np.arange(-18.0, 39.0, 4.3)):
        side = 1.16 if index % 2 else -1.16
        frames += [(x + offset, side, 1.05, 0.08, 0.08, 2.1) for offset in (-0.5, 0.5)]
    _add_boxes(spec, frames, _WOOD)
    _add_boxes(
        spec, [(8.0, 1.05, 0.5, 0.5, 0.3, 1.0), (21.5, -1.05, 0.4, 0.4, 0.3, 0.8)]
    )
    return ()


def _hall(spec: mujoco.MjSpec) -> tuple[Person, ...]:
    """A hall of 40 x 30 m, 8 m high, with six pillars and a few crates."""
    low, high = (-15.0, -13.0), (25.0, 17.0)
    _add_boxes(spec, [*_walls(low, high, 8.0), _ceiling(low, high, 8.0)])
    _add_pillars(spec, [(x, y) for x in (-6, 5, 16) for y in (-6, 9)], 0.3, 8.0)
    crates: list[Box] = [
        (7.0, -2.5, 0.5, 1.2, 1.0, 1.0), (-5.0, 5.0, 0.4, 0.8, 0.8, 0.8),
        (3.0, 12.0, 0.75, 2.0, 1.2, 1.5), (14.0, 2.0, 0.6, 1.2, 1.2, 1.2),
    ]  # fmt: skip
    _add_boxes(spec, crates, _WOOD)
    return ()


def _glass(spec: mujoco.MjSpec) -> tuple[Person, ...]:
    """A room of 9 x 9 m with three walls of glass, inside a larger storey.

    Frames stand every 1.5 m; outside are a corridor, pillars and the building's walls.
    """
    (x0, y0), (x1, y1) = _ROOM
    low, high = (x0 - 4.0, y0 - 3.0), (x1 + 5.0, y1 + 3.5)
    _add_boxes(spec, [*_walls(low, high, _CEILING_M), _ceiling(low, high, _CEILING_M)])
    cx, cy = 0.5 * (x0 + x1), 0.5 * (y0 + y1)
    half = 0.5 * _CEILING_M
    panes: list[Box] = [
        (x1, cy, half, 0.01, y1 - y0, _CEILING_M),
        (cx, y0, half, x1 - x0, 0.01, _CEILING_M),
        (cx, y1, half, x1 - x0, 0.01, _CEILING_M),
    ]
    _add_boxes(spec, panes, _PANE, GLASS)
    posts: list[Box] = [
        (x1, y, half, 0.05, 0.05, _CEILING_M) for y in np.arange(y0, y1, 1.5)
    ]
    for y in (y0, y1):
        posts += [(x, y, half, 0.05, 0.05, _CEILING_M) for x in np.arange(x0, x1, 1.5)]
    _add_boxes(spec, [*posts, (x0 - 0.05, cy, half, 0.1, y1 - y0, _CEILING_M)])
    _add_pillars(
        spec, [(x1 + 3.0, y0), (x1 + 3.0, y1), (0.0, y1 + 2.0)], 0.25, _CEILING_M
    )
    _add_boxes(spec, _table(3.4, 5.6, 1.6, 0.8) + _shelf(-4.2, 4.5, 0.34, 2.0), _WOOD)
    return ()


_BUILDERS: dict[str, Callable[[mujoco.MjSpec], tuple[Person, ...]]] = {
    "flat": _flat, "room": _room, "corridor": _corridor,
    "hall": _hall, "glass": _glass, "people": _people,
}  # fmt: skip
