"""Sample efficiency: success against environment steps and minutes; figure and table.

    python benchmarks/sample_efficiency.py RUN_FOLDER...
    python benchmarks/sample_efficiency.py --checkpoints RUN_FOLDER...

``RUN_FOLDER`` is what `openclone train student --preset quickstart --out RUN_FOLDER`
leaves, or any other run of the teacher or the student.

The first form draws what training itself logged: the share of its episodes that came
to their end. Training starts most of them where the robot still fails, and PPO adds
exploration noise, so this figure understates what has been learned and need not rise.
While the student learns, the teacher acts for it now and then in the first 60 rounds.

The second form also runs the bundles that training keeps on the way (``bundles``) in
closed loop on synthetic motions of a seed that no training uses, with odometry noise:
that is the success that counts.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import sys
import zlib
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import training_curve
from openclone.errors import OpenCloneError
from openclone.motion.clip import Clip
from openclone.motion.sources.synthetic import generate
from training_curve import Curve, Logged

_HELD_OUT_SEED = 30_000
COLORS = ("#1f6feb", "#bf8700", "#1a7f37", "#8250df")


def held_out(categories: tuple[str, ...], per_category: int) -> list[Clip]:
    """Motions of a seed that no training uses."""
    clips = []
    for name in categories:
        for number in range(per_category):
            rng = np.random.default_rng(
                [_HELD_OUT_SEED, zlib.crc32(name.encode()), number]
            )
            clips.append(generate(name, rng, f"held-out/{name}_{number:02d}"))
    return clips


def draw(curves: list[Curve], file: Path) -> None:
    """Success against steps and against minutes."""
    figure = Figure(figsize=(9.0, 3.8), dpi=120, layout="constrained")
    FigureCanvasAgg(figure)
    left, right = figure.subplots(1, 2, sharey=True)
    for curve, color in zip(curves, COLORS * len(curves), strict=False):
        for axes, scale, key in ((left, 1e-6, "steps"), (right, 1.0, "minutes")):
            for phase, style in ((training_curve.TEACHER, ":"), ("student", "-")):
                lines = [line for line in curve.logged if line.phase == phase]
                if not lines:
                    continue
                at = [scale * getattr(line, key) for line in lines]
                label = f"{curve.name}: {phase}, training's own episodes"
                values = smooth([line.mean for line in lines])
                axes.plot(at, values, style, color=color, lw=1.3, label=label)
            if curve.evaluated:
                at = [scale * getattr(done, key) for done in curve.evaluated]
                sr = [100.0 * done.report.overall.sr for done in curve.evaluated]
                label = f"{curve.name}: student, held-out motions"
                axes.plot(at, sr, "s-", color=color, ms=5, lw=0.8, label=label)
            start = scale * curve.student_from[0 if key == "steps" else 1]
            if start > 0:
                axes.axvline(start, color=color, lw=0.8, alpha=0.5)
    left.set(xlabel="environment steps, millions", ylabel="success, %", ylim=(-2, 102))
    right.set(xlabel=f"minutes on {os.cpu_count()} cores")
    for axes in (left, right):
        axes.spines[["top", "right"]].set_visible(False)
        axes.grid(alpha=0.25, lw=0.6)
    left.legend(frameon=False, fontsize=7, loc="lower right")
    figure.savefig(str(file), format="png")


def smooth(values: list[float], width: int = 3) -> np.ndarray:
    """Mean over neighbouring lines: 30 s of episodes are few."""
    padded = np.pad(np.array(values), width // 2, mode="edge")
    return np.convolve(padded, np.full(width, 1.0 / width), mode="valid")


def rows_of(curve: Curve) -> list[dict[str, str | float]]:
    """All points of a curve, in their order, one dictionary each."""
    rows: list[dict[str, str | float]] = []
    for line in curve.logged:
        rows.append(
            {
                **_place(curve, line.phase, line.steps, line.minutes, "training"),
                "success": round(line.mean, 1),
                **{k: round(100.0 * v, 1) for k, v in line.success.items()},
            }
        )
    for done in curve.evaluated:
        report = done.report
        rows.append(
            {
                **_place(curve, "student", done.steps, done.minutes, "held-out"),
                "success": round(100.0 * report.overall.sr, 1),
                "mpkpe_mm": round(report.overall.mpkpe_mm, 1),
                **{k: round(100.0 * v.sr, 1) for k, v in report.categories.items()},
            }
        )
    return sorted(rows, key=lambda row: (float(row["minutes"]), str(row["from"])))


def _place(
    curve: Curve, phase: str, steps: float, minutes: float, source: str
) -> dict[str, str | float]:
    return {
        "run": curve.name,
        "phase": phase,
        "minutes": round(minutes, 2),
        "steps": steps,
        "from": source,
    }


def markdown(curve: Curve, count: int = 12) -> str:
    """A table of a dozen moments of the run."""
    names = curve.categories
    head = ("minutes", "steps", "phase", "training's episodes, %")
    if curve.evaluated:
        head += ("held-out motions: SR, %", "MPKPE, mm", *(f"{n}, %" for n in names))
    lines = [f"| {' | '.join(head)} |", "|" + "---|" * len(head)]
    for line in moments(curve, count):
        cells = [
            f"{line.minutes:.0f}",
            f"{line.steps / 1e6:.2f} M",
            line.phase,
            f"{line.mean:.0f}",
        ]
        if curve.evaluated:
            cells += _held_out_cells(curve, line)
        lines.append(f"| {' | '.join(cells)} |")
    return "\n".join(lines)


def moments(curve: Curve, count: int) -> list[Logged]:
    """The first, the last and some lines between, evenly over the minutes.

    With bundles: also the lines nearest to them, so that none of them is missing.
    """
    minutes = np.array([line.minutes for line in curve.logged])
    wanted = np.linspace(minutes[0], minutes[-1], count)
    if curve.evaluated:
        _, start = curve.student_from
        own = np.array([done.minutes for done in curve.evaluated])
        wanted = np.concatenate((wanted[wanted < start], own))
    chosen = sorted({int(np.abs(minutes - at).argmin()) for at in wanted})
    return [curve.logged[index] for index in chosen]


def _held_out_cells(curve: Curve, line: Logged) -> list[str]:
    """Figures of the bundle of the same moment."""
    near = min(curve.evaluated, key=lambda done: abs(done.minutes - line.minutes))
    names = curve.categories
    if line.phase != "student" or abs(near.minutes - line.minutes) > 1.0:
        return [""] * (2 + len(names))
    report = near.report
    groups = report.categories
    shares = [f"{100 * groups[n].sr:.0f}" if n in groups else "" for n in names]
    return [f"{100 * report.overall.sr:.0f}", f"{report.overall.mpkpe_mm:.0f}", *shares]


def write(curves: list[Curve], out: Path) -> None:
    """Figure, table and every point, beside each other in ``out``."""
    out.mkdir(parents=True, exist_ok=True)
    draw(curves, out / "sample_efficiency.png")
    tables = [f"## {curve.name}\n\n{markdown(curve)}\n" for curve in curves]
    (out / "sample_efficiency.md").write_text("\n".join(tables))
    rows = [row for curve in curves for row in rows_of(curve)]
    columns = list(dict.fromkeys(key for row in rows for key in row))
    with (out / "sample_efficiency.csv").open("w", newline="") as stream:
        writer = csv.DictWriter(stream, columns)
        writer.writeheader()
        writer.writerows(rows)
    (out / "sample_efficiency.json").write_text(json.dumps(rows, indent=1) + "\n")
    print("\n".join(tables))
    print(f"figure: {out / 'sample_efficiency.png'}")


def main() -> None:
    """Read or make the runs, then draw and write."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("runs", nargs="+", type=Path, metavar="RUN_FOLDER")
    parser.add_argument("--checkpoints", action="store_true", help="run kept bundles")
    parser.add_argument("--clips", type=int, default=6, help="per category")
    parser.add_argument("--seed", type=int, default=0, help="of the odometry error")
    parser.add_argument("--out", type=Path, help="default: the first run's folder")
    arguments = parser.parse_args()
    curves = [training_curve.read_curve(run) for run in arguments.runs]
    if arguments.checkpoints:
        for curve, run in zip(curves, arguments.runs, strict=True):
            clips = held_out(curve.categories, arguments.clips)
            curve.evaluated.extend(
                training_curve.evaluate(curve, run, clips, arguments.seed)
            )
    write(curves, arguments.out or arguments.runs[0])


if __name__ == "__main__":
    try:
        main()
    except OpenCloneError as error:
        sys.exit(f"error: {error}")
