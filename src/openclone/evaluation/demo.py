"""The demonstration: synthetic operators drive the simulated G1, measured and filmed.

Everything of the running system takes part: an operator at 90 Hz, calibration, the
50 Hz loop in real time, odometry with the error of Eq. 2, the packaged student.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from openclone.errors import OpenCloneError
from openclone.evaluation.operator import calibration_of_operator, operator_of
from openclone.evaluation.programme import (
    Part,
    Programme,
    make_programme,
    place_head,
)
from openclone.evaluation.report import COLUMNS, Report, table_row, write_report
from openclone.evaluation.session import session_results
from openclone.evaluation.tracking import ClipResult, TrackingReport
from openclone.motion.clip import Clip, clip_from_qpos, save_clip
from openclone.motion.sources.synthetic import generate
from openclone.odometry.noise import OdometryNoiseConfig
from openclone.policy.bundle import Bundle, load_bundle
from openclone.robot.kinematics import Kinematics
from openclone.robot.model import CONTROL_PERIOD, standing_qpos
from openclone.teleop.loop import LoopConfig, LoopStats
from openclone.teleop.messages import OperatorRecording, Subscriber
from openclone.teleop.session import SessionConfig, SessionResult, run_teleop

CATEGORIES = ("wave", "forward", "turn", "reach", "squat", "stepside", "backward")
SEED = 20_000
"""Far from the seeds of the training motions: the robot has never seen these."""
PACE = 0.7
"""Of the walks; the governor holds back operators who are faster."""
MAX_SECONDS = 75.0
FILM_SECONDS = 36.0


class Watcher(Subscriber, Protocol):
    """A view of the running demonstration; it also wants to show the reference."""

    def show_reference(self, recording: OperatorRecording, qpos: np.ndarray) -> None:
        """Announce a run: its operator, and the reference ``(T, 36)`` at 50 Hz."""
        ...


@dataclass(frozen=True)
class Run:
    """One session of the demonstration, until its end or a fall."""

    session: SessionResult
    recording: OperatorRecording
    reference_qpos: np.ndarray
    clips: dict[str, ClipResult]


@dataclass(frozen=True)
class DemoResult:
    """What the demonstration leaves: the measurements and the page that shows them."""

    tracking: TrackingReport
    page: Path
    motion: Path


def demo_clips(seed: int = SEED) -> list[Clip]:
    """The motions of the demonstration, about a minute."""
    clips = []
    for index, category in enumerate(CATEGORIES):
        rng = np.random.default_rng([seed, index])
        clips.append(generate(category, rng, f"demo/{category}", pace=PACE))
    return clips


def run_demo(
    out: Path,
    watcher: Watcher | None = None,
    *,
    bundle: Bundle | None = None,
    clips: list[Clip] | None = None,
    realtime: bool = True,
    video: bool = True,
    say: Callable[[str], None] = print,
) -> DemoResult:
    """Run, measure, film and report.

    Args:
        out: folder for ``report.html``, ``metrics.json``, ``video.mp4``, a picture and
            the motion.
        watcher: sees every tick of the loop, e.g. the browser view.
        bundle: the policy; the packaged student by default.
        clips: motions; `demo_clips` by default.
        realtime: keep real time, or run as fast as possible.
        video: whether to film.
        say: takes lines of text for the user.
    """
    out.mkdir(parents=True, exist_ok=True)
    bundle = bundle or load_bundle()
    say("making the operator's motions ...")
    programme = make_programme(clips or demo_clips(), "demo/programme")
    motion = out / "motion.npz"
    save_clip(programme.clip, motion)
    pace = "in real time" if realtime else "as fast as possible"
    say(
        f"teleoperating the simulated G1 for {programme.clip.seconds:.0f} s, {pace} ..."
    )
    runs = _run_all(programme, bundle, watcher, realtime)
    tracking = TrackingReport({k: v for run in runs for k, v in run.clips.items()})
    notes = _film(runs, out) if video else ()
    page = write_report(_report(bundle, tracking, runs, notes, realtime), out)
    _print_results(tracking, runs, notes, say)
    say(f"report: {page}")
    say(f"watch it live in the browser: openclone view --recording {motion}")
    return DemoResult(tracking, page, motion)


def _run_all(
    programme: Programme, bundle: Bundle, watcher: Watcher | None, realtime: bool
) -> list[Run]:
    """Run the programme; after a fall stand up again and go on with the next clip."""
    kinematics = Kinematics()
    runs: list[Run] = []
    clip, parts = programme.clip, programme.parts
    while parts:
        run = _run(clip, parts, bundle, watcher, realtime, kinematics)
        runs.append(run)
        parts = parts[max(1, len(run.clips)) :]
        if parts:
            clip = clip_from_qpos(clip.info, clip.qpos[parts[0].first :])
            first = parts[0].first
            parts = tuple(
                replace(part, first=part.first - first, last=part.last - first)
                for part in parts
            )
    return runs


def _run(
    clip: Clip,
    parts: tuple[Part, ...],
    bundle: Bundle,
    watcher: Watcher | None,
    realtime: bool,
    kinematics: Kinematics,
) -> Run:
    """One session."""
    head_xy = kinematics.key_points(standing_qpos())[0][0, :2].copy()
    reference = place_head(clip.qpos, kinematics.bodies(clip.qpos[0]), head_xy)
    recording = operator_of(clip, kinematics)
    if watcher is not None:
        watcher.show_reference(recording, reference)
    session = run_teleop(
        recording,
        bundle,
        seconds=MAX_SECONDS + 10.0,
        realtime=realtime,
        subscribers=() if watcher is None else (watcher,),
        noise=OdometryNoiseConfig(),
        config=SessionConfig(LoopConfig(calibration=calibration_of_operator())),
    )
    results = session_results(session, reference, parts, kinematics)
    return Run(session, recording, reference, results)


def _film(runs: list[Run], out: Path) -> tuple[str, ...]:
    """Film the longest run; what hinders it becomes a note."""
    from openclone.evaluation.session import reference_at
    from openclone.evaluation.video import Film, film_run

    run = max(runs, key=lambda each: each.session.log.num_ticks)
    log = run.session.log
    ready = np.isfinite(log.target_position).all(axis=(1, 2))
    ticks = np.flatnonzero(ready)[: round(FILM_SECONDS / CONTROL_PERIOD)]
    if not len(ticks):
        return ("no video: the robot never followed the operator",)
    shown_s = np.maximum(run.session.recording_time_s[ticks], 0.0)
    film = Film(
        qpos=log.qpos[ticks],
        reference_qpos=reference_at(run.reference_qpos, shown_s),
        target_position=log.target_position[ticks],
        target_quat=log.target_quat[ticks],
        period=CONTROL_PERIOD,
    )
    try:
        film_run(film, out)
    except OpenCloneError as error:
        return (str(error),)
    return ()


def _loop_facts(stats: list[LoopStats], realtime: bool) -> tuple[tuple[str, str], ...]:
    total = sum(each.ticks for each in stats)
    return (
        ("pace", "real time, 50 Hz" if realtime else "as fast as possible"),
        ("ticks", f"{total}"),
        ("deadlines missed", f"{sum(each.overruns for each in stats)}"),
        ("tick p99, worst run", f"{max(each.p99_ms for each in stats):.2f} ms"),
        ("longest tick", f"{max(each.max_ms for each in stats):.2f} ms"),
        ("falls", f"{sum(each.falls for each in stats)}"),
    )


def _report(
    bundle: Bundle,
    tracking: TrackingReport,
    runs: list[Run],
    notes: tuple[str, ...],
    realtime: bool,
) -> Report:
    intro = (
        "Synthetic operators, unseen in training, drive the simulated Unitree G1 with "
        "head and two wrists only. Operator frames at 90 Hz, calibration, filters, "
        "50 Hz loop, odometry error (Eq. 2) and delays all count. "
        f"Policy: {bundle.info.name}, {bundle.info.training}."
    )
    ticks = np.concatenate([run.session.log.duration_ns for run in runs]) * 1e-6
    facts = _loop_facts([run.session.stats for run in runs], realtime)
    return Report("OpenClone demonstration", intro, tracking, facts, ticks, notes)


def _print_results(
    tracking: TrackingReport,
    runs: list[Run],
    notes: tuple[str, ...],
    say: Callable[[str], None],
) -> None:
    say(f"{'':12}" + "".join(f"{name:>14}" for name in COLUMNS))
    for name, metrics in (*tracking.categories.items(), ("all", tracking.overall)):
        say(f"{name:12}" + "".join(f"{text:>14}" for text in table_row(metrics)))
    stats = [run.session.stats for run in runs]
    say("; ".join(f"{name} {value}" for name, value in _loop_facts(stats, True)[1:]))
    for note in notes:
        say(note)
