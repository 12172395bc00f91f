"""Point-to-plane residuals between a thinned scan and the map, and their Jacobians.

    z = n · (R (R_IL p + t_IL) + t) - d

with the plane (n, d) through the five nearest cells of the map (Eq. 11-14 of the
FAST-LIO paper). Only 12 of the 23 columns of its Jacobian are not zero: rotation,
position and the two parts of the extrinsic.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import njit

from openclone.odometry.manifold import ERROR_SIZE
from openclone.odometry.scan import Thinned
from openclone.odometry.voxel_map import NEIGHBOURS, VoxelMap, nearest_cells

NO_PLANE, OUTLIER, INLIER = 0, 1, 2
COLUMNS = np.array((0, 1, 2, 3, 4, 5, 17, 18, 19, 20, 21, 22))
"""Where the 12 columns of the residual's Jacobian stand in the error state."""


@dataclass(frozen=True)
class MatchConfig:
    """What counts as a plane and how far a residual is trusted.

    Attributes:
        point_sigma: metres, least noise of one point along a plane's normal; where
            the points of a voxel scatter more, their scatter counts.
        map_sigma: metres, error of a plane of the map beside its own scatter.
        thickness: metres, greatest scatter of five cells across their plane.
        width: metres, least scatter of five cells along their plane.
        gate: residuals beyond so many standard deviations are outliers.
        slack: metres added to the standard deviation for the gate.
        max_sigma: metres; voxels that scatter more along the normal are no plane.
        independence: share of the residuals that count as independent. The points
            of a scan share the error of the map, which their number cannot average
            out.
    """

    point_sigma: float = 0.012
    map_sigma: float = 0.005
    thickness: float = 0.03
    width: float = 0.04
    gate: float = 3.0
    slack: float = 0.005
    max_sigma: float = 0.06
    independence: float = 0.025

    def as_array(self) -> np.ndarray:
        """The numbers in the order of the attributes, for compiled code."""
        return np.array(
            (
                self.point_sigma,
                self.map_sigma,
                self.thickness,
                self.width,
                self.gate,
                self.slack,
                self.max_sigma,
                self.independence,
            )
        )


@njit(cache=True, nogil=True)
def smallest_eigenvector(
    xx: float, xy: float, xz: float, yy: float, yz: float, zz: float, out: np.ndarray
) -> tuple[float, float]:
    """Unit eigenvector of the smallest eigenvalue of a symmetric matrix.

    Trigonometric solution of the characteristic cubic.

    Returns:
        The smallest and the middle eigenvalue; ``out (3,)`` takes the vector.
    """
    mean = (xx + yy + zz) / 3.0
    ax, ay, az = xx - mean, yy - mean, zz - mean
    off = xy * xy + xz * xz + yz * yz
    scale = np.sqrt((ax * ax + ay * ay + az * az + 2.0 * off) / 6.0) + 1e-15
    det = ax * (ay * az - yz * yz) - xy * (xy * az - yz * xz) + xz * (xy * yz - ay * xz)
    cosine = min(1.0, max(-1.0, 0.5 * det / scale**3))
    angle = np.arccos(cosine) / 3.0
    largest = mean + 2.0 * scale * np.cos(angle)
    smallest = mean + 2.0 * scale * np.cos(angle + 2.0 * np.pi / 3.0)
    ax, ay, az = xx - smallest, yy - smallest, zz - smallest
    # The longest of the three cross products of the rows of A - smallest * I.
    best = -1.0
    for pair in range(3):
        if pair == 0:
            cx, cy, cz = xy * yz - xz * ay, xz * xy - ax * yz, ax * ay - xy * xy
        elif pair == 1:
            cx, cy, cz = xy * az - xz * yz, xz * xz - ax * az, ax * yz - xy * xz
        else:
            cx, cy, cz = ay * az - yz * yz, yz * xz - xy * az, xy * yz - ay * xz
        length2 = cx * cx + cy * cy + cz * cz
        if length2 > best:
            best = length2
            length = np.sqrt(length2) + 1e-300
            out[0], out[1], out[2] = cx / length, cy / length, cz / length
    return smallest, 3.0 * mean - largest - smallest


