"""A picture of an odometry's trajectory: from above, and each axis over time."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from openclone.evaluation.plots import REFERENCE, ROBOT, render
from openclone.odometry.trajectory import Trajectory, rigid_alignment, sample_at
from openclone.spatial import rotations

_MAX_POINTS = 5_000


def trajectory_picture(
    estimate: Trajectory, reference: Trajectory | None, title: str
) -> bytes:
    """PNG bytes; the reference, if any, is aligned to the estimate first."""
    estimate = _thinned(estimate)
    known = _aligned(reference, estimate) if reference is not None else None
    start_ns = int(estimate.stamps_ns[0])

    def draw(figure: Figure) -> None:
        figure.suptitle(title)
        grid = figure.add_gridspec(4, 2, width_ratios=(1.2, 1))
        above = figure.add_subplot(grid[:, 0])
        above.set(xlabel="x, m", ylabel="y, m")
        above.set_aspect("equal", adjustable="datalim")
        names = ("x, m", "y, m", "z, m", "yaw, °")
        rows = [figure.add_subplot(grid[i, 1]) for i in range(4)]
        for path, color, width, label in (
            (known, REFERENCE, 3.0, "reference, aligned"),
            (estimate, ROBOT, 1.2, "odometry"),
        ):
            if path is None or not len(path):
                continue
            style = {"color": color, "lw": width, "label": label}
            above.plot(path.positions[:, 0], path.positions[:, 1], **style)
            seconds = (path.stamps_ns - start_ns) * 1e-9
            for axes, values in zip(rows, _columns(path), strict=True):
                axes.plot(seconds, values, **style)
        above.plot(*estimate.positions[0, :2], "o", color=ROBOT, ms=5)
        above.legend(frameon=False)
        for axes, name in zip(rows, names, strict=True):
            axes.set_ylabel(name)
            axes.label_outer()
        rows[-1].set_xlabel("seconds")

    return render(draw, 9.0, 4.8)


def _columns(path: Trajectory) -> list[np.ndarray]:
    yaw = np.degrees(np.unwrap(np.asarray(rotations.yaw(path.quats))))
    return [*path.positions.T, yaw]


def _thinned(path: Trajectory) -> Trajectory:
    step = -(-len(path) // _MAX_POINTS)
    if step <= 1:
        return path
    return Trajectory(
        path.stamps_ns[::step], path.positions[::step], path.quats[::step]
    )


def _aligned(reference: Trajectory, estimate: Trajectory) -> Trajectory | None:
    """The reference at the estimate's times, moved into the estimate's world."""
    if not len(reference):
        return None
    real = sample_at(reference, estimate.stamps_ns)
    keep = np.isin(estimate.stamps_ns, real.stamps_ns)
    if len(real) < 3:
        return None
    turn, shift = rigid_alignment(real.positions, estimate.positions[keep])
    quats = rotations.multiply(rotations.from_matrix(turn), real.quats)
    return Trajectory(
        real.stamps_ns, real.positions @ turn.T + shift, np.asarray(quats)
    )
