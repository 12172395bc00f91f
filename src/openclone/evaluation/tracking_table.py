"""The table of a tracking evaluation: every category, the paper's figures, the targets.

No motion disappears from it: categories without a clip have a row that says so, and
recordings that retargeting refuses are counted beside those that were run.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

from openclone.evaluation.metrics import TREMOR_FRAMES, Metrics
from openclone.evaluation.tracking import TrackingReport
from openclone.motion.clip import CATEGORIES

COLUMNS = ("SR, %", "MPKPE, mm", "R-MPKPE, mm", "E_vel, mm/s", "E_hand x 100")
HEAD = ("clips", "left out", *COLUMNS)
KEYS = ("sr", "mpkpe_mm", "r_mpkpe_mm", "e_vel_mm_s", "e_hand_x100")
PAPER_ROWS = (
    ("CLONE, MLP student", 100.0, 113.97, 35.55, 245.11, 4.73),
    ("CLONE, OmniH2O data", 100.0, 102.20, 41.07, 309.65, 4.61),
    ("CLONE", 100.0, 87.84, 33.30, 227.17, 3.61),
)
"""Table 1 of the paper: SR %, MPKPE mm, R-MPKPE mm, E_vel mm/s, E_hand x 100."""
TARGETS = {
    "train": (98.0, 80.0, 33.0, 227.0, 3.6),
    "dev": (95.0, 88.0, 38.0, 240.0, 3.6),
}
"""What OpenClone wants to reach, by split: SR at least, errors at most."""
_DIGITS = (0, 1, 1, 0, 2)


@dataclass(frozen=True)
class TrackingSetup:
    """What was run, and what was not.

    Attributes:
        split: of the data set; empty for motions without one.
        categories: that were asked for; the table has a row for each.
        left_out: category of each recording that retargeting refused, by name.
        noise: whether the odometry had the error of Eq. 2.
        look: whether the head's orientation was commanded.
    """

    split: str = ""
    categories: tuple[str, ...] = CATEGORIES
    left_out: dict[str, str] = field(default_factory=dict)
    noise: bool = True
    look: bool = True

    def conditions(self, seeds: int) -> str:
        """One line: how the figures were made."""
        odometry = "off"
        if self.noise:
            odometry = f"on (Eq. 2, {seeds} seed{'s' if seeds > 1 else ''})"
        return (
            f"odometry noise {odometry}, domain randomization off, "
            "commanded: head and hands only"
            f"{'' if self.look else ', of the head its place alone'}"
        )


def table_row(metrics: Metrics, spread: Metrics | None = None) -> tuple[str, ...]:
    """The five figures of section 4.1 as printed, in the order of `COLUMNS`.

    Args:
        metrics: the means.
        spread: standard deviations, printed behind them.
    """
    values = metrics.to_json()
    extra = spread.to_json() if spread is not None else {}
    cells = []
    for key, digits in zip(KEYS, _DIGITS, strict=True):
        value, deviation = values[key], extra.get(key)
        text = "-" if value is None else f"{value:.{digits}f}"
        if deviation is not None:
            text += f" ± {deviation:.{digits}f}"
        cells.append(text)
    return tuple(cells)


def success_of_all(report: TrackingReport, setup: TrackingSetup) -> float:
    """SR in percent if every recording that was left out counts as a failure."""
    successes = sum(result.metrics.sr for result in report.clips.values())
    return 100.0 * successes / (len(report.clips) + len(setup.left_out))


def category_rows(
    report: TrackingReport, setup: TrackingSetup
) -> list[tuple[str, ...]]:
    """A row for every category and one for all: name, then `HEAD`."""
    counts = Counter(result.category for result in report.clips.values())
    refused = Counter(setup.left_out.values())
    spreads = report.category_spreads
    present = (*setup.categories, *sorted(set(counts) - set(setup.categories)))
    rows = []
    for name in present:
        figures = ("-",) * len(COLUMNS)
        if counts[name]:
            figures = table_row(report.categories[name], spreads.get(name))
        rows.append((name, str(counts[name]), str(refused[name]), *figures))
    total = (str(len(report.clips)), str(len(setup.left_out)))
    rows.append(("all", *total, *table_row(report.overall, report.spread)))
    return rows


def comparison_rows(
    report: TrackingReport, setup: TrackingSetup
) -> list[tuple[str, ...]]:
    """Rows below: with failures for what was left out, the paper's, the targets."""
    empty = ("",) * (len(COLUMNS) - 1)
    rows: list[tuple[str, ...]] = []
    if setup.left_out:
        share = f"{success_of_all(report, setup):.0f}"
        rows.append(("left out = failed", "", "", share, *empty))
    paper = PAPER_ROWS[-1]
    figures = (f"{v:.{d}f}" for v, d in zip(paper[1:], _DIGITS, strict=True))
    rows.append(("paper (its data)", "", "", *figures))
    if setup.split in TARGETS:
        wanted = TARGETS[setup.split]
        signs = ("≥ ", *("≤ ",) * 4)
        cells = (f"{sign}{value:g}" for sign, value in zip(signs, wanted, strict=True))
        rows.append((f"target ({setup.split})", "", "", *cells))
    return rows


def text_table(report: TrackingReport, setup: TrackingSetup) -> str:
    """What the terminal shows."""
    rows = [*category_rows(report, setup), *comparison_rows(report, setup)]
    head = ("", *HEAD)
    widths = [max(len(row[k]) for row in (head, *rows)) for k in range(len(head))]
    lines = [f"{setup.conditions(report.num_seeds)}"]
    for row in (head, *rows):
        cells = (f"{cell:>{w}}" for cell, w in zip(row[1:], widths[1:], strict=True))
        lines.append("  ".join((f"{row[0]:{widths[0]}}", *cells)).rstrip())
    lines.append(tremor_line(report.overall))
    return "\n".join(lines)


def tremor_line(metrics: Metrics) -> str:
    """How much the robot trembles, beside its reference; no figure of the paper."""
    return (
        f"tremor (speed about its mean over {TREMOR_FRAMES} steps) "
        f"{metrics.tremor_mm_s:.0f} mm/s, reference {metrics.reference_tremor_mm_s:.0f}"
    )


def figures(report: TrackingReport, setup: TrackingSetup) -> dict[str, object]:
    """The report's figures with what the table says beside them, for JSON."""
    data = report.to_json()
    groups = dict.fromkeys(setup.categories, None) | dict(report.categories)
    known = data["categories"]
    assert isinstance(known, dict)
    refused = Counter(setup.left_out.values())
    nothing = {"num_clips": 0}
    categories = {
        name: {**known.get(name, nothing), "num_left_out": refused[name]}
        for name in groups
    }
    return {
        **data,
        "categories": categories,
        "split": setup.split,
        "odometry_noise": setup.noise,
        "domain_randomization": False,
        "commanded": "head and hands",
        "head_orientation": setup.look,
        "left_out": setup.left_out,
        "sr_left_out_failed": success_of_all(report, setup),
        "paper": dict(zip(KEYS, PAPER_ROWS[-1][1:], strict=True)),
        "target": _target(setup.split),
    }


def _target(split: str) -> dict[str, float] | None:
    if split not in TARGETS:
        return None
    return dict(zip(KEYS, TARGETS[split], strict=True))