@njit(cache=True, nogil=True)
def fit_plane(
    nearest: np.ndarray, cells: np.ndarray, limits: np.ndarray, plane: np.ndarray
) -> bool:
    """Plane through five cells; False where they do not lie on one.

    Args:
        nearest: (5,) indices of cells.
        cells: (capacity, 4), position and weight.
        limits: `MatchConfig.as_array`.
        plane: (5,), takes the normal, the distance d (n · x = d) and the variance.
    """
    total, mx, my, mz = 0.0, 0.0, 0.0, 0.0
    for j in range(NEIGHBOURS):
        # Heavier cells are less noisy, but five should share the say.
        weight = min(cells[nearest[j], 3], 20.0)
        total += weight
        mx += weight * cells[nearest[j], 0]
        my += weight * cells[nearest[j], 1]
        mz += weight * cells[nearest[j], 2]
    mx, my, mz = mx / total, my / total, mz / total
    xx, xy, xz, yy, yz, zz = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for j in range(NEIGHBOURS):
        weight = min(cells[nearest[j], 3], 20.0) / total
        dx = cells[nearest[j], 0] - mx
        dy = cells[nearest[j], 1] - my
        dz = cells[nearest[j], 2] - mz
        xx += weight * dx * dx
        xy += weight * dx * dy
        xz += weight * dx * dz
        yy += weight * dy * dy
        yz += weight * dy * dz
        zz += weight * dz * dz
    smallest, middle = smallest_eigenvector(xx, xy, xz, yy, yz, zz, plane)
    if smallest > limits[2] ** 2 or middle < limits[3] ** 2:
        return False
    plane[3] = plane[0] * mx + plane[1] * my + plane[2] * mz
    plane[4] = max(smallest, 0.0)
    return True


@njit(cache=True, nogil=True)
def residual_row(
    state: np.ndarray, point: np.ndarray, normal: np.ndarray, row: np.ndarray
) -> float:
    """Height of a point over a plane through the origin, and its derivative.

    Args:
        state: flat state.
        point: (3,), metres, LiDAR frame.
        normal: (3,), world.
        row: (12,), takes the derivative by rotation, position, extrinsic rotation
            and extrinsic translation.

    Returns:
        ``n · world_from_lidar(point)``, metres.
    """
    height = 0.0
    for a in range(3):
        # Normal in the IMU frame, then in the LiDAR frame.
        row[9 + a] = (
            state[a] * normal[0] + state[3 + a] * normal[1] + state[6 + a] * normal[2]
        )
        row[3 + a] = normal[a]
        height += normal[a] * state[9 + a]
    bx, by, bz = row[9], row[10], row[11]
    px = py = pz = 0.0
    for a in range(3):
        px += state[24 + a] * point[a]
        py += state[27 + a] * point[a]
        pz += state[30 + a] * point[a]
    px, py, pz = px + state[33], py + state[34], pz + state[35]
    height += bx * px + by * py + bz * pz
    # (R Exp(e) p) · n changes by e · (p x R'n).
    row[0], row[1], row[2] = py * bz - pz * by, pz * bx - px * bz, px * by - py * bx
    lx = state[24] * bx + state[27] * by + state[30] * bz
    ly = state[25] * bx + state[28] * by + state[31] * bz
    lz = state[26] * bx + state[29] * by + state[32] * bz
    row[6] = point[1] * lz - point[2] * ly
    row[7] = point[2] * lx - point[0] * lz
    row[8] = point[0] * ly - point[1] * lx
    return height


@njit(cache=True, nogil=True, inline="always")
def lidar_normal(state: np.ndarray, row: np.ndarray, out: np.ndarray) -> None:
    """The plane's normal in the LiDAR frame, from the row's last three entries."""
    for a in range(3):
        out[a] = (
            state[24 + a] * row[9] + state[27 + a] * row[10] + state[30 + a] * row[11]
        )


@njit(cache=True, nogil=True, inline="always")
def spread(scatter: np.ndarray, n: np.ndarray) -> float:
    """Variance of a voxel's points along ``n``."""
    return (
        scatter[0] * n[0] * n[0]
        + scatter[3] * n[1] * n[1]
        + scatter[5] * n[2] * n[2]
        + 2.0
        * (
            scatter[1] * n[0] * n[1]
            + scatter[2] * n[0] * n[2]
            + scatter[4] * n[1] * n[2]
        )
    )


@njit(cache=True, nogil=True)
def find_planes(
    state: np.ndarray,
    means: np.ndarray,
    cells: np.ndarray,
    table: np.ndarray,
    keys: np.ndarray,
    voxel: float,
    limits: np.ndarray,
    planes: np.ndarray,
    status: np.ndarray,
) -> None:
    """Search the map around every point; fills ``planes (m, 5)``, ``status (m,)``."""
    world = state[0:9].reshape(3, 3) @ state[24:33].reshape(3, 3)
    shift = state[0:9].reshape(3, 3) @ state[33:36] + state[9:12]
    nearest, distances2 = np.empty(NEIGHBOURS, np.int64), np.empty(NEIGHBOURS)
    for i in range(len(means)):
        p = means[i]
        x = world[0, 0] * p[0] + world[0, 1] * p[1] + world[0, 2] * p[2] + shift[0]
        y = world[1, 0] * p[0] + world[1, 1] * p[1] + world[1, 2] * p[2] + shift[1]
        z = world[2, 0] * p[0] + world[2, 1] * p[1] + world[2, 2] * p[2] + shift[2]
        found = nearest_cells(x, y, z, cells, table, keys, voxel, nearest, distances2)
        flat = found == NEIGHBOURS and fit_plane(nearest, cells, limits, planes[i])
        status[i] = OUTLIER if flat else NO_PLANE


