"""From raw LiDAR points to the few that the filter matches.

Backward propagation brings each point to the end of its scan; then one Gaussian per
voxel (mean, scatter, number of points) stands for all points in it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numba import njit

from openclone.errors import InputError

TABLE_BITS = 16
"""Slots of the voxel table: 2¹⁶, far above the voxels of one scan."""
MAX_MEDIAN_RANGE = 1000.0
"""Metres; a median above it can only be a cloud in millimetres."""


@dataclass(frozen=True)
class ScanConfig:
    """What becomes of the points of one scan.

    Attributes:
        min_range: metres; nearer points are the robot itself.
        max_range: metres.
        voxel: metres, edge of the voxels that thin the scan.
        max_points: at most as many voxels are matched.
        max_span: seconds between the first and last point of a scan.
        overlap: seconds by which points may be older than the end of the scan
            before; older ones are dropped.
    """

    min_range: float = 0.3
    max_range: float = 70.0
    voxel: float = 0.2
    max_points: int = 3000
    max_span: float = 0.5
    overlap: float = 0.005


@dataclass(frozen=True)
class Scan:
    """A checked scan.

    Attributes:
        points: (n, 3) float64, metres, LiDAR frame; zeros and NaN still inside.
        stamps_ns: (n,) int64.
        start_ns: stamp of the oldest point.
        end_ns: stamp of the newest point; the scan's pose is for this moment.
    """

    points: np.ndarray
    stamps_ns: np.ndarray
    start_ns: int
    end_ns: int

    def moved(self, step_ns: int) -> Scan:
        """The same scan with its stamps moved."""
        return Scan(
            self.points,
            self.stamps_ns + step_ns,
            self.start_ns + step_ns,
            self.end_ns + step_ns,
        )


@dataclass(frozen=True)
class Thinned:
    """Gaussians of the voxels of one undistorted scan, LiDAR frame at its end.

    Attributes:
        means: (m, 3), metres.
        scatters: (m, 6), m², xx xy xz yy yz zz of the points around the mean.
        counts: (m,), points.
        returns: points inside the range limits.
        rejected: points dropped for NaN or infinity.
    """

    means: np.ndarray
    scatters: np.ndarray
    counts: np.ndarray
    returns: int
    rejected: int


def check_scan(points: Any, stamps_ns: Any, config: ScanConfig) -> Scan:
    """Refuse what cannot be a scan; see `FastLio.add_scan` for the arguments."""
    where = "add_scan"
    points = np.asarray(points)
    stamps = np.asarray(stamps_ns)
    if points.ndim != 2 or points.shape[1] != 3 or points.dtype.kind not in "fiu":
        raise InputError(
            f"points have shape {points.shape} and type {points.dtype}",
            where=where,
            remedy="pass an (N, 3) array of metres in the LiDAR frame",
        )
    if stamps.shape != (len(points),) or stamps.dtype.kind not in "iu":
        raise InputError(
            f"stamps_ns has shape {stamps.shape} and type {stamps.dtype} for "
            f"{len(points)} points",
            where=where,
            remedy="pass one whole number of nanoseconds per point",
        )
    if len(points) == 0:
        raise InputError("the scan is empty", where=where, remedy="leave it out")
    start, end = int(stamps.min()), int(stamps.max())
    if end - start > config.max_span * 1e9:
        raise InputError(
            f"the scan spans {(end - start) * 1e-9:.3f} s",
            where=where,
            remedy=f"cut scans to {config.max_span} s; stamps are nanoseconds",
        )
    points = np.ascontiguousarray(points, dtype=np.float64)
    sample = np.abs(points[:: max(1, len(points) // 500)]).max(axis=1)
    sample = sample[np.isfinite(sample) & (sample > 0.0)]
    if len(sample) and np.median(sample) > MAX_MEDIAN_RANGE:
        raise InputError(
            f"half of the points are beyond {MAX_MEDIAN_RANGE:.0f} m",
            where=where,
            remedy="pass metres, not millimetres",
        )
    return Scan(points, stamps.astype(np.int64), start, end)


@njit(cache=True, nogil=True)
def knot_motions(
    path: np.ndarray, lidar: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Each knot's motion, expressed in the LiDAR frame at the end of the path.

    Returns:
        Rotation ``(k, 3, 3)``, translation, velocity and half acceleration ``(k, 3)``.
    """
    knots = len(path)
    end_rot = path[knots - 1, 1:10].reshape(3, 3)
    end_pos = path[knots - 1, 10:13]
    rot_il, pos_il = lidar[0:9].reshape(3, 3), lidar[9:12]
    back = rot_il.T @ end_rot.T
    turn = np.empty((knots, 3, 3))
    shift = np.empty((knots, 3))
    speed = np.empty((knots, 3))
    bend = np.empty((knots, 3))
    for k in range(knots):
        turn[k] = back @ path[k, 1:10].reshape(3, 3)
        shift[k] = back @ (path[k, 10:13] - end_pos) - rot_il.T @ pos_il
        speed[k] = back @ path[k, 13:16]
        bend[k] = back @ (0.5 * path[k, 19:22])
    return turn, shift, speed, bend


