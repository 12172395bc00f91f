"""The map: one averaged point ("cell") per occupied voxel, in a hash table.

It takes the place of FAST-LIO2's k-d tree: points are merged into cells as they come,
the five nearest cells are found by looking into the surrounding voxels, and cells
outside a box around the sensor are dropped when the sensor has moved on. Memory is
allocated once.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

NEIGHBOURS = 5
KEY_OFFSET = 1 << 20
"""Voxel indices are shifted by it to be positive in their 21 bits."""


@dataclass(frozen=True)
class MapConfig:
    """Resolution and size of the map.

    Attributes:
        voxel: metres, edge of a voxel.
        merge_radius: metres; a point this close to a cell is averaged into it.
        max_weight: points after which a cell stops moving. A mapped place thus
            stays where it is.
        box: metres, half the edge of the cube around the sensor that is kept.
        capacity: most cells held.
    """

    voxel: float = 0.2
    merge_radius: float = 0.12
    max_weight: float = 200.0
    box: float = 50.0
    capacity: int = 1 << 17


@njit(cache=True, nogil=True, inline="always")
def hash_slot(ix: int, iy: int, iz: int, mask: int) -> int:
    """Where the search for a voxel begins."""
    mixed = ix * 73856093 ^ iy * 19349669 ^ iz * 83492791
    return (mixed ^ (mixed >> 15)) & mask


@njit(cache=True, nogil=True, inline="always")
def find(
    table: np.ndarray, keys: np.ndarray, ix: int, iy: int, iz: int
) -> tuple[int, int]:
    """The cell of a voxel or -1, and its slot in the table."""
    mask = len(table) - 1
    key = (ix << 42) | (iy << 21) | iz
    slot = hash_slot(ix, iy, iz, mask)
    while True:
        cell = table[slot]
        if cell < 0 or keys[cell] == key:
            return cell, slot
        slot = (slot + 1) & mask


@njit(cache=True, nogil=True, inline="always")
def offer(
    cell: int, dist2: float, nearest: np.ndarray, distances2: np.ndarray, found: int
) -> int:
    """Insert a candidate into the sorted list of nearest cells; the new length."""
    if found == NEIGHBOURS and dist2 >= distances2[NEIGHBOURS - 1]:
        return found
    j = found if found < NEIGHBOURS else NEIGHBOURS - 1
    while j > 0 and distances2[j - 1] > dist2:
        distances2[j], nearest[j] = distances2[j - 1], nearest[j - 1]
        j -= 1
    distances2[j], nearest[j] = dist2, cell
    return min(found + 1, NEIGHBOURS)


@njit(cache=True, nogil=True)
def nearest_cells(
    x: float,
    y: float,
    z: float,
    cells: np.ndarray,
    table: np.ndarray,
    keys: np.ndarray,
    voxel: float,
    nearest: np.ndarray,
    distances2: np.ndarray,
) -> int:
    """Find up to five nearest cells around a point; returns how many.

    The voxels around the point's own are searched first; where they hold too few
    cells, also the next shell. Fills ``nearest`` (indices) and ``distances2`` (m²).
    """
    ix = int(np.floor(x / voxel)) + KEY_OFFSET
    iy = int(np.floor(y / voxel)) + KEY_OFFSET
    iz = int(np.floor(z / voxel)) + KEY_OFFSET
    found = 0
    for shell in range(1, 3):
        for dx in range(-shell, shell + 1):
            for dy in range(-shell, shell + 1):
                edge = shell == 1 or abs(dx) == 2 or abs(dy) == 2
                for dz in range(-shell, shell + 1, 1 if edge else 4):
                    cell, _ = find(table, keys, ix + dx, iy + dy, iz + dz)
                    if cell < 0:
                        continue
                    ex, ey, ez = (
                        cells[cell, 0] - x,
                        cells[cell, 1] - y,
                        cells[cell, 2] - z,
                    )
                    dist2 = ex * ex + ey * ey + ez * ez
                    found = offer(cell, dist2, nearest, distances2, found)
        # One lonely neighbour does not promise four more: look no further.
        if found >= NEIGHBOURS or found < 2:
            break
    return found


@njit(cache=True, nogil=True)
def insert(
    points: np.ndarray,
    counts: np.ndarray,
    use: np.ndarray,
    cells: np.ndarray,
    table: np.ndarray,
    keys: np.ndarray,
    used: int,
    limits: np.ndarray,
) -> int:
    """Merge points into their nearest cells, or make new cells of them.

    Args:
        points: (n, 3), metres, world.
        counts: (n,), raw points that each stands for.
        use: (n,), 0 skip, 1 only where no cell is near, 2 also merge.
        cells: (capacity, 4), position and weight; changed.
        table: hash table of cell indices; changed.
        keys: (capacity,), voxel of each cell; changed.
        used: cells in use.
        limits: voxel, merge radius, greatest weight.

    Returns:
        Cells in use afterwards.
    """
    voxel, radius2, max_weight = limits[0], limits[1] ** 2, limits[2]
    nearest, distances2 = np.empty(NEIGHBOURS, np.int64), np.empty(NEIGHBOURS)
    for i in range(len(points)):
        if use[i] == 0:
            continue
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        found = nearest_cells(x, y, z, cells, table, keys, voxel, nearest, distances2)
        if found > 0 and distances2[0] <= radius2:
            cell = cells[nearest[0]]
            if use[i] == 2 and cell[3] < max_weight:
                share = counts[i] / (cell[3] + counts[i])
                for a in range(3):
                    cell[a] += share * (points[i, a] - cell[a])
                cell[3] += counts[i]
            continue
        ix = int(np.floor(x / voxel)) + KEY_OFFSET
        iy = int(np.floor(y / voxel)) + KEY_OFFSET
        iz = int(np.floor(z / voxel)) + KEY_OFFSET
        own, slot = find(table, keys, ix, iy, iz)
        if own >= 0 or used >= len(keys):
            continue
        table[slot] = used
        keys[used] = (ix << 42) | (iy << 21) | iz
        cells[used, 0], cells[used, 1], cells[used, 2] = x, y, z
        cells[used, 3] = counts[i]
        used += 1
    return used


@njit(cache=True, nogil=True)
def keep_box(
    centre: np.ndarray,
    half: float,
    cells: np.ndarray,
    table: np.ndarray,
    keys: np.ndarray,
    used: int,
) -> int:
    """Drop the cells outside a cube and rebuild the table; cells left."""
    kept = 0
    for i in range(used):
        inside = True
        for a in range(3):
            inside = inside and abs(cells[i, a] - centre[a]) <= half
        if inside:
            cells[kept] = cells[i]
            keys[kept] = keys[i]
            kept += 1
    table[:] = -1
    mask21 = (1 << 21) - 1
    for i in range(kept):
        key = keys[i]
        ix, iy, iz = key >> 42, (key >> 21) & mask21, key & mask21
        _, slot = find(table, keys, ix, iy, iz)
        table[slot] = i
    return kept


class VoxelMap:
    """Cells around the sensor, world frame."""

    def __init__(self, config: MapConfig) -> None:
        """Start empty; allocates everything it will ever use."""
        self.config = config
        slots = 1 << max(10, (4 * config.capacity - 1).bit_length() - 1)
        self.cells = np.zeros((config.capacity, 4))
        self.keys = np.zeros(config.capacity, np.int64)
        self.table = np.full(slots, -1, np.int32)
        self._limits = np.array((config.voxel, config.merge_radius, config.max_weight))
        self.clear()

    def __len__(self) -> int:
        """Cells in use."""
        return self._used

    @property
    def points(self) -> np.ndarray:
        """Copy of the cells' positions, ``(n, 3)``, metres, world."""
        return self.cells[: self._used, :3].copy()

    def clear(self) -> None:
        """Forget everything."""
        self._used = 0
        self._centre: np.ndarray | None = None
        self.table[:] = -1

    def insert(self, points: np.ndarray, counts: np.ndarray, use: np.ndarray) -> None:
        """Take in points ``(n, 3)``, world; see the compiled `insert`."""
        self._used = insert(
            points,
            counts,
            use,
            self.cells,
            self.table,
            self.keys,
            self._used,
            self._limits,
        )

    def follow(self, centre: np.ndarray) -> int:
        """Move the kept box to ``centre (3,)`` once it is far enough; cells dropped.

        A full map also shrinks to half the box, so that new places find room.
        """
        config = self.config
        if self._centre is None:
            self._centre = centre.copy()
        moved = float(np.abs(centre - self._centre).max())
        full = self._used >= config.capacity
        if moved < 0.2 * config.box and not full:
            return 0
        self._centre = centre.copy()
        before = self._used
        half = config.box
        while True:
            self._used = keep_box(
                centre, half, self.cells, self.table, self.keys, self._used
            )
            half *= 0.5
            if self._used < config.capacity or half < config.voxel:
                return before - self._used
