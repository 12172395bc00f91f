"""Plots of the squats and of the pushes, as PNG pictures."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from openclone.evaluation.plots import LIMIT, REFERENCE, ROBOT, render, tidy
from openclone.robot.model import CONTROL_PERIOD

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from openclone.evaluation.pushes import PushReport, PushResult
    from openclone.evaluation.squat import SquatLevel, SquatReport

_FIG_3 = (
    ("mpkpe_mm", "MPKPE, mm"),
    ("r_mpkpe_mm", "R-MPKPE, mm"),
    ("e_vel_mm_s", "E_vel, mm/s"),
    ("e_hand_x100", "E_hand x 100"),
)


def head_heights(report: SquatReport, tolerance_m: float) -> bytes:
    """How low the head came: over time in the deepest squats, and at all heights."""
    deepest = min(report.operator, key=lambda level: level.target_m)

    def draw(figure: Figure) -> None:
        left, right = figure.subplots(1, 2)
        for index, trial in enumerate(deepest.trials):
            time_s = (1 + np.arange(len(trial.head_m))) * CONTROL_PERIOD
            names = ("commanded", "robot") if index == 0 else (None, None)
            left.plot(time_s, trial.target_m, color=REFERENCE, lw=1, label=names[0])
            left.plot(time_s, trial.head_m, color=ROBOT, lw=1, label=names[1])
            if trial.fell:
                left.plot(time_s[-1], trial.head_m[-1], "x", color=LIMIT, mew=2)
        left.set(
            xlabel="time, s",
            ylabel="head height, m",
            ylim=(0, 1.35),
            title=f"operator's head at {deepest.operator_m:.1f} m",
        )
        left.legend(frameon=False)
        _reached(right, report.stances, "Fig. 3: heights of the robot", "o")
        _reached(right, report.operator, "heights of the operator, scaled", "s")
        line = np.array([0.35, 1.3])
        right.plot(line, line, color=REFERENCE, lw=1)
        right.fill_between(
            line, line - tolerance_m, line + tolerance_m, color=REFERENCE, alpha=0.2
        )
        right.set(
            xlabel="commanded head height, m",
            ylabel="reached, m",
            title=f"at the bottom (grey: ± {100 * tolerance_m:.0f} cm)",
        )
        right.legend(frameon=False)
        tidy(left, right)

    return render(draw, 8.5, 3.6)


def _reached(axes: Axes, levels: Sequence[SquatLevel], label: str, marker: str) -> None:
    some = [level for level in levels if len(level.low_m)]
    wanted = [level.target_m for level in some]
    means = np.array([level.low_m.mean() for level in some])
    errors = np.array(
        [
            (mean - level.low_m.min(), level.low_m.max() - mean)
            for level, mean in zip(some, means, strict=True)
        ]
    ).reshape(-1, 2)
    color = ROBOT if marker == "o" else "#bf8700"
    axes.errorbar(
        wanted, means, errors.T, fmt=marker, color=color, ms=5, capsize=2, label=label
    )


def stance_errors(report: SquatReport, paper: Sequence[float]) -> bytes:
    """Fig. 3: the errors of section 4.1 by head height.

    Args:
        report: the squats.
        paper: the paper's means over all its motions (Table 1), dashed lines.
    """

    def draw(figure: Figure) -> None:
        grid = figure.subplots(1, len(_FIG_3))
        for axes, (key, label), mean in zip(grid, _FIG_3, paper, strict=True):
            some = [level for level in report.stances if level.metrics is not None]
            heights = [level.target_m for level in some]
            values = [getattr(level.metrics, key) for level in some]
            axes.plot(heights, values, "o-", color=ROBOT, ms=4)
            axes.axhline(mean, color=LIMIT, ls="--", lw=1)
            axes.set_title(label, fontsize=9)
            axes.set(xlabel="head height, m", ylim=(0, None))
            axes.invert_xaxis()
            axes.tick_params(labelsize=8)
            tidy(axes)

    return render(draw, 8.5, 2.4)


def pushes(report: PushReport) -> bytes:
    """Every push as a point in the robot's frame, and falls by its size."""
    conditions = report.conditions

    def draw(figure: Figure) -> None:
        grid = figure.subplots(1, len(conditions) + 1, squeeze=False)[0]
        for axes, (name, result) in zip(grid, conditions.items(), strict=False):
            _push_map(axes, result, 1.1 * report.config.speed)
            axes.set_title(f"{name}: {result.falls} of {len(result.pushes)} fell")
        for name, result in conditions.items():
            rows = [row for row in result.by_speed() if row[2]]
            middle = [0.5 * (low + high) for low, high, _, _ in rows]
            share = [100.0 * falls / count for _, _, count, falls in rows]
            grid[-1].plot(middle, share, "o-", label=name)
        grid[-1].axhline(5.0, color=LIMIT, ls="--", lw=1, label="target, all sizes")
        grid[-1].set(xlabel="size of the push, m/s", ylabel="falls, %", ylim=(-3, 103))
        grid[-1].legend(frameon=False, fontsize=8)
        tidy(*grid)

    return render(draw, 3.3 * (len(conditions) + 1), 3.2)


def _push_map(axes: Axes, result: PushResult, limit: float) -> None:
    for fell, color, marker in ((False, ROBOT, "o"), (True, LIMIT, "x")):
        kicks = [push.kick_h for push in result.pushes if push.fell == fell]
        ahead, left = np.array(kicks).reshape(-1, 2).T
        axes.plot(
            -left, ahead, marker, color=color, ms=4, label="fell" if fell else "stayed"
        )
    axes.set_aspect("equal")
    axes.set(
        xlabel="push to the right, m/s",
        ylabel="push ahead, m/s",
        xlim=(-limit, limit),
        ylim=(-limit, 1.35 * limit),
    )
    axes.legend(frameon=False, fontsize=8, ncols=2, loc="upper center")
