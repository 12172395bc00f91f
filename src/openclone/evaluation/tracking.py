"""Tracking of reference motions in closed loop (section 4.1, Table 1).

For each clip the simulated robot starts on the first frame and the student follows the
key points of the reference; only head and hands are told to it. No operator, no
calibration and no safety machine stand in between: this measures the policy.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass

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
    """Results by clip name, and their means."""

    clips: dict[str, ClipResult]

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

    def to_json(self) -> dict[str, object]:
        """Top-level metrics, ``categories`` and ``clips``."""
        groups = {name: mean.to_json() for name, mean in self.categories.items()}
        clips = {
            name: {"category": result.category, **result.metrics.to_json()}
            for name, result in self.clips.items()
        }
        top = {"num_clips": len(clips), **self.overall.to_json()}
        return {**top, "categories": groups, "clips": clips}


def evaluate_tracking(
    clips: Sequence[Clip],
    bundle: Bundle,
    *,
    noise: OdometryNoiseConfig | None = DEFAULT_NOISE,
    seed: int = 0,
    progress: Callable[[int, int, str, ClipResult], None] | None = None,
) -> TrackingReport:
    """Run every clip once.

    Args:
        clips: the references; their names must differ.
        bundle: the student.
        noise: Eq. 2's constants, or None for perfect odometry.
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
        trace, qpos = run_clip(Episode(robot, bundle, noise, rng), reference)
        wanted = reference.qpos[1 : len(qpos) + 1]
        results[name] = clip_result(clip.info.category, trace, qpos, wanted)
        if progress is not None:
            progress(index + 1, len(clips), name, results[name])
    return TrackingReport(results)
