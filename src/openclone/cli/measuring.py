"""Commands that measure: evaluate tracking, evaluate standing, evaluate odometry."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

from openclone.cli.options import (
    load_clips,
    positive,
    print_figures,
    synthetic_clips,
    write_figures,
)

if TYPE_CHECKING:
    from openclone.evaluation.tracking import ClipResult, TrackingReport

_HELD_OUT_SEED = 30_000
"""Synthetic motions for evaluation; the shipped weights saw the seeds 0 and 1."""


def _print_clip(number: int, count: int, name: str, result: ClipResult) -> None:
    metrics = result.metrics
    outcome = f"{metrics.mpkpe_mm:.0f} mm" if metrics.sr else "failed"
    print(f"[{number}/{count}] {name}: {outcome}")


def _print_tracking(report: TrackingReport) -> None:
    from openclone.evaluation.report import COLUMNS, table_row

    rows = [*report.categories.items(), ("all", report.overall)]
    print(f"{'':14}" + "".join(f"{name:>14}" for name in COLUMNS))
    for name, metrics in rows:
        print(f"{name:14}" + "".join(f"{text:>14}" for text in table_row(metrics)))


def evaluate_tracking(
    *,
    motions: Path | None = None,
    split: str = "dev",
    categories: str = "",
    policy: Path | None = None,
    noise: bool = True,
    seed: int = 0,
    json: Path | None = None,
    out: Path | None = None,
) -> None:
    """Measure how well a policy tracks reference motions (section 4.1).

    Args:
        motions: folder of recordings with a manifest.tsv, or of clip files; by default
            synthetic motions that the packaged policy was not trained on.
        split: of the manifest.
        categories: only these, separated by commas; all by default.
        policy: policy bundle; the packaged student by default.
        noise: add the odometry error of Eq. 2.
        seed: of the odometry error.
        json: write the figures to this file.
        out: write a report with plots to this folder.
    """
    from openclone.evaluation import tracking
    from openclone.evaluation.report import Report, write_report
    from openclone.policy.bundle import load_bundle

    bundle = load_bundle(policy)
    if motions is None:
        clips = synthetic_clips(_HELD_OUT_SEED, 2.0, categories)
    else:
        clips = load_clips((motions,), split, categories)
    report = tracking.evaluate_tracking(
        clips,
        bundle,
        noise=tracking.DEFAULT_NOISE if noise else None,
        seed=seed,
        progress=_print_clip,
    )
    _print_tracking(report)
    write_figures(json, report.to_json())
    if out is not None:
        data = f"{motions}, split {split}" if motions else "synthetic motions"
        intro = f"Policy {bundle.info.name} on {data}, {len(clips)} clips."
        page = write_report(Report("Tracking of reference motions", intro, report), out)
        print(f"report: {page}")


def evaluate_standing(
    *,
    seconds: float = 60.0,
    policy: Path | None = None,
    noise: bool = True,
    seed: int = 0,
    json: Path | None = None,
) -> None:
    """Measure how quietly the robot stands while the operator keeps still.

    Args:
        seconds: how long.
        policy: policy bundle; the packaged student by default.
        noise: add the odometry error of Eq. 2.
        seed: of the odometry error.
        json: write the figures to this file.
    """
    from openclone.evaluation import standing
    from openclone.policy.bundle import load_bundle

    positive("--seconds", seconds)
    report = standing.evaluate_standing(
        load_bundle(policy),
        seconds=seconds,
        noise=standing.DEFAULT_NOISE if noise else None,
        seed=seed,
    )
    print_figures(report.to_json())
    write_figures(json, report.to_json())


def evaluate_odometry(
    *,
    world: Literal["flat", "room", "corridor", "hall", "glass", "people"] = "room",
    odometry: Literal["lio", "rko", "ground-truth"] = "lio",
    seconds: float = 60.0,
    realtime: bool = False,
    policy: Path | None = None,
    seed: int = 0,
    json: Path | None = None,
) -> None:
    """Walk the simulated robot by LiDAR odometry; compare the odometry with the truth.

    Args:
        world: where it walks.
        odometry: FAST-LIO2 (lio), rko_lio (rko), or the truth with Eq. 2's error.
        seconds: how long; laps with stops, in the corridor straight ahead.
        realtime: keep real time with threads; otherwise reproducible.
        policy: policy bundle; the packaged student by default.
        seed: of the sensors' errors.
        json: write the figures to this file.
    """
    from openclone.evaluation import odometry as measuring
    from openclone.policy.bundle import load_bundle

    positive("--seconds", seconds)
    report = measuring.evaluate_odometry(
        load_bundle(policy),
        world=world,
        odometry=odometry,
        seconds=seconds,
        seed=seed,
        realtime=realtime,
    )
    print_figures(report.to_json())
    write_figures(json, report.to_json())
