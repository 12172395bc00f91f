"""What a training run did over steps and minutes: from its event files and bundles.

A student's run folder holds the event files of its own phases and, with the preset
``quickstart``, the folder ``teacher`` with those of its teacher, which came first: the
student's steps and minutes count on from the teacher's.
"""

from __future__ import annotations

import re
from collections import defaultdict
from dataclasses import dataclass, field
from pathlib import Path

from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from openclone.errors import InputError
from openclone.evaluation.tracking import TrackingReport, evaluate_tracking
from openclone.motion.clip import CATEGORIES, Clip
from openclone.policy.bundle import load_bundle

EVENTS = "events.out.tfevents."
TEACHER, STUDENT = "teacher", "student"
KEPT = "bundles"
"""Folder in a run where training keeps a bundle every two minutes or so."""
_SUCCESS = "success/"
_NAME = re.compile(r"_(?P<minutes>[0-9]+[.][0-9])$")
_NOTE = re.compile(r"(?P<phase>\w+), (?P<steps>\d+) steps, (?P<minutes>[\d.]+) minutes")


@dataclass(frozen=True)
class Logged:
    """One line of a training log.

    Attributes:
        phase: teacher or student.
        steps, minutes: of environment and wall, since the run's very beginning.
        success: share of the episodes that ended well, by category, 0 to 1.
    """

    phase: str
    steps: float
    minutes: float
    success: dict[str, float]

    @property
    def mean(self) -> float:
        """Mean over categories, percent."""
        return 100.0 * sum(self.success.values()) / len(self.success)


@dataclass(frozen=True)
class Evaluated:
    """One bundle of the run in closed loop on motions it did not learn.

    Attributes:
        steps, minutes: as for `Logged`.
        report: `openclone evaluate tracking`'s.
    """

    steps: float
    minutes: float
    report: TrackingReport


@dataclass(frozen=True)
class Curve:
    """The course of a run.

    Attributes:
        name: the folder's.
        logged: what training itself logged, every 30 s.
        student_from: steps and minutes at which the student began.
        evaluated: its kept bundles, if any.
    """

    name: str
    logged: list[Logged]
    student_from: tuple[float, float]
    evaluated: list[Evaluated] = field(default_factory=list)

    @property
    def categories(self) -> tuple[str, ...]:
        """That the run trained on, in the project's order."""
        seen = {name for line in self.logged for name in line.success}
        return tuple(name for name in CATEGORIES if name in seen)


def read_log(
    folder: Path, phase: str, steps: float = 0.0, minutes: float = 0.0
) -> list[Logged]:
    """All lines of ``folder``'s event files, counted on from ``steps, minutes``.

    Minutes are those that training ran: pauses between a stop and a resume, each of
    which begins an event file, are left out.

    Raises:
        InputError: there is no event file, or no success in them.
    """
    files = sorted(folder.glob(f"{EVENTS}*"), key=_started)
    lines: list[Logged] = []
    for file in files:
        by_step: dict[int, dict[str, float]] = defaultdict(dict)
        wall: dict[int, float] = {}
        events = EventAccumulator(str(file), size_guidance={"scalars": 0})
        events.Reload()
        for tag in events.Tags()["scalars"]:
            for event in events.Scalars(tag):
                wall[event.step] = event.wall_time
                if tag.startswith(_SUCCESS):
                    name = tag.removeprefix(_SUCCESS)
                    by_step[event.step][name] = event.value
        start = _started(file)
        for step in sorted(by_step):
            at = minutes + max(0.0, wall[step] - start) / 60.0
            lines.append(Logged(phase, steps + step, at, by_step[step]))
        if wall:
            minutes += max(0.0, max(wall.values()) - start) / 60.0
    if not lines:
        raise InputError(
            "no event file with the success of episodes",
            where=str(folder),
            remedy="give a folder that `openclone train` wrote",
        )
    return lines


def _started(file: Path) -> float:
    """Seconds since 1970 at which an event file began, from its name."""
    number = file.name.removeprefix(EVENTS).split(".")[0]
    return float(number) if number.isdigit() else 0.0


def read_curve(folder: Path) -> Curve:
    """The course of the run in ``folder``, a teacher's or a student's."""
    own = STUDENT if list(folder.glob("student.*")) else TEACHER
    before: list[Logged] = []
    if (folder / TEACHER).is_dir():
        before = read_log(folder / TEACHER, TEACHER)
    steps, minutes = (before[-1].steps, before[-1].minutes) if before else (0.0, 0.0)
    return Curve(
        folder.resolve().name,
        [*before, *read_log(folder, own, steps, minutes)],
        (steps, minutes),
    )


def trained(bundle: Path) -> tuple[str, int, float]:
    """Phase, steps and minutes that a bundle says it was trained."""
    note = load_bundle(bundle).info.training
    found = _NOTE.search(note)
    if found is None:
        raise InputError(
            f"the bundle does not say how long it was trained ({note!r})",
            where=str(bundle),
            remedy="use bundles that `openclone train student` wrote",
        )
    # The note has whole minutes; the name of a kept bundle has tenths.
    exact = _NAME.search(bundle.stem) or found
    return found["phase"], int(found["steps"]), float(exact["minutes"])


def evaluate(curve: Curve, run: Path, clips: list[Clip], seed: int) -> list[Evaluated]:
    """Run the kept bundles of ``run``, and its last one, on ``clips``."""
    kept = sorted((trained(file)[1:], file) for file in (run / KEPT).glob("*.onnx"))
    final = run / "student.onnx"
    if final.is_file() and not (kept and trained(final)[1] == kept[-1][0][0]):
        kept.append((trained(final)[1:], final))
    steps, minutes = curve.student_from
    phase, before, last = "", 0.0, 0.0
    found = []
    for (at, spent), path in kept:
        now = trained(path)[0]
        if phase and now != phase:
            before += last  # PPO counts its minutes anew
        phase, last = now, spent
        report = evaluate_tracking(clips, load_bundle(path), seed=seed)
        done = Evaluated(steps + at, minutes + before + spent, report)
        print(
            f"{path.name}: {done.minutes:.0f} min, {done.steps / 1e6:.2f} M steps, "
            f"SR {100 * report.overall.sr:.0f} %, {report.overall.mpkpe_mm:.0f} mm",
            flush=True,
        )
        found.append(done)
    return found
