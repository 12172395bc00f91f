"""Commands that measure the policy and the odometry: ``openclone evaluate ...``."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from openclone.cli.options import (
    category_names,
    load_clips,
    positive,
    print_figures,
    synthetic_clips,
    write_figures,
)

if TYPE_CHECKING:
    from openclone.evaluation.tracking import ClipResult, TrackingReport
    from openclone.motion.clip import Clip
    from openclone.policy.bundle import Bundle

_HELD_OUT_SEED = 30_000
"""Synthetic motions for evaluation; the shipped weights saw the seeds 0 and 1."""


def _print_clip(number: int, count: int, name: str, result: ClipResult) -> None:
    metrics = result.metrics
    outcome = f"{metrics.mpkpe_mm:.0f} mm" if metrics.sr else "failed"
    print(f"[{number}/{count}] {name}: {outcome}")


def _left_out(motions: Path, split: str, categories: str, run: set[str]) -> dict:
    """Category by name of the manifest's recordings that are not in ``run``."""
    from openclone.motion import library

    if not (motions / library.MANIFEST).is_file():
        return {}
    wanted = category_names(categories)
    return {
        entry.name: entry.category
        for entry in library.read_manifest(motions)
        if entry.split == split
        and entry.name not in run
        and (wanted is None or entry.category in wanted)
    }


def _motions(folder: Path, split: str, categories: str) -> list[Clip]:
    """Clips with a whole body to compare with; gliding laps are commands alone."""
    from openclone.motion.commands import is_command

    clips = load_clips((folder,), split, categories)
    return [clip for clip in clips if not is_command(clip.info)]


def _over_seeds(
    clips: list[Clip],
    bundle: Bundle,
    noise: bool,
    look: bool,
    seed: int,
    seeds: int,
) -> TrackingReport:
    """Run ``clips`` with the odometry seeds ``seed``, ``seed + 1``, ..."""
    from openclone.evaluation import tracking

    reports = []
    # Without odometry error all runs would be the same.
    for number in range(seeds if noise else 1):
        if seeds > 1:
            print(f"odometry seed {seed + number}")
        reports.append(
            tracking.evaluate_tracking(
                clips,
                bundle,
                noise=tracking.DEFAULT_NOISE if noise else None,
                look=look,
                seed=seed + number,
                progress=_print_clip,
            )
        )
    return tracking.over_seeds(reports)


def evaluate_tracking(
    *,
    motions: Path | None = None,
    split: str = "dev",
    categories: str = "",
    policy: Path | None = None,
    noise: bool = True,
    look: bool = True,
    seed: int = 0,
    seeds: int = 1,
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
        look: tell the policy how the head is turned, which section 3.1 does not.
        seed: of the odometry error.
        seeds: run all motions this often, with the seeds SEED, SEED + 1, ..., and give
            mean and standard deviation.
        json: write the figures to this file.
        out: write a report with plots to this folder.
    """
    from openclone.evaluation.report import Report, write_report
    from openclone.evaluation.tracking_table import TrackingSetup, figures, text_table
    from openclone.motion.clip import CATEGORIES
    from openclone.policy.bundle import load_bundle

    positive("--seeds", seeds)

    bundle = load_bundle(policy)
    if motions is None:
        clips = synthetic_clips(_HELD_OUT_SEED, 2.0, categories)
    else:
        clips = _motions(motions, split, categories)
    names = {clip.info.name for clip in clips}
    left_out = _left_out(motions, split, categories, names) if motions else {}
    report = _over_seeds(clips, bundle, noise, look, seed, seeds)
    setup = TrackingSetup(
        split if motions else "",
        category_names(categories) or CATEGORIES,
        left_out,
        noise,
        look,
    )
    print(text_table(report, setup))
    write_figures(json, figures(report, setup))
    if out is not None:
        data = f"{motions}, split {split}" if motions else "synthetic motions"
        intro = f"Policy {bundle.info.name} on {data}, {len(clips)} clips."
        page = write_report(
            Report("Tracking of reference motions", intro, report, setup=setup), out
        )
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
    began = time.process_time()
    report = standing.evaluate_standing(
        load_bundle(policy),
        seconds=seconds,
        noise=standing.DEFAULT_NOISE if noise else None,
        seed=seed,
    )
    print_figures(report.to_json())
    spent = time.process_time() - began
    print(f"{report.seconds:.0f} s of standing in {spent:.1f} s of processor time")
    write_figures(json, report.to_json())


def evaluate_squat(
    *,
    trials: int = 10,
    policy: Path | None = None,
    noise: bool = True,
    seed: int = 0,
    json: Path | None = None,
    out: Path | None = None,
) -> None:
    """Squat to head heights of 1.2 to 0.6 m and come up again (Fig. 3).

    Args:
        trials: per height, each with its own pace, arms and odometry error.
        policy: policy bundle; the packaged student by default.
        noise: add the odometry error of Eq. 2.
        seed: of all that is drawn.
        json: write the figures to this file.
        out: write a report with plots to this folder.
    """
    from openclone.evaluation import squat
    from openclone.evaluation.experiment_report import squat_text, write_squat_report
    from openclone.policy.bundle import load_bundle

    positive("--trials", trials)
    bundle = load_bundle(policy)
    report = squat.evaluate_squat(
        bundle,
        trials=trials,
        noise=squat.DEFAULT_NOISE if noise else None,
        seed=seed,
        progress=lambda level: print(
            f"{level.target_m:.2f} m: SR {level.sr:.0f} %, "
            f"low enough {level.reached:.0f} %"
        ),
    )
    print(squat_text(report))
    write_figures(json, report.to_json())
    if out is not None:
        intro = f"Policy {bundle.info.name}, {trials} squats to each height."
        print(f"report: {write_squat_report(report, intro, out)}")


def evaluate_pushes(
    *,
    pushes: int = 100,
    speed: float = 1.5,
    policy: Path | None = None,
    noise: bool = True,
    seed: int = 0,
    json: Path | None = None,
    out: Path | None = None,
) -> None:
    """Push the standing and the walking robot (Table A2); count the falls.

    Args:
        pushes: how many under each condition: still operator, walking operator.
        speed: m/s, largest change of velocity along each horizontal axis.
        policy: policy bundle; the packaged student by default.
        noise: add the odometry error of Eq. 2.
        seed: of times, directions and odometry errors.
        json: write the figures to this file.
        out: write a report with plots to this folder.
    """
    from openclone.evaluation import pushes as measuring
    from openclone.evaluation.experiment_report import push_text, write_push_report
    from openclone.policy.bundle import load_bundle

    positive("--pushes", pushes)
    positive("--speed", speed)
    bundle = load_bundle(policy)
    report = measuring.evaluate_pushes(
        bundle,
        count=pushes,
        config=measuring.PushConfig(speed=speed),
        noise=measuring.DEFAULT_NOISE if noise else None,
        seed=seed,
        progress=lambda name, result: print(
            f"{name}: {result.falls} of {len(result.pushes)} pushes ended in a fall"
        ),
    )
    print(push_text(report))
    write_figures(json, report.to_json())
    if out is not None:
        intro = f"Policy {bundle.info.name}, {pushes} pushes under each condition."
        print(f"report: {write_push_report(report, intro, out)}")


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
