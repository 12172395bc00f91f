"""The report folder: ``report.html`` with table and plots, and the figures as JSON."""

from __future__ import annotations

import json
from dataclasses import dataclass, field
from html import escape
from pathlib import Path

import numpy as np

from openclone.evaluation.page import page, picture, table
from openclone.evaluation.tracking import TrackingReport
from openclone.evaluation.tracking_table import COLUMNS as COLUMNS
from openclone.evaluation.tracking_table import (
    HEAD,
    PAPER_ROWS,
    TrackingSetup,
    category_rows,
    comparison_rows,
)
from openclone.evaluation.tracking_table import figures as tracking_figures
from openclone.evaluation.tracking_table import table_row as table_row
from openclone.robot.model import CONTROL_PERIOD

_PAPER_MPKPE_MM = PAPER_ROWS[-1][2]


@dataclass(frozen=True)
class Report:
    """What a report shows.

    Attributes:
        title: heading.
        intro: a paragraph: what was run, with which policy and data.
        tracking: the metrics.
        facts: label and value, e.g. of the control loop; shown as a table.
        ticks_ms: durations of the loop's ticks, if a loop ran.
        notes: things that did not work or that limit what the figures say.
        setup: how a data set was run; adds the table by category.
    """

    title: str
    intro: str
    tracking: TrackingReport
    facts: tuple[tuple[str, str], ...] = ()
    ticks_ms: np.ndarray | None = None
    notes: tuple[str, ...] = field(default=())
    setup: TrackingSetup | None = None


def write_json(data: dict[str, object], path: Path) -> None:
    """Write strict JSON (no NaN); the folder is made if need be."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(data, indent=2, allow_nan=False) + "\n")


def write_report(report: Report, folder: Path) -> Path:
    """Write ``report.html`` and ``metrics.json`` into ``folder``.

    A ``video.mp4`` and a ``frame.png`` that are already there are shown.

    Returns:
        The path of ``report.html``.
    """
    figures = report.tracking.to_json()
    if report.setup is not None:
        figures = tracking_figures(report.tracking, report.setup)
    write_json(figures, folder / "metrics.json")
    file = folder / "report.html"
    file.write_text(_page(report, folder), encoding="utf-8")
    return file


def _page(report: Report, folder: Path) -> str:
    from openclone.evaluation import plots

    tracking = report.tracking
    parts = [f"<h1>{escape(report.title)}</h1><p>{escape(report.intro)}</p>"]
    if (folder / "video.mp4").is_file():
        poster = ' poster="frame.png"' if (folder / "frame.png").is_file() else ""
        parts.append(f'<video src="video.mp4"{poster} controls muted loop></video>')
        parts.append(
            "<p class=small>Grey: the robot. Blue: the reference it never sees. "
            "Balls with axes: the targets of head and hands, all that it is told.</p>"
        )
    parts.append(_metric_table(tracking))
    parts += [f"<p class=note>{escape(note)}</p>" for note in report.notes]
    categories = tracking.categories
    bars = plots.category_bars(categories, _PAPER_MPKPE_MM)
    parts += ["<h2>By category</h2>", picture(bars, "errors by category")]
    if report.setup is not None:
        parts += _category_table(tracking, report.setup)
    from_above = plots.paths(tracking.clips)
    parts += ["<h2>Head paths from above</h2>", picture(from_above, "paths")]
    over_time = plots.error_over_time(tracking.clips, CONTROL_PERIOD)
    parts += ["<h2>Error over time</h2>", picture(over_time, "error over time")]
    if report.facts or report.ticks_ms is not None:
        parts.append("<h2>Control loop</h2>")
        parts.append(table(("", ""), list(report.facts)))
    if report.ticks_ms is not None:
        ticks = plots.tick_histogram(report.ticks_ms, 1000 * CONTROL_PERIOD)
        parts.append(picture(ticks, "tick durations"))
    parts += ["<h2>Clips</h2>", _clip_table(tracking)]
    return page(report.title, parts)


def _category_table(tracking: TrackingReport, setup: TrackingSetup) -> list[str]:
    rows = [*category_rows(tracking, setup), *comparison_rows(tracking, setup)]
    conditions = escape(setup.conditions(tracking.num_seeds))
    parts = [f"<p class=small>{conditions}</p>", table(("", *HEAD), rows)]
    if setup.left_out:
        names = ", ".join(sorted(setup.left_out))
        parts.append(
            "<p class=small>Left out, because the retargeting could not make a sound "
            f"motion of the G1 of them: {escape(names)}.</p>"
        )
    return parts


def _metric_table(tracking: TrackingReport) -> str:
    ours = (f"OpenClone, {len(tracking.clips)} clips", *table_row(tracking.overall))
    paper = [
        (f"paper: {row[0]}", f"{row[1]:.0f}", *(f"{value:.2f}" for value in row[2:]))
        for row in PAPER_ROWS
    ]
    head = ("", *COLUMNS)
    text = (
        "<p class=small>The paper's figures (Table 1) were measured on its own motions "
        "and simulator: they show the scale, not a contest.</p>"
    )
    return table(head, [ours, *paper], first_bold=True) + text


def _clip_table(tracking: TrackingReport) -> str:
    rows = [
        (
            name,
            result.category,
            f"{result.metrics.seconds:.1f}",
            *table_row(result.metrics),
            f"{result.metrics.drift_mm:.0f}",
        )
        for name, result in tracking.clips.items()
    ]
    head = ("clip", "category", "s", *COLUMNS, "final drift, mm")
    return table(head, rows)
