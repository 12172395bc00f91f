"""Pushes: how many of Table A2's the robot survives, standing and walking.

A push changes the robot's velocity at once (Table A2: v_xy = 1.5 m/s, every 5 s). As
in training, each horizontal axis is drawn evenly within ± 1.5 m/s. A fall within three
seconds counts for the push. Runs without pushes, of the same length, show how often the
robot falls anyway.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from openclone.evaluation.episode import Reference, make_reference
from openclone.evaluation.odometry import patrol
from openclone.evaluation.push_run import WINDOW_S, Push, PushConfig, PushRun, push_run
from openclone.motion.clip import ClipInfo, clip_from_qpos
from openclone.odometry.noise import OdometryNoiseConfig
from openclone.policy.bundle import Bundle
from openclone.robot.model import CONTROL_PERIOD, build_model, standing_qpos

DEFAULT_NOISE = OdometryNoiseConfig()
TARGET_PERCENT = 5.0
SPEED_BINS = (0.0, 0.5, 1.0, 1.5, 2.2)
"""m/s, edges; 2.12 is the largest, along the diagonal."""
_EPISODE_S = 32.0
Condition = Literal["stand", "walk"]
CONDITIONS: tuple[Condition, ...] = ("stand", "walk")


@dataclass(frozen=True)
class PushResult:
    """All pushes under one condition.

    Attributes:
        run: with pushes.
        quiet: the same without.
    """

    run: PushRun
    quiet: PushRun

    @property
    def pushes(self) -> tuple[Push, ...]:
        """What came of each."""
        return self.run.pushes

    @property
    def falls(self) -> int:
        """Pushes that made the robot fall."""
        return sum(push.fell for push in self.pushes)

    def by_speed(self) -> list[tuple[float, float, int, int]]:
        """From, to (m/s), pushes and falls, for each of `SPEED_BINS`."""
        rows = []
        for low, high in itertools.pairwise(SPEED_BINS):
            some = [push for push in self.pushes if low <= push.speed < high]
            rows.append((low, high, len(some), sum(push.fell for push in some)))
        return rows

    def to_json(self) -> dict[str, object]:
        """The figures."""
        count = len(self.pushes)
        low, high = share_interval(self.falls, count)
        stayed = [push.distance_m for push in self.pushes if not push.fell]
        return {
            "pushes": count,
            "falls": self.falls,
            "falls_percent": 100.0 * self.falls / max(count, 1),
            "falls_percent_low": 100.0 * low,
            "falls_percent_high": 100.0 * high,
            "other_falls": self.run.other_falls,
            "seconds": self.run.seconds,
            "falls_without_pushes": self.quiet.falls,
            "seconds_without_pushes": self.quiet.seconds,
            "distance_after_mm": 1000.0 * float(np.mean(stayed)) if stayed else None,
            "by_speed": [
                {"from_m_s": a, "to_m_s": b, "pushes": n, "falls": k}
                for a, b, n, k in self.by_speed()
            ],
        }


@dataclass(frozen=True)
class PushReport:
    """Results by condition."""

    conditions: dict[str, PushResult]
    config: PushConfig

    def to_json(self) -> dict[str, object]:
        """All conditions together at the top, then each."""
        results = list(self.conditions.values())
        pushes = sum(len(result.pushes) for result in results)
        falls = sum(result.falls for result in results)
        return {
            "pushes": pushes,
            "falls": falls,
            "falls_percent": 100.0 * falls / max(pushes, 1),
            "target_percent": TARGET_PERCENT,
            "speed_m_s": self.config.speed,
            "window_s": WINDOW_S,
            "conditions": {k: v.to_json() for k, v in self.conditions.items()},
        }


def share_interval(hits: int, count: int) -> tuple[float, float]:
    """Wilson's 95 % interval for a share of ``hits`` in ``count``, 0 to 1."""
    if count == 0:
        return 0.0, 1.0
    z, share = 1.96, hits / count
    middle = share + z * z / (2 * count)
    half = z * math.sqrt(share * (1 - share) / count + z * z / (4 * count * count))
    scale = 1.0 + z * z / count
    return max(0.0, (middle - half) / scale), min(1.0, (middle + half) / scale)


def operator_reference(condition: Condition, seconds: float) -> Reference:
    """A still operator, or one who walks slow laps with stops."""
    if condition == "walk":
        return make_reference(patrol(seconds), build_model())
    frames = round(seconds / CONTROL_PERIOD) + 1
    info = ClipInfo("stand", "stand", "standing pose", "", 1.0 / CONTROL_PERIOD)
    qpos = np.tile(standing_qpos(), (frames, 1))
    return make_reference(clip_from_qpos(info, qpos), build_model())


def evaluate_pushes(
    bundle: Bundle,
    *,
    count: int = 100,
    conditions: tuple[Condition, ...] = CONDITIONS,
    config: PushConfig | None = None,
    noise: OdometryNoiseConfig | None = DEFAULT_NOISE,
    seed: int = 0,
    progress: Callable[[str, PushResult], None] | None = None,
) -> PushReport:
    """Push the robot ``count`` times under each condition.

    Args:
        bundle: the student.
        count: pushes.
        conditions: what the operator does.
        config: size and frequency.
        noise: Eq. 2's constants, or None for perfect odometry.
        seed: of times, directions and odometry errors.
        progress: called after each condition.
    """
    config = config or PushConfig()
    found: dict[str, PushResult] = {}
    for index, condition in enumerate(conditions):
        found[condition] = _push_result(
            bundle, condition, count, config, noise, (seed, index)
        )
        if progress is not None:
            progress(condition, found[condition])
    return PushReport(found, config)


def _push_result(
    bundle: Bundle,
    condition: Condition,
    count: int,
    config: PushConfig,
    noise: OdometryNoiseConfig | None,
    seed: tuple[int, int],
) -> PushResult:
    """The same times and errors with pushes and without."""
    reference = operator_reference(condition, _EPISODE_S)
    moving = config.walking_speed if condition == "walk" else 0.0
    runs = [
        push_run(
            bundle,
            reference,
            count,
            replace(config, speed=speed),
            moving,
            noise,
            np.random.default_rng(seed),
        )
        for speed in (config.speed, 0.0)
    ]
    return PushResult(*runs)
