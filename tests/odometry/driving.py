"""Feeds a stream to FAST-LIO2 and compares every pose with the truth."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

import box_room
import numpy as np

from openclone.errors import InputError
from openclone.odometry.fast_lio import FastLio, FastLioConfig
from openclone.odometry.state import OdometryState
from openclone.spatial import rotations

EVERY = 4
"""Poses are compared at each scan and at every so many IMU samples."""


@dataclass
class Drive:
    """What came out of a run; one entry per comparison."""

    lio: FastLio
    times: list[float] = field(default_factory=list)
    tracking: list[bool] = field(default_factory=list)
    errors: list[float] = field(default_factory=list)
    turns_deg: list[float] = field(default_factory=list)
    reasons: list[str] = field(default_factory=list)
    states: list[OdometryState] = field(default_factory=list)
    refused: int = 0

    def worst_tracked(
        self, without: tuple[float, float] = (np.inf, np.inf)
    ) -> tuple[float, float]:
        """Greatest error in metres and degrees while the odometry was sure.

        ``without`` an interval, seconds, in which it may be wrong.
        """
        times = np.array(self.times)
        sure = np.array(self.tracking) & ~((times > without[0]) & (times < without[1]))
        assert sure.any(), "never tracked"
        errors, turns = np.array(self.errors)[sure], np.array(self.turns_deg)[sure]
        return float(errors.max()), float(turns.max())

    def first_lost(self, after: float) -> float:
        """Seconds from ``after`` until it first called itself lost."""
        for time, sure in zip(self.times, self.tracking, strict=True):
            if time >= after and not sure:
                return time - after
        return np.inf

    def share_lost(self, begin: float, end: float) -> float:
        """Share of the comparisons in an interval at which it was lost."""
        inside = [
            not sure
            for time, sure in zip(self.times, self.tracking, strict=True)
            if begin <= time <= end
        ]
        return float(np.mean(inside))

    def well_at_the_end(self) -> bool:
        return self.tracking[-1] and self.errors[-1] < 0.03 and self.turns_deg[-1] < 1


def drive(
    events: Iterable[box_room.Event],
    world: box_room.World,
    *,
    config: FastLioConfig | None = None,
) -> Drive:
    """Run; poses are compared at the stamps of the IMU."""
    out, count = Drive(FastLio(config)), 0
    for event in events:
        try:
            if event.points is None:
                out.lio.add_imu(round(event.time * 1e9), event.gyro, event.accel)
                count += 1
                if count % EVERY:
                    continue
            else:
                out.states.append(out.lio.add_scan(event.points, event.stamps))
        except InputError:
            out.refused += 1
            continue
        now_ns = round(event.time * 1e9)
        health = out.lio.health(now_ns)
        position, quat = np.zeros(3), np.array(rotations.IDENTITY)
        if health.scans:
            position, quat = out.lio.pose_at(now_ns)
        true_position, true_quat = world.pose(np.array(event.time))
        turn = float(rotations.angle_between(quat, true_quat))
        out.times.append(event.time)
        out.tracking.append(health.tracking)
        out.reasons.append(health.reason)
        out.errors.append(float(np.linalg.norm(position - true_position)))
        out.turns_deg.append(float(np.rad2deg(turn)))
    return out


def aligned_error(estimated: np.ndarray, true: np.ndarray) -> float:
    """Root mean square distance after the best rigid alignment (Umeyama), metres."""
    e, t = estimated - estimated.mean(0), true - true.mean(0)
    u, _, v = np.linalg.svd(e.T @ t)
    sign = np.diag((1.0, 1.0, np.linalg.det(u @ v)))
    return float(np.sqrt(((e @ (u @ sign @ v) - t) ** 2).sum(1).mean()))