@njit(cache=True, nogil=True)
def undistort(
    points: np.ndarray,
    times: np.ndarray,
    path: np.ndarray,
    lidar: np.ndarray,
    limits: np.ndarray,
) -> tuple[np.ndarray, int]:
    """Move points to the LiDAR frame at the end of the path (backward propagation).

    Args:
        points: (n, 3), metres, LiDAR frame at each point's own time.
        times: (n,), seconds on the clock of the path.
        path: (k, 22), knots of `filter.propagate`.
        lidar: (12,), IMU from LiDAR: rotation matrix, translation.
        limits: shortest and longest range, earliest time.

    Returns:
        The points that lie inside the limits ``(m, 3)``, and the number of points
        with NaN or infinite coordinates.
    """
    knots = len(path)
    rot_il, pos_il = lidar[0:9].reshape(3, 3), lidar[9:12]
    turn, shift, speed, bend = knot_motions(path, lidar)
    out = np.empty((len(points), 3))
    kept, rejected, k = 0, 0, 0
    near2, far2 = limits[0] ** 2, limits[1] ** 2
    inner, turned = np.empty(3), np.empty(3)
    for i in range(len(points)):
        x, y, z = points[i, 0], points[i, 1], points[i, 2]
        range2 = x * x + y * y + z * z
        if not np.isfinite(range2):
            rejected += 1
            continue
        time = times[i]
        if range2 < near2 or range2 > far2 or time < limits[2]:
            continue
        while k > 0 and path[k, 0] > time:
            k -= 1
        while k < knots - 2 and path[k + 1, 0] <= time:
            k += 1
        dt = time - path[k, 0]
        for a in range(3):
            inner[a] = (
                rot_il[a, 0] * x + rot_il[a, 1] * y + rot_il[a, 2] * z + pos_il[a]
            )
        turn_point(inner, path[k, 16:19], dt, turned)
        for a in range(3):
            out[kept, a] = (
                turn[k, a, 0] * turned[0]
                + turn[k, a, 1] * turned[1]
                + turn[k, a, 2] * turned[2]
                + shift[k, a]
                + (speed[k, a] + bend[k, a] * dt) * dt
            )
        kept += 1
    return out[:kept], rejected


@njit(cache=True, nogil=True, inline="always")
def turn_point(
    point: np.ndarray, rate: np.ndarray, period: float, out: np.ndarray
) -> None:
    """``out = Exp(rate * period) @ point``, series to fourth order of the angle."""
    wx, wy, wz = rate[0] * period, rate[1] * period, rate[2] * period
    angle2 = wx * wx + wy * wy + wz * wz
    a = 1.0 - angle2 / 6.0 * (1.0 - angle2 / 20.0)
    b = 0.5 - angle2 / 24.0 * (1.0 - angle2 / 30.0)
    cx = wy * point[2] - wz * point[1]
    cy = wz * point[0] - wx * point[2]
    cz = wx * point[1] - wy * point[0]
    out[0] = point[0] + a * cx + b * (wy * cz - wz * cy)
    out[1] = point[1] + a * cy + b * (wz * cx - wx * cz)
    out[2] = point[2] + a * cz + b * (wx * cy - wy * cx)


