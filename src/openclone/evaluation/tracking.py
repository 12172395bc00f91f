"""Tracking of reference motions in closed loop (section 4.1, Table 1).

For each clip the simulated robot starts on the first frame and the student follows the
key points of the reference; only head and hands are told to it. No operator, no
calibration and no safety machine stand in between: this measures the policy.
"""

from __future__ import annotations

import zlib
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from openclone.errors import InputError
from openclone.evaluation import metrics
from openclone.evaluation.episode import Episode, make_reference, run_clip
from openclone.evaluation.metrics import Metrics, Trace
from openclone.motion.clip import Clip
from openclone.odometry.noise import OdometryNoiseConfig
from openclone.policy.bundle import Bundle
from openclone.robot.model import build_model
from openclone.robot.state import key_point_poses
from openclone.simulation.robot import SimulatedRobot

DEFAULT_NOISE = OdometryNoiseConfig()


@dataclass(frozen=True)
class ClipResult:
    """What one run gave.

    Attributes:
        category: the clip's.
        metrics: the section 4.1 metrics.
        error_mm: (T,), mean key-body position error over time.
        head_w, reference_head_w: (T, 3), metres.
        qpos, reference_qpos: (T, 36), to draw the run.
    """

    category: str
    metrics: Metrics
    error_mm: np.ndarray
    head_w: np.ndarray
    reference_head_w: np.ndarray
    qpos: np.ndarray
    reference_qpos: np.ndarray


def clip_result(
    category: str, trace: Trace, qpos: np.ndarray, reference_qpos: np.ndarray
) -> ClipResult:
    """Measure one run; ``qpos`` and ``reference_qpos`` are (T, 36), as the trace."""
    error = metrics.position_error(trace.position, trace.reference_position)
    points, _ = key_point_poses(trace.position, trace.quat)
    wanted, _ = key_point_poses(trace.reference_position, trace.reference_quat)
    return ClipResult(
        category=category,
        metrics=metrics.measure(trace),
        error_mm=1000.0 * error.mean(axis=1),
        head_w=points[:, 0],
        reference_head_w=wanted[:, 0],
        qpos=qpos,
        reference_qpos=reference_qpos,
    )


@dataclass(frozen=True)
class TrackingReport:
    """Results by clip name, and their means.

    Attributes:
        clips: by name; over several odometry seeds, their means.
        by_seed: one report for each odometry seed, if there were several.
    """

    clips: dict[str, ClipResult]
    by_seed: tuple[TrackingReport, ...] = ()

    @property
    def overall(self) -> Metrics:
        """Mean over clips."""
        return metrics.average([result.metrics for result in self.clips.values()])

    @property
    def categories(self) -> dict[str, Metrics]:
        """Mean over the clips of each category."""
        groups: dict[str, list[Metrics]] = {}
        for result in self.clips.values():
            groups.setdefault(result.category, []).append(result.metrics)
        return {name: metrics.average(group) for name, group in sorted(groups.items())}

    @property
    def num_seeds(self) -> int:
        """How many odometry seeds the means are over."""
        return max(1, len(self.by_seed))

    @property
    def spread(self) -> Metrics | None:
        """Standard deviation of `overall` over the seeds; None for a single one."""
        return _spread([report.overall for report in self.by_seed])

    @property
    def category_spreads(self) -> dict[str, Metrics]:
        """The same of `categories`; empty for a single seed."""
        groups = [report.categories for report in self.by_seed]
        names = groups[0] if len(groups) > 1 else ()
        found = {name: _spread([group[name] for group in groups]) for name in names}
        return {name: spread for name, spread in found.items() if spread is not None}

    def to_json(self) -> dict[str, object]:
        """Top-level metrics, ``categories`` and ``clips``; ``spread`` over seeds."""
        counts = Counter(result.category for result in self.clips.values())
        groups: dict[str, dict[str, object]] = {
            name: {"num_clips": counts[name], **mean.to_json()}
            for name, mean in self.categories.items()
        }
        for name, spread in self.category_spreads.items():
            groups[name]["spread"] = spread.to_json()
        clips = {
            name: {"category": result.category, **result.metrics.to_json()}
            for name, result in self.clips.items()
        }
        top: dict[str, object] = {"num_clips": len(clips), "num_seeds": self.num_seeds}
        top |= self.overall.to_json()
        if self.spread is not None:
            top["spread"] = self.spread.to_json()
            top["by_seed"] = [report.overall.to_json() for report in self.by_seed]
        return {**top, "categories": groups, "clips": clips}


def _spread(results: Sequence[Metrics]) -> Metrics | None:
    """Standard deviation of each metric over at least two ``results``."""
    if len(results) < 2:
        return None
    values = {
        field.name: np.array([getattr(result, field.name) for result in results])
        for field in fields(Metrics)
    }
    return Metrics(**{name: float(v.std(ddof=1)) for name, v in values.items()})


def over_seeds(reports: Sequence[TrackingReport]) -> TrackingReport:
    """Means over reports of the same clips with different odometry seeds.

    The curves of a clip are those of its first failure, or else of the first seed.
    """
    if len(reports) == 1:
        return reports[0]
    clips: dict[str, ClipResult] = {}
    for name in reports[0].clips:
        runs = [report.clips[name] for report in reports]
        shown = next((run for run in runs if run.metrics.sr < 1.0), runs[0])
        mean = metrics.average([run.metrics for run in runs])
        clips[name] = replace(shown, metrics=mean)
    return TrackingReport(clips, tuple(reports))


def evaluate_tracking(
    clips: Sequence[Clip],
    bundle: Bundle,
    *,
    noise: OdometryNoiseConfig | None = DEFAULT_NOISE,
    look: bool = True,
    seed: int = 0,
    progress: Callable[[int, int, str, ClipResult], None] | None = None,
) -> TrackingReport:
    """Run every clip once.

    Args:
        clips: the references; their names must differ.
        bundle: the student.
        noise: Eq. 2's constants, or None for perfect odometry.
        look: tell the student how the head is turned; section 3.1 does not.
        seed: of the odometry noise. A clip's noise depends on the seed and on the
            clip's name alone, so that subsets of a data set give the same figures.
        progress: called after each clip with its number, the count, name and result.

    Raises:
        InputError: there is no clip, two have one name, or one is too short.
    """
    names = [clip.info.name for clip in clips]
    twice = sorted({name for name in names if names.count(name) > 1})
    if not names or twice:
        raise InputError(
            f"clip {twice[0]!r} occurs twice" if twice else "there are no clips",
            where="evaluate tracking",
            remedy="give clips with names of their own",
        )
    model = build_model()
    robot = SimulatedRobot(model)
    results: dict[str, ClipResult] = {}
    for index, clip in enumerate(clips):
        name = clip.info.name
        reference = make_reference(clip, model)
        robot.reset(reference.qpos[0], reference.start_velocity)
        rng = np.random.default_rng((seed, zlib.crc32(name.encode())))
        trace, qpos = run_clip(Episode(robot, bundle, noise, rng), reference, look)
        wanted = reference.qpos[1 : len(qpos) + 1]
        results[name] = clip_result(clip.info.category, trace, qpos, wanted)
        if progress is not None:
            progress(index + 1, len(clips), name, results[name])
    return TrackingReport(results)
