"""The report of a curated data set: what is in it, how good it is, what is not."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from html import escape
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from openclone.errors import OpenCloneError
from openclone.evaluation.page import page, picture, table
from openclone.evaluation.plots import LIMIT, ROBOT, render

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from openclone.motion.curate import Build, BuiltClip

_HISTOGRAMS = {
    "ankle_mm": "ankles off target, mm",
    "wrist_mm": "wrists off target, mm",
    "slide_cm_s": "sliding soles, cm/s",
    "ground_share": "share of frames under ground",
    "self_share": "share of frames with self-contact",
    "limit_share": "share of frames at a joint limit",
    "speed_ratio": "peak joint speed / motor's",
    "peak_acceleration": "peak joint acceleration, rad/s²",
    "spike_share": "share of frames with spikes",
    "float_s": "floating, s",
    "tilt_deg": "pelvis leans, deg",
    "turn_rad_s": "pelvis turns, rad/s",
}
_SHEET_CLIPS = 40


def figures_of(made: Build) -> dict[str, object]:
    """The build in figures: counts, hours, medians over the accepted clips."""
    medians = {}
    for name in _HISTOGRAMS:
        values = _values(made.clips, name)
        if len(values):
            medians[name] = round(float(np.median(values)), 4)
    seconds = {
        category: round(sum(clip.quality.seconds for clip in clips), 2)
        for category, clips in _by_category(made.clips).items()
    }
    return {
        "accepted": len(made.clips),
        "rejected": len(made.rejects),
        "minutes": round(made.seconds / 60, 2),
        "motions": made.digest,
        "seconds_by_category": seconds,
        "medians": medians,
        "rejects": {r.info.name: list(r.reasons) for r in made.rejects},
    }


def write_motion_report(made: Build, out: Path, pictures: bool) -> tuple[Path, str]:
    """Write ``report.html`` and, if this machine can render, ``contact_sheet.jpg``.

    Returns:
        The page, and why there is no contact sheet (empty if there is one or none was
        wanted).
    """
    note = ""
    sheet = out / "contact_sheet.jpg"
    sheet.unlink(missing_ok=True)
    if pictures and made.clips:
        from openclone.evaluation.contact_sheet import write_sheet

        chosen = _spread_over_categories(made.clips, _SHEET_CLIPS)
        labels = [f"{clip.info.category}: {clip.info.name}" for clip in chosen]
        try:
            write_sheet([out / clip.path for clip in chosen], labels, sheet)
        except OpenCloneError as error:
            note = str(error)
    report = out / "report.html"
    report.write_text(_page(made, sheet, note), encoding="utf-8")
    return report, note


def _spread_over_categories(clips: Sequence[BuiltClip], most: int) -> list[BuiltClip]:
    """At most ``most`` clips, the categories in turn, each spread over its clips."""
    groups = list(_by_category(clips).values())
    each = max(1, most // len(groups))
    chosen = []
    for group in groups:
        at = np.linspace(0, len(group) - 1, min(each, len(group))).round().astype(int)
        chosen += [group[k] for k in dict.fromkeys(at.tolist())]
    return chosen[:most]


def _by_category(clips: Sequence[BuiltClip]) -> dict[str, list[BuiltClip]]:
    groups: dict[str, list[BuiltClip]] = defaultdict(list)
    for clip in sorted(clips, key=lambda item: (item.info.category, item.info.name)):
        groups[clip.info.category].append(clip)
    return dict(groups)


def _values(clips: Sequence[BuiltClip], name: str) -> np.ndarray:
    values = [getattr(clip.quality, name) for clip in clips]
    return np.array([value for value in values if value is not None], dtype=float)


def _histograms(made: Build) -> bytes:
    """One histogram per figure; a line marks the gate."""

    def draw(figure: Figure) -> None:
        grid = figure.subplots(4, 3)
        for axes, (name, label) in zip(grid.flat, _HISTOGRAMS.items(), strict=True):
            values = _values(made.clips, name)
            if len(values):
                axes.hist(values, bins=30, color=ROBOT)
            most = getattr(made.config.gate, name, None)
            if most is not None and len(values) and most < 4 * values.max() + 1e-9:
                axes.axvline(most, color=LIMIT, ls="--", lw=1)
            axes.set_xlabel(label, fontsize=8)
            axes.tick_params(labelsize=7)
            axes.spines[["top", "right"]].set_visible(False)

    return render(draw, 8.5, 8.0)


def _category_table(made: Build) -> str:
    rows = []
    for category, clips in _by_category(made.clips).items():
        hours = sum(clip.quality.seconds for clip in clips) / 3600
        held_out = [clip for clip in clips if clip.split != "train"]
        rejected = sum(r.info.category == category for r in made.rejects)
        rows.append(
            (
                category,
                str(len(clips)),
                f"{hours:.3f}",
                str(len(held_out)),
                f"{sum(clip.quality.seconds for clip in held_out) / 3600:.3f}",
                str(rejected),
            )
        )
    head = ("category", "clips", "hours", "held out", "hours held out", "rejected")
    total = (
        "all",
        str(len(made.clips)),
        f"{made.seconds / 3600:.3f}",
        *("" for _ in range(2)),
        str(len(made.rejects)),
    )
    return table(head, [*rows, total])


def _median_table(made: Build) -> str:
    rows = []
    for name, label in _HISTOGRAMS.items():
        values = _values(made.clips, name)
        if len(values):
            low, mid, high = np.percentile(values, (5, 50, 95))
            gate = getattr(made.config.gate, name, None)
            limit = "" if gate is None else f"{gate:g}"
            rows.append((label, f"{mid:.3g}", f"{low:.3g}", f"{high:.3g}", limit))
    return table(("per clip", "median", "5 %", "95 %", "gate"), rows)


def _reject_table(made: Build) -> str:
    if not made.rejects:
        return "<p>None.</p>"
    rows = [(r.info.name, r.info.category, "; ".join(r.reasons)) for r in made.rejects]
    return table(("motion", "category", "reason"), rows)


def _clip_table(made: Build) -> str:
    rows = []
    for clip in made.clips:
        q = clip.quality
        off = ("", "") if q.ankle_mm is None else (f"{q.ankle_mm:.1f}", "")
        wrist = "" if q.wrist_mm is None else f"{q.wrist_mm:.0f}"
        limits = f"{q.limit_share:.0%} {q.limit_joint.removesuffix('_joint')}"
        rows.append(
            (
                clip.info.name, clip.split, f"{q.seconds:.1f}", off[0], wrist,
                f"{q.slide_cm_s:.1f}", f"{q.self_share:.1%}", limits if q.limit_share
                else "", f"{q.peak_speed:.1f}", clip.info.licence,
            )
        )  # fmt: skip
    head = (
        "clip", "split", "s", "ankles, mm", "wrists, mm", "slide, cm/s", "self",
        "at limit", "rad/s", "licence",
    )  # fmt: skip
    return table(head, rows)


def _page(made: Build, sheet: Path, note: str) -> str:
    parts = [
        "<h1>Motions</h1>",
        f"<p>{len(made.clips)} clips, {made.seconds / 3600:.2f} hours; "
        f"{len(made.rejects)} motions rejected. Motions "
        f"<code>{made.digest[:16]}</code>, seed {made.config.seed}.</p>",
        "<h2>Categories</h2>",
        _category_table(made),
        "<h2>Quality</h2>",
        _median_table(made),
    ]
    if made.clips:
        parts.append(picture(_histograms(made), "quality histograms"))
    parts += ["<h2>Rejected</h2>", _reject_table(made), "<h2>Pictures</h2>"]
    if sheet.is_file():
        parts.append(picture(sheet.read_bytes(), "contact sheet", "jpeg"))
    else:
        parts.append(f"<p>No pictures. {escape(note)}</p>")
    parts += ["<h2>Clips</h2>", _clip_table(made)]
    return page("Motions", parts, wide=True)
