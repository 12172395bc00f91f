"""The operator's frames become a smooth command with velocities."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from openclone.policy.command import Command, KeyPoints
from openclone.policy.governor import Governor, GovernorConfig
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
        max_speed: m/s; a point that moves faster has jumped and is not believed, until
            the time that has passed makes the distance plausible.
        max_target_speed: m/s; target velocities are cut to this.
        max_lead_s: seconds that a target is extrapolated at most.
        anchor_distance: metres; if the operator reappears further away than this, the
            head's target stays where it is and the map is moved instead.
        governor: how fast the targets may move together.
        look: trunk and head of the robot turn as the operator's head does. Else one
            may look around freely: recorded people turn the head against the chest by
            up to 60 degrees, and the G1 has no neck.
    """

    position: OneEuroConfig = field(
        default_factory=lambda: OneEuroConfig(3.0, 8.0, 3.0)
    )
    rotation: OneEuroConfig = field(
        default_factory=lambda: OneEuroConfig(3.0, 4.0, 3.0)
    )
    velocity_cutoff_hz: float = 10.0
    max_speed: float = 15.0
    max_target_speed: float = 4.0
    max_lead_s: float = 0.06
    anchor_distance: float = 0.3
    governor: GovernorConfig = field(default_factory=GovernorConfig)
    look: bool = False


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
        self._governor = Governor(self._config.governor)
        self._velocity = np.zeros((3, 3))
        self._doubted_s = np.zeros(3)

    def update(self, frame: OperatorFrame) -> None:
        """Take a frame; one that was already taken changes nothing."""
        last = self._last
        if last is not None and frame.sensor_stamp_ns <= last.sensor_stamp_ns:
            return
        period = 0.0
        if last is not None:
            period = (frame.sensor_stamp_ns - last.sensor_stamp_ns) * 1e-9
            frame, head_jumped = self._plausible(frame, last, period)
            if head_jumped:
                self.resume(frame)
                return
        positions = self._points.update(frame.positions, period)
        quats = self._turns.update(frame.quats, period)
        wanted = self._calibration.apply(positions, quats)
        self._targets = self._governor.follow(wanted, period)
        velocity = self._differentiator.update(self._targets.position, period)
        speed = np.maximum(np.linalg.norm(velocity, axis=1, keepdims=True), 1e-9)
        self._velocity = velocity * np.minimum(
            1.0, self._config.max_target_speed / speed
        )
        self._last = frame

    def resume(self, frame: OperatorFrame) -> None:
        """Begin afresh with ``frame`` after a gap or a jump.

        If the operator went far meanwhile, the robot shall not run after: the head's
        place and heading in the operator's world are mapped to the last target.
        """
        held = self._targets
        target = self._calibration.apply(frame.positions, frame.quats)
        if held is not None:
            moved = np.linalg.norm(target.position[0] - held.position[0])
            if moved > self._config.anchor_distance:
                self._calibration = self._calibration.anchored(
                    frame.positions, frame.quats, held
                )
        for part in (self._points, self._turns, self._differentiator):
            part.reset()
        self._doubted_s[:] = 0.0
        self._last = None
        self._governor.reset()
        self.update(frame)

    def command(self, now_ns: int, stale: bool) -> Command:
        """The targets for the next control step, extrapolated to it.

        Args:
            now_ns: the loop's clock.
            stale: hold the last pose with zero velocity.
        """
        assert self._targets is not None
        assert self._last is not None
        look = float(self._config.look)
        if stale:
            return Command(self._targets, np.zeros((3, 3)), look)
        age = (now_ns - self._last.receive_stamp_ns) * 1e-9
        lead = min(max(age, 0.0) + CONTROL_PERIOD, self._config.max_lead_s)
        position = self._targets.position + lead * self._velocity
        return Command(KeyPoints(position, self._targets.quat), self._velocity, look)

    def _plausible(
        self, frame: OperatorFrame, last: OperatorFrame, period: float
    ) -> tuple[OperatorFrame, bool]:
        """Replace points that are lost or have jumped by their last good pose.

        A hand that is lost stays where it was relative to the head; without the head
        everything stays.

        Returns:
            The frame to use, and whether the head has come to rest after a jump.
        """
        moved = frame.positions - last.positions
        distance = np.linalg.norm(moved, axis=1)
        jumped = distance > self._config.max_speed * (period + self._doubted_s)
        bad = jumped | ~frame.tracked
        bad |= bad[0]  # a hand means nothing without the head
        head_jumped = bool(
            not bad[0]
            and self._doubted_s[0] > 0.0
            and distance[0] > self._config.anchor_distance
        )
        self._doubted_s = np.where(bad, self._doubted_s + period, 0.0)
        if not bad.any() or head_jumped:
            return frame, head_jumped
        positions, quats = frame.positions.copy(), frame.quats.copy()
        positions[bad] = last.positions[bad]
        if not bad[0]:
            positions[bad] += moved[0]
        quats[bad] = last.quats[bad]
        used = replace(
            frame, positions=positions, quats=quats, tracked=frame.tracked & ~jumped
        )
        return used, False


def blend_commands(start: KeyPoints, command: Command, weight: float) -> Command:
    """Between the held points (weight 0) and ``command`` (weight 1)."""
    if weight >= 1.0:
        return command
    target = command.target
    # Smoothstep: no jerk at either end.
    weight = weight * weight * (3.0 - 2.0 * weight)
    position = start.position + weight * (target.position - start.position)
    quat = rotations.slerp(start.quat, target.quat, weight)
    return Command(KeyPoints(position, quat), weight * command.velocity, command.look)