@njit(cache=True, nogil=True)
def accumulate(
    state: np.ndarray,
    prior: np.ndarray,
    means: np.ndarray,
    scatters: np.ndarray,
    counts: np.ndarray,
    planes: np.ndarray,
    status: np.ndarray,
    limits: np.ndarray,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sum the normal equations of all inliers and mark who they are.

    Args:
        state: flat state.
        prior: (6, 6), covariance of rotation and position that the gate allows for.
        means: (m, 3), metres, LiDAR frame.
        scatters: (m, 6), m².
        counts: (m,).
        planes: (m, 5), of `find_planes`.
        status: (m,), changed: NO_PLANE, OUTLIER or INLIER.
        limits: `MatchConfig.as_array`.

    Returns:
        H'R⁻¹H ``(12, 12)``, H'R⁻¹z ``(12,)``, and the sums of inliers, planes,
        squared residuals (m²) of inliers, and squared normalized residuals.
    """
    information, gradient = np.zeros((12, 12)), np.zeros(12)
    sums = np.zeros(4)
    row, normal = np.empty(12), np.empty(3)
    for i in range(len(means)):
        if status[i] == NO_PLANE:
            continue
        sums[1] += 1.0
        residual = residual_row(state, means[i], planes[i, 0:3], row) - planes[i, 3]
        lidar_normal(state, row, normal)
        scatter = max(limits[0] ** 2, spread(scatters[i], normal))
        variance = scatter / counts[i] + 0.5 * planes[i, 4] + limits[1] ** 2
        allowed = variance
        for a in range(6):
            for b in range(6):
                allowed += row[a] * prior[a, b] * row[b]
        limit = limits[4] * np.sqrt(allowed) + limits[5]
        status[i] = OUTLIER
        if abs(residual) > limit or scatter > limits[6] ** 2:
            continue
        status[i] = INLIER
        sums[0] += 1.0
        sums[2] += residual * residual
        sums[3] += residual * residual / variance
        weight = limits[7] / variance
        for a in range(12):
            scaled = weight * row[a]
            gradient[a] += scaled * residual
            for b in range(a + 1):
                information[a, b] += scaled * row[b]
    for a in range(12):
        for b in range(a):
            information[b, a] = information[a, b]
    return information, gradient, sums


@dataclass(frozen=True)
class Evidence:
    """What a scan says about the state.

    Attributes:
        information: (23, 23), H'R⁻¹H.
        gradient: (23,), H'R⁻¹z.
        matches: inliers.
        planes: points with a plane beside them.
        residual: metres, root mean square of the inliers.
        normalized: root mean square of residual over its expected deviation.
    """

    information: np.ndarray
    gradient: np.ndarray
    matches: int
    planes: int
    residual: float
    normalized: float

    @property
    def agreement(self) -> float:
        """Share of the planes that the points lie on."""
        return self.matches / max(self.planes, 1)


class Matcher:
    """Keeps the planes of one scan between the iterations of an update."""

    def __init__(self, thinned: Thinned, world: VoxelMap, config: MatchConfig) -> None:
        """Nothing is searched before the first `evidence`."""
        self._thinned, self._map = thinned, world
        self._limits = config.as_array()
        self._planes = np.zeros((len(thinned.means), 5))
        self.status = np.zeros(len(thinned.means), np.int64)

    def evidence(
        self, state: np.ndarray, prior: np.ndarray, *, search: bool
    ) -> Evidence:
        """Match the scan at ``state``; ``prior (23, 23)`` widens the gate."""
        thinned, world = self._thinned, self._map
        if search:
            find_planes(
                state,
                thinned.means,
                world.cells,
                world.table,
                world.keys,
                world.config.voxel,
                self._limits,
                self._planes,
                self.status,
            )
        block, part, sums = accumulate(
            state,
            np.ascontiguousarray(prior[:6, :6]),
            thinned.means,
            thinned.scatters,
            thinned.counts,
            self._planes,
            self.status,
            self._limits,
        )
        information, gradient = np.zeros((ERROR_SIZE, ERROR_SIZE)), np.zeros(ERROR_SIZE)
        information[np.ix_(COLUMNS, COLUMNS)] = block
        gradient[COLUMNS] = part
        inliers, planes = int(sums[0]), int(sums[1])
        return Evidence(
            information,
            gradient,
            inliers,
            planes,
            float(np.sqrt(sums[2] / max(inliers, 1))),
            float(np.sqrt(sums[3] / max(inliers, 1))),
        )
