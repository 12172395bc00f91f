"""The operator's frames become a smooth command with velocities."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from openclone.policy.command import Command, KeyPoints
from openclone.robot.model import CONTROL_PERIOD
from openclone.spatial import rotations
from openclone.spatial.filters import (
    Differentiator,
    OneEuroConfig,
    OneEuroFilter,
    OneEuroRotationFilter,
)
from openclone.teleop.calibration import Calibration
from openclone.teleop.messages import OperatorFrame


@dataclass(frozen=True)
class TrackerConfig:
    """Smoothing of the operator.

    Attributes:
        position: One-Euro filter of the points, speeds in m/s.
        rotation: One-Euro filter of the orientations, speeds in rad/s.
        velocity_cutoff_hz: low-pass of the target velocities.
        max_speed: m/s; a faster jump of a point is taken for a tracking error.
        max_lead_s: seconds that a target is extrapolated at most.
    """

    position: OneEuroConfig = field(
        default_factory=lambda: OneEuroConfig(3.0, 8.0, 3.0)
    )
    rotation: OneEuroConfig = field(
        default_factory=lambda: OneEuroConfig(3.0, 4.0, 3.0)
    )
    velocity_cutoff_hz: float = 10.0
    max_speed: float = 15.0
    max_lead_s: float = 0.06


class OperatorTracker:
    """Filters one operator's frames and serves commands in the robot's world."""

    def __init__(
        self, calibration: Calibration, config: TrackerConfig | None = None
    ) -> None:
        """Start without any frame."""
        self._calibration = calibration
        self._config = config or TrackerConfig()
        self._points = OneEuroFilter(self._config.position)
        self._turns = OneEuroRotationFilter(self._config.rotation)
        self._differentiator = Differentiator(self._config.velocity_cutoff_hz)
        self._last: OperatorFrame | None = None
        self._targets: KeyPoints | None = None
        self._velocity = np.zeros((3, 3))

    def update(self, frame: OperatorFrame) -> None:
        """Take a frame; one that was already taken changes nothing."""
        last = self._last
        if last is not None and frame.sensor_stamp_ns <= last.sensor_stamp_ns:
            return
        period = 0.0
        if last is not None:
            period = (frame.sensor_stamp_ns - last.sensor_stamp_ns) * 1e-9
            frame = self._plausible(frame, last, period)
        positions = self._points.update(frame.positions, period)
        quats = self._turns.update(frame.quats, period)
        self._targets = self._calibration.apply(positions, quats)
        self._velocity = self._differentiator.update(self._targets.position, period)
        self._last = frame

    def command(self, now_ns: int, stale: bool) -> Command:
        """The targets for the next control step, extrapolated to it.

        Args:
            now_ns: the loop's clock.
            stale: hold the last pose with zero velocity.
        """
        assert self._targets is not None
        assert self._last is not None
        if stale:
            return Command(self._targets, np.zeros((3, 3)))
        age = (now_ns - self._last.receive_stamp_ns) * 1e-9
        lead = min(max(age, 0.0) + CONTROL_PERIOD, self._config.max_lead_s)
        position = self._targets.position + lead * self._velocity
        return Command(KeyPoints(position, self._targets.quat), self._velocity)

    def _plausible(
        self, frame: OperatorFrame, last: OperatorFrame, period: float
    ) -> OperatorFrame:
        """Replace points that are lost or have jumped by their last good pose.

        A hand that is lost stays where it was relative to the head.
        """
        moved = frame.positions - last.positions
        jumped = np.linalg.norm(moved, axis=1) > self._config.max_speed * period
        bad = jumped | ~frame.tracked
        if not bad.any():
            return frame
        positions, quats = frame.positions.copy(), frame.quats.copy()
        head_move = np.zeros(3) if bad[0] else moved[0]
        positions[bad] = last.positions[bad] + head_move
        quats[bad] = last.quats[bad]
        return OperatorFrame(
            frame.sensor_stamp_ns,
            frame.receive_stamp_ns,
            positions,
            quats,
            frame.tracked & ~jumped,
        )


def blend_commands(start: KeyPoints, command: Command, weight: float) -> Command:
    """Between the held points (weight 0) and ``command`` (weight 1)."""
    if weight >= 1.0:
        return command
    target = command.target
    # Smoothstep: no jerk at either end.
    weight = weight * weight * (3.0 - 2.0 * weight)
    position = start.position + weight * (target.position - start.position)
    quat = rotations.slerp(start.quat, target.quat, weight)
    return Command(KeyPoints(position, quat), weight * command.velocity)
