"""Keep the zero-moment point under the feet: a scaled human would fall over.

A motion shrunk in space but not in time is not one that gravity allows. The robot is
about 0.7 times as tall, so its centre of mass, at the human's scaled distance from the
foot, falls aside 1 / 0.7 times as fast as the scaled motion says. The body therefore
has to move aside, usually towards the standing foot. (Kajita et al., ICRA 2003, solve
the same equation for walking patterns.)
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_banded
from scipy.spatial import ConvexHull

from openclone.motion.contacts import smooth

GRAVITY = 9.81
_PADDING_S = 1.5
"""Seconds of rest at both ends, in which a correction fades."""
_SMOOTH_S = 0.05
"""Seconds, width of the Gaussian over a path before its accelerations are taken."""
_LEAST_LIFT = 2.0
"""m/s²; with less than a fifth of the weight the zero-moment point means nothing."""
_INNER = 0.7
"""Share of the soles' length and width that is to carry the weight."""


def balancing_shift(
    com: np.ndarray,
    corners: np.ndarray,
    contact: np.ndarray,
    fps: float,
    most: float,
) -> np.ndarray:
    """How far the centre of mass must move aside for balance.

    Args:
        com: (T, 3), metres, world: the centre of mass as it would be.
        corners: (T, 2, 4, 2), metres, world: of the left and the right sole.
        contact: (T, 2), they stand.
        fps: frames per second.
        most: metres; larger shifts are bent towards this limit.

    Returns:
        (T, 2), metres, world.
    """
    path = smooth(com, _SMOOTH_S * fps, going_on=True)
    speed = np.gradient(path, axis=0) * fps
    acceleration = np.gradient(speed, axis=0) * fps
    lift = np.maximum(GRAVITY + acceleration[:, 2], _LEAST_LIFT)
    reach = (path[:, 2] / lift)[:, None]
    zmp = path[:, :2] - reach * acceleration[:, :2]
    wanted = zmp.copy()
    for frame, stands in enumerate(contact):
        if stands.any():
            soles = corners[frame, stands]
            centres = soles.mean(axis=1, keepdims=True)
            ground = (centres + _INNER * (soles - centres)).reshape(-1, 2)
            wanted[frame] = nearest_inside(zmp[frame], ground)
    # Nothing pushes a body in flight: its speed stays.
    flies = ~contact.any(axis=1)
    force = lift[:, None] * (wanted - zmp)
    force[flies] = path[flies, 2:] * acceleration[flies, :2]
    lift = np.where(flies, 0.0, lift)
    pad = round(_PADDING_S * fps)
    shift = pendulum_path(
        np.pad(force, ((pad, pad), (0, 0))),
        np.pad(path[:, 2], pad, mode="edge"),
        np.pad(lift, pad, constant_values=GRAVITY),
        fps,
    )[pad:-pad]
    length = np.linalg.norm(shift, axis=1, keepdims=True)
    return shift * most * np.tanh(length / most) / np.maximum(length, 1e-9)


def pendulum_path(
    force: np.ndarray, height: np.ndarray, lift: np.ndarray, fps: float
) -> np.ndarray:
    """Where an inverted pendulum's mass is: ``lift x - height x'' = force``.

    Args:
        force: (T, 2), per kilogram, m²/s², world; ``lift`` times the zero-moment point.
        height: (T,), metres, of the mass.
        lift: (T,), g + z'', m/s².
        fps: frames per second.

    Returns:
        x (T, 2), metres, world; at rest above the point of pressure at both ends.
    """
    bands = np.zeros((3, len(force)))
    stiffness = height * fps**2
    bands[0, 2:] = -stiffness[1:-1]
    bands[1] = lift + 2.0 * stiffness
    bands[2, :-2] = -stiffness[1:-1]
    right = force.copy()
    bands[1, [0, -1]] = 1.0
    right[[0, -1]] = force[[0, -1]] / lift[[0, -1], None]
    return solve_banded((1, 1), bands, right)


def nearest_inside(point: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """The point (2,) of the convex hull of ``corners (n, 2)`` nearest to ``point``."""
    hull = ConvexHull(corners)
    offsets = hull.equations[:, :2] @ point + hull.equations[:, 2]
    if offsets.max() <= 0.0:
        return point
    start = corners[hull.vertices]
    along = np.roll(start, -1, axis=0) - start
    share = ((point - start) * along).sum(1) / (along * along).sum(1)
    feet = start + np.clip(share, 0.0, 1.0)[:, None] * along
    return feet[np.argmin(np.linalg.norm(feet - point, axis=1))]
