"""Tables and report pages of the squats and of the pushes."""

from __future__ import annotations

from html import escape
from pathlib import Path

from openclone.evaluation.page import page, picture, table
from openclone.evaluation.pushes import TARGET_PERCENT, WINDOW_S, PushReport, PushResult
from openclone.evaluation.pushes import share_interval as interval
from openclone.evaluation.report import write_json
from openclone.evaluation.squat import TARGET_SR, TOLERANCE, SquatLevel, SquatReport
from openclone.evaluation.squat_reference import DEEPEST
from openclone.evaluation.tracking_table import PAPER_ROWS

SQUAT_HEAD = (
    "operator, m", "robot, m", "trials", "falls", "SR, %", "low enough, %",
    "SR and low enough, %", "reached, m", "MPKPE, mm", "R-MPKPE, mm",
)  # fmt: skip
PUSH_HEAD = (
    "pushes", "falls", "falls, %", "95 % interval", "later falls", "falls unpushed",
)  # fmt: skip


def squat_row(level: SquatLevel) -> tuple[str, ...]:
    """One height, in the order of `SQUAT_HEAD`."""
    low, known = level.low_m, level.metrics
    return (
        f"{level.operator_m:.2f}",
        f"{level.target_m:.2f}",
        str(len(level.trials)),
        str(sum(trial.fell for trial in level.trials)),
        f"{level.sr:.0f}",
        f"{level.reached:.0f}",
        f"{level.sr_reached:.0f}",
        f"{low.mean():.2f}" if len(low) else "-",
        f"{known.mpkpe_mm:.0f}" if known is not None else "-",
        f"{known.r_mpkpe_mm:.0f}" if known is not None else "-",
    )


def squat_summary(report: SquatReport) -> str:
    """The deepest squat beside its target, and how to read the table."""
    deepest = min(report.operator, key=lambda level: level.target_m)
    low = deepest.low_m
    reached = f"{low.mean():.2f} m" if len(low) else "-"
    return (
        f"operator's head at {deepest.operator_m:.2f} m = robot's at "
        f"{deepest.target_m:.2f} m: SR {deepest.sr:.0f} %, with the head within "
        f"{100 * TOLERANCE:.0f} cm of that {deepest.sr_reached:.0f} % "
        f"(target ≥ {TARGET_SR:.0f} %); reached on average {reached}.\n"
        "SR: no fall, head and hands within 1.5 m, upright again at the end. Below "
        f"{DEEPEST:.1f} m there is no whole-body reference (the height edit finds no "
        "sound pose with flat soles); only head and hands are commanded."
    )


def squat_text(report: SquatReport) -> str:
    """What the terminal shows."""
    widths = [max(len(name), 5) for name in SQUAT_HEAD]

    def line(cells: tuple[str, ...]) -> str:
        return "  ".join(f"{c:>{w}}" for c, w in zip(cells, widths, strict=True))

    stances = [line(squat_row(level)) for level in report.stances]
    operator = [line(squat_row(level)) for level in report.operator]
    titles = "heights of the robot (Fig. 3)", "heights of the operator"
    lines = [line(SQUAT_HEAD), titles[0], *stances, titles[1], *operator]
    return "\n".join([*lines, squat_summary(report)])


