"""The report's plots, as PNG pictures (matplotlib, no display needed)."""

from __future__ import annotations

import io
from collections.abc import Callable, Mapping

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from openclone.evaluation.metrics import Metrics
from openclone.evaluation.tracking import ClipResult

ROBOT = "#1f6feb"
REFERENCE = "#8b949e"
LIMIT = "#d1242f"
_MAX_PATHS = 9


def render(draw: Callable[[Figure], None], width: float, height: float) -> bytes:
    """PNG bytes of a figure of ``width`` x ``height`` inches that ``draw`` fills."""
    figure = Figure(figsize=(width, height), dpi=110, layout="constrained")
    FigureCanvasAgg(figure)
    draw(figure)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return buffer.getvalue()


def category_bars(categories: Mapping[str, Metrics], paper_mm: float) -> bytes:
    """Success rate and position errors by category."""
    names = list(categories)
    rows = np.arange(len(names))

    def draw(figure: Figure) -> None:
        left, right = figure.subplots(1, 2, sharey=True, width_ratios=(1, 2))
        success = [100 * categories[name].sr for name in names]
        left.barh(rows, success, color=ROBOT)
        left.set(xlabel="success rate, %", xlim=(0, 100), yticks=rows)
        left.set_yticklabels(names)
        left.invert_yaxis()
        for offset, key, label, alpha in (
            (-0.2, "mpkpe_mm", "MPKPE", 1.0),
            (0.2, "r_mpkpe_mm", "R-MPKPE", 0.45),
        ):
            values = [getattr(categories[name], key) for name in names]
            right.barh(
                rows + offset, values, 0.4, color=ROBOT, alpha=alpha, label=label
            )
        right.axvline(paper_mm, color=LIMIT, ls="--", lw=1, label="paper's MPKPE")
        right.set(xlabel="position error, mm")
        right.legend(frameon=False, loc="lower right")
        tidy(left, right)

    return render(draw, 8.5, 1.2 + 0.34 * len(names))


def paths(clips: Mapping[str, ClipResult]) -> bytes:
    """Head paths from above, target and robot, of the clips that travel furthest."""

    def travel(result: ClipResult) -> float:
        way = result.reference_head_w[:, :2]
        return float(np.linalg.norm(way - way[0], axis=1).max())

    chosen = sorted(clips.items(), key=lambda item: -travel(item[1]))[:_MAX_PATHS]
    columns = min(3, len(chosen))
    rows = -(-len(chosen) // columns)

    def draw(figure: Figure) -> None:
        grid = figure.subplots(rows, columns, squeeze=False)
        for axes in grid.flat[len(chosen) :]:
            axes.axis("off")
        for axes, (name, result) in zip(grid.flat, chosen, strict=False):
            wanted, robot = result.reference_head_w, result.head_w
            axes.plot(wanted[:, 0], wanted[:, 1], color=REFERENCE, lw=3, label="target")
            axes.plot(robot[:, 0], robot[:, 1], color=ROBOT, lw=1.2, label="robot")
            axes.plot(*robot[0, :2], "o", color=ROBOT, ms=4)
            if result.metrics.sr < 1:
                axes.plot(*robot[-1, :2], "x", color=LIMIT, ms=8, mew=2)
            axes.set_title(name, fontsize=8)
            axes.set_aspect("equal", adjustable="datalim")
            axes.tick_params(labelsize=7)
            tidy(axes)
        grid[0, 0].legend(frameon=False, fontsize=7)
        figure.supxlabel("x, m", fontsize=8)
        figure.supylabel("y, m", fontsize=8)

    return render(draw, 2.9 * columns, 2.6 * rows)


def error_over_time(clips: Mapping[str, ClipResult], period: float) -> bytes:
    """Mean key-body error over time, a line per clip; a cross where it failed."""

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        alpha = max(0.15, min(0.9, 4.0 / len(clips)))
        for result in clips.values():
            time_s = (1 + np.arange(len(result.error_mm))) * period
            axes.plot(time_s, result.error_mm, color=ROBOT, lw=1, alpha=alpha)
            if result.metrics.sr < 1:
                axes.plot(time_s[-1], result.error_mm[-1], "x", color=LIMIT, mew=2)
        axes.set(xlabel="time, s", ylabel="position error, mm", ylim=(0, None))
        tidy(axes)

    return render(draw, 8.5, 2.8)


def tick_histogram(ticks_ms: np.ndarray, deadline_ms: float) -> bytes:
    """How long the ticks of the control loop took."""

    def draw(figure: Figure) -> None:
        axes = figure.subplots()
        top = max(float(ticks_ms.max()), 5.0)
        axes.hist(ticks_ms, bins=np.linspace(0, top, 60).tolist(), color=ROBOT)
        p99 = float(np.percentile(ticks_ms, 99))
        axes.axvline(p99, color=LIMIT, ls="--", lw=1, label=f"p99 {p99:.2f} ms")
        axes.set(
            xlabel=f"tick duration, ms (deadline {deadline_ms:.0f} ms)",
            ylabel="ticks",
            yscale="log",
        )
        axes.legend(frameon=False)
        tidy(axes)

    return render(draw, 8.5, 2.4)


def tidy(*all_axes: object) -> None:
    """Take away what does not carry data from ``all_axes``."""
    for axes in all_axes:
        axes.spines[["top", "right"]].set_visible(False)  # type: ignore[attr-defined]
        axes.grid(alpha=0.25, lw=0.6)  # type: ignore[attr-defined]
