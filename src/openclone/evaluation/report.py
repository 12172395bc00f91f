"""The report folder: ``report.html`` with table and plots, and the figures as JSON."""

from __future__ import annotations

import base64
import json
from dataclasses import dataclass, field
from html import escape
from pathlib import Path

import numpy as np

from openclone.evaluation.metrics import Metrics
from openclone.evaluation.tracking import TrackingReport
from openclone.robot.model import CONTROL_PERIOD

PAPER_ROWS = (
    ("CLONE, MLP student", 100.0, 113.97, 35.55, 245.11, 4.73),
    ("CLONE, OmniH2O data", 100.0, 102.20, 41.07, 309.65, 4.61),
    ("CLONE", 100.0, 87.84, 33.30, 227.17, 3.61),
)
"""Table 1 of the paper: SR %, MPKPE mm, R-MPKPE mm, E_vel mm/s, E_hand x 100."""
COLUMNS = ("SR, %", "MPKPE, mm", "R-MPKPE, mm", "E_vel, mm/s", "E_hand x 100")
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
    """

    title: str
    intro: str
    tracking: TrackingReport
    facts: tuple[tuple[str, str], ...] = ()
    ticks_ms: np.ndarray | None = None
    notes: tuple[str, ...] = field(default=())


def table_row(metrics: Metrics) -> tuple[str, ...]:
    """The five figures of section 4.1 as printed, in the order of `COLUMNS`."""
    return (
        f"{100 * metrics.sr:.0f}",
        f"{metrics.mpkpe_mm:.1f}",
        f"{metrics.r_mpkpe_mm:.1f}",
        f"{metrics.e_vel_mm_s:.0f}",
        f"{metrics.e_hand_x100:.2f}",
    )


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
    write_json(report.tracking.to_json(), folder / "metrics.json")
    page = folder / "report.html"
    page.write_text(_page(report, folder), encoding="utf-8")
    return page


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
    parts += ["<h2>By category</h2>", _inline(bars, "errors by category")]
    from_above = plots.paths(tracking.clips)
    parts += ["<h2>Head paths from above</h2>", _inline(from_above, "paths")]
    over_time = plots.error_over_time(tracking.clips, CONTROL_PERIOD)
    parts += ["<h2>Error over time</h2>", _inline(over_time, "error over time")]
    if report.facts or report.ticks_ms is not None:
        parts.append("<h2>Control loop</h2>")
        parts.append(_table(("", ""), list(report.facts)))
    if report.ticks_ms is not None:
        ticks = plots.tick_histogram(report.ticks_ms, 1000 * CONTROL_PERIOD)
        parts.append(_inline(ticks, "tick durations"))
    parts += ["<h2>Clips</h2>", _clip_table(tracking)]
    title = escape(report.title)
    return _SKELETON.format(title=title, body="\n".join(parts))


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
    return _table(head, [ours, *paper], first_bold=True) + text


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
    return _table(head, rows)


def _table(
    head: tuple[str, ...], rows: list[tuple[str, ...]], first_bold: bool = False
) -> str:
    def cells(row: tuple[str, ...], tag: str) -> str:
        return "".join(f"<{tag}>{escape(cell)}</{tag}>" for cell in row)

    lines = [f"<tr>{cells(head, 'th')}</tr>"] if any(head) else []
    for index, row in enumerate(rows):
        style = " class=ours" if first_bold and index == 0 else ""
        lines.append(f"<tr{style}>{cells(row, 'td')}</tr>")
    return f"<table>{''.join(lines)}</table>"


def _inline(png: bytes, alt: str) -> str:
    data = base64.b64encode(png).decode()
    return f'<img alt="{escape(alt)}" src="data:image/png;base64,{data}">'


_SKELETON = """<!doctype html>
<html lang="en"><head><meta charset="utf-8"><title>{title}</title>
<meta name="viewport" content="width=device-width, initial-scale=1"><style>
body {{ font: 15px/1.5 system-ui, sans-serif; max-width: 900px; margin: 2rem auto;
  padding: 0 1rem; color: #1f2328; }}
h1 {{ font-size: 1.6rem; }} h2 {{ font-size: 1.15rem; margin-top: 2rem; }}
table {{ border-collapse: collapse; width: 100%; margin: 1rem 0; font-size: 13px; }}
th, td {{ text-align: right; padding: .3rem .6rem; border-bottom: 1px solid #d1d9e0; }}
th:first-child, td:first-child {{ text-align: left; }}
.ours {{ font-weight: 600; background: #ddf4ff; }}
.small {{ color: #59636e; font-size: 13px; }}
.note {{ border-left: 3px solid #d1242f; padding-left: .7rem; }}
img, video {{ max-width: 100%; height: auto; }} video {{ width: 640px; }}
</style></head><body>
{body}
</body></html>
"""