def write_squat_report(report: SquatReport, intro: str, folder: Path) -> Path:
    """Write ``report.html``, its pictures and ``metrics.json``; returns the page."""
    from openclone.evaluation import experiment_plots

    write_json(report.to_json(), folder / "metrics.json")
    heights = experiment_plots.head_heights(report, TOLERANCE)
    errors = experiment_plots.stance_errors(report, PAPER_ROWS[-1][2:])
    (folder / "heights.png").write_bytes(heights)
    (folder / "stances.png").write_bytes(errors)
    summary, reading = squat_summary(report).splitlines()
    parts = [
        f"<h1>Squats</h1><p>{escape(intro)}</p>",
        f"<p><b>{escape(summary)}</b></p>",
        picture(heights, "head heights"),
        f"<p class=small>{escape(reading)}</p>",
        "<h2>Heights of the robot (Fig. 3)</h2>",
        table(SQUAT_HEAD, [squat_row(level) for level in report.stances]),
        picture(errors, "errors by height"),
        "<p class=small>Dashed: the paper's means over all its motions (Table 1); "
        "its Fig. 3 is drawn, without numbers.</p>",
        "<h2>Heights of the operator, scaled to the robot</h2>",
        table(SQUAT_HEAD, [squat_row(level) for level in report.operator]),
    ]
    file = folder / "report.html"
    file.write_text(page("Squats", parts), encoding="utf-8")
    return file


def push_rows(report: PushReport) -> list[tuple[str, ...]]:
    """Condition, then `PUSH_HEAD`; the last row is for all conditions."""
    results = list(report.conditions.values())
    rows = [_push_row(name, [result]) for name, result in report.conditions.items()]
    return [*rows, _push_row("all", results)]


def _push_row(name: str, results: list[PushResult]) -> tuple[str, ...]:
    pushes = sum(len(result.pushes) for result in results)
    falls = sum(result.falls for result in results)
    low, high = interval(falls, pushes)
    return (
        name,
        str(pushes),
        str(falls),
        f"{100.0 * falls / max(pushes, 1):.0f}",
        f"{100 * low:.0f} - {100 * high:.0f}",
        str(sum(result.run.other_falls for result in results)),
        str(sum(result.quiet.falls for result in results)),
    )


def push_size_rows(report: PushReport) -> list[tuple[str, ...]]:
    """Size in m/s, then falls of pushes of that size for each condition."""
    tables = [result.by_speed() for result in report.conditions.values()]
    rows = []
    for some in zip(*tables, strict=True):
        cells = (f"{falls} of {count}" for _, _, count, falls in some)
        rows.append((f"{some[0][0]:.1f} - {some[0][1]:.1f}", *cells))
    return rows


def push_note(report: PushReport) -> str:
    """What was done."""
    return (
        f"Each horizontal axis even within ± {report.config.speed:g} m/s (Table A2), "
        f"every {report.config.shortest_s:g} to {report.config.longest_s:g} s; a fall "
        f"within {WINDOW_S:g} s counts, later ones stand apart; "
        f"target ≤ {TARGET_PERCENT:g} %."
    )


def push_text(report: PushReport) -> str:
    """What the terminal shows."""
    lines = [" " * 14 + "".join(f"{name:>16}" for name in PUSH_HEAD)]
    for row in push_rows(report):
        lines.append(f"{row[0]:14}" + "".join(f"{cell:>16}" for cell in row[1:]))
    lines.append(
        f"{'size, m/s':14}" + "".join(f"{name:>16}" for name in report.conditions)
    )
    for row in push_size_rows(report):
        lines.append(f"{row[0]:14}" + "".join(f"{cell:>16}" for cell in row[1:]))
    return "\n".join([*lines, push_note(report)])


def write_push_report(report: PushReport, intro: str, folder: Path) -> Path:
    """Write ``report.html``, its picture and ``metrics.json``; returns the page."""
    from openclone.evaluation import experiment_plots

    write_json(report.to_json(), folder / "metrics.json")
    drawn = experiment_plots.pushes(report)
    (folder / "pushes.png").write_bytes(drawn)
    parts = [
        f"<h1>Pushes</h1><p>{escape(intro)}</p>",
        table(("", *PUSH_HEAD), push_rows(report)),
        picture(drawn, "pushes"),
        table(("size, m/s", *report.conditions), push_size_rows(report)),
        f"<p class=small>{escape(push_note(report))}</p>",
    ]
    file = folder / "report.html"
    file.write_text(page("Pushes", parts), encoding="utf-8")
    return file