@njit(cache=True, nogil=True)
def thin(points: np.ndarray, voxel: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """One Gaussian per voxel: means ``(m, 3)``, scatters ``(m, 6)``, counts ``(m,)``.

    Voxels come in the order in which their first points appear.
    """
    mask = (1 << TABLE_BITS) - 1
    table = np.full(mask + 1, -1, np.int32)
    limit = mask // 2
    keys = np.empty(len(points), np.int64)
    sums = np.zeros((min(len(points), limit), 10))
    first = np.empty((min(len(points), limit), 3))
    count = 0
    for i in range(len(points)):
        ix = int(np.floor(points[i, 0] / voxel)) + (1 << 20)
        iy = int(np.floor(points[i, 1] / voxel)) + (1 << 20)
        iz = int(np.floor(points[i, 2] / voxel)) + (1 << 20)
        key = (ix << 42) | (iy << 21) | iz
        slot = (ix * 73856093 ^ iy * 19349669 ^ iz * 83492791) & mask
        while table[slot] >= 0 and keys[table[slot]] != key:
            slot = (slot + 1) & mask
        if table[slot] < 0:
            if count >= limit:
                continue
            table[slot] = count
            keys[count] = key
            first[count] = points[i]
            count += 1
        j = table[slot]
        # Relative to the voxel's first point, so that squares keep their digits.
        x, y, z = points[i] - first[j]
        row = sums[j]
        row[0] += 1.0
        row[1] += x
        row[2] += y
        row[3] += z
        row[4] += x * x
        row[5] += x * y
        row[6] += x * z
        row[7] += y * y
        row[8] += y * z
        row[9] += z * z
    return finish_gaussians(sums[:count], first[:count])


@njit(cache=True, nogil=True)
def finish_gaussians(
    sums: np.ndarray, first: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Means, scatters and counts from the sums of `thin`."""
    count = len(sums)
    means, scatters = np.empty((count, 3)), np.empty((count, 6))
    for j in range(count):
        n = sums[j, 0]
        mx, my, mz = sums[j, 1] / n, sums[j, 2] / n, sums[j, 3] / n
        means[j, 0], means[j, 1], means[j, 2] = mx, my, mz
        means[j] += first[j]
        scatters[j, 0] = sums[j, 4] / n - mx * mx
        scatters[j, 1] = sums[j, 5] / n - mx * my
        scatters[j, 2] = sums[j, 6] / n - mx * mz
        scatters[j, 3] = sums[j, 7] / n - my * my
        scatters[j, 4] = sums[j, 8] / n - my * mz
        scatters[j, 5] = sums[j, 9] / n - mz * mz
    return means, scatters, sums[:, 0].copy()


def prepare(
    scan: Scan, origin_ns: int, path: np.ndarray, lidar: np.ndarray, config: ScanConfig
) -> Thinned:
    """Undistort and thin a scan.

    Args:
        scan: the checked scan.
        origin_ns: zero of the path's clock.
        path: (k, 22), knots of `filter.propagate`, ending with the scan.
        lidar: (12,), IMU from LiDAR: rotation matrix, translation.
        config: limits.
    """
    times = (scan.stamps_ns - origin_ns) * 1e-9
    earliest = path[0, 0] - config.overlap
    limits = np.array((config.min_range, config.max_range, earliest))
    points, rejected = undistort(scan.points, times, path, lidar, limits)
    means, scatters, counts = thin(points, config.voxel)
    step = -(-len(means) // config.max_points) if len(means) else 1
    return Thinned(
        means[::step].copy(),
        scatters[::step].copy(),
        counts[::step].copy(),
        len(points),
        rejected,
    )
