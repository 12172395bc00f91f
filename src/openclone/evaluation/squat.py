"""Squatting: the operator lowers the head, waits, and comes up again (Fig. 3).

The paper edits motions to head heights of 1.2 m (standing) to 0.6 m (deep squatting):
heights of the robot. A person whose head is 0.6 m above the ground is lower still once
scaled to the robot, lower than the editing of `motion.heights` finds sound poses with
flat soles. There is no whole-body reference for that: head and hands are commanded
further down, and only they are judged.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from openclone.evaluation import metrics
from openclone.evaluation.episode import Episode, run_clip
from openclone.evaluation.metrics import Metrics, Trace
from openclone.evaluation.operator import HEAD_HEIGHT
from openclone.evaluation.squat_reference import (
    DEEPEST,
    SquatReference,
    squat_reference,
)
from openclone.motion.heights import FIG_3_HEIGHTS
from openclone.odometry.noise import OdometryNoiseConfig
from openclone.policy.bundle import Bundle
from openclone.robot.kinematics import Kinematics
from openclone.robot.model import build_model
from openclone.robot.state import key_point_poses
from openclone.simulation.robot import SimulatedRobot
from openclone.teleop.calibration import RobotBody

DEFAULT_NOISE = OdometryNoiseConfig()
TARGET_SR = 95.0
"""Percent, at an operator's head height of 0.6 m (and the head as low as told)."""
TOLERANCE = 0.10
"""Metres; the head came as low as it was told if it is at most this far off."""


@dataclass(frozen=True)
class Trial:
    """One squat.

    Attributes:
        success: neither fell nor strayed (section 4.1), and stood upright at the end.
        fell: whether the robot fell.
        reached: whether the head was within the tolerance of its target at the bottom.
        low_m: mean head height at the bottom, metres; NaN if it fell before.
        head_m, target_m: (T,), head height over time and what was commanded.
        metrics: of section 4.1; None where there is no whole-body reference.
    """

    success: bool
    fell: bool
    reached: bool
    low_m: float
    head_m: np.ndarray
    target_m: np.ndarray
    metrics: Metrics | None


@dataclass(frozen=True)
class SquatLevel:
    """All trials of one head height.

    Attributes:
        operator_m: metres, head height of the operator.
        target_m: metres, the same on the robot.
        trials: what happened.
    """

    operator_m: float
    target_m: float
    trials: tuple[Trial, ...]

    @property
    def sr(self) -> float:
        """Share of the trials without a fall and back upright, percent."""
        return 100.0 * float(np.mean([trial.success for trial in self.trials]))

    @property
    def reached(self) -> float:
        """Share of the trials that came as low as told, percent."""
        return 100.0 * float(np.mean([trial.reached for trial in self.trials]))

    @property
    def sr_reached(self) -> float:
        """Share of the trials that did both, percent."""
        both = [trial.success and trial.reached for trial in self.trials]
        return 100.0 * float(np.mean(both))

    @property
    def low_m(self) -> np.ndarray:
        """(n,) head heights at the bottom, of the trials that got there."""
        heights = np.array([trial.low_m for trial in self.trials])
        return heights[np.isfinite(heights)]

    @property
    def metrics(self) -> Metrics | None:
        """Means of section 4.1's metrics, if there is a whole-body reference."""
        found = [trial.metrics for trial in self.trials if trial.metrics is not None]
        return metrics.average(found) if found else None

    def to_json(self) -> dict[str, object]:
        """The figures of this height."""
        low = self.low_m
        known = self.metrics.to_json() if self.metrics is not None else {}
        known.pop("sr", None)
        return {
            "operator_m": round(self.operator_m, 3),
            "target_m": round(self.target_m, 3),
            "trials": len(self.trials),
            "falls": sum(trial.fell for trial in self.trials),
            "sr": self.sr,
            "reached_percent": self.reached,
            "sr_reached": self.sr_reached,
            "reached_mean_m": float(low.mean()) if len(low) else None,
            "reached_min_m": float(low.min()) if len(low) else None,
            "reached_max_m": float(low.max()) if len(low) else None,
            **known,
        }


@dataclass(frozen=True)
class SquatReport:
    """Squats to the heights of Fig. 3, and of an operator.

    Attributes:
        stances: to 1.2 m ... 0.6 m of the robot's head.
        operator: to 1.2 m ... 0.6 m of the operator's head.
    """

    stances: tuple[SquatLevel, ...]
    operator: tuple[SquatLevel, ...]

    def to_json(self) -> dict[str, object]:
        """Both series; at the top the operator's deepest squat."""
        deepest = min(self.operator, key=lambda level: level.target_m)
        return {
            **deepest.to_json(),
            "tolerance_m": TOLERANCE,
            "target_sr_reached": TARGET_SR,
            "lowest_reference_m": DEEPEST,
            "stances": [level.to_json() for level in self.stances],
            "operator": [level.to_json() for level in self.operator],
        }


def operator_scale() -> float:
    """Metres of the robot's head height per metre of the operator's."""
    return RobotBody.of(Kinematics()).head_height / HEAD_HEIGHT


def evaluate_squat(
    bundle: Bundle,
    *,
    trials: int = 10,
    heights: tuple[float, ...] = FIG_3_HEIGHTS,
    noise: OdometryNoiseConfig | None = DEFAULT_NOISE,
    seed: int = 0,
    progress: Callable[[SquatLevel], None] | None = None,
) -> SquatReport:
    """Squat to each of ``heights``, once as the robot's and once as the operator's.

    Args:
        bundle: the student.
        trials: per height; each has its own arms, pace and odometry error.
        heights: metres.
        noise: Eq. 2's constants, or None for perfect odometry.
        seed: of everything that is drawn.
        progress: called after each height.
    """
    robot = SimulatedRobot(build_model())
    scale = operator_scale()

    def level(operator_m: float, target_m: float) -> SquatLevel:
        done = []
        for trial in range(trials):
            # The same arms, pace and error at every height.
            rng = np.random.default_rng((seed, trial))
            wanted = squat_reference(target_m, rng)
            robot.reset(wanted.reference.qpos[0])
            done.append(_try(Episode(robot, bundle, noise, rng), wanted))
        found = SquatLevel(operator_m, target_m, tuple(done))
        if progress is not None:
            progress(found)
        return found

    stances = tuple(level(height / scale, height) for height in heights)
    operator = tuple(level(height, height * scale) for height in heights)
    return SquatReport(stances, operator)


def _try(episode: Episode, wanted: SquatReference) -> Trial:
    trace, _ = run_clip(episode, wanted.reference)
    return judge(trace, wanted)


def judge(trace: Trace, wanted: SquatReference) -> Trial:
    """What ``trace``, a run along ``wanted``, is worth."""
    points, _ = key_point_poses(trace.position, trace.quat)
    head = points[:, 0, 2]
    # The trace begins with the reference's second frame.
    target = wanted.reference.points[1 : len(head) + 1, 0, 2]
    low = head[wanted.low.start - 1 : wanted.low.stop - 1]
    low_m = float(low.mean()) if len(low) else float("nan")
    upright = not trace.fell
    if upright:
        end = slice(wanted.risen.start - 1, wanted.risen.stop - 1)
        upright = float(np.abs(head[end] - target[end]).max()) <= TOLERANCE
    return Trial(
        success=upright and metrics.succeeded(trace),
        fell=trace.fell,
        reached=bool(abs(low_m - wanted.target) <= TOLERANCE),
        low_m=low_m,
        head_m=head,
        target_m=target,
        metrics=metrics.measure(trace) if wanted.has_body else None,
    )
