"""The operator's pose, moved no faster than the robot can go."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from openclone.policy.command import KeyPoints
from openclone.spatial import rotations


@dataclass(frozen=True)
class GovernorConfig:
    """What the robot can follow over the ground; the shipped policy's by default.

    An operator who is faster is caught up with at these rates; up and down there is no
    limit. Measured live on 30 recordings of `train` that stand, walk or turn: 4 falls
    (a walk that becomes a run, a crouch, two jogs in a circle), the body 0.18 m off;
    with 0.6 m/s and 0.7 m/s², which an earlier policy needed, 6 falls and 0.36 m.

    Attributes:
        travel_speed: m/s over the ground, of the head.
        travel_acceleration: m/s², of that speed while it rises.
        turn_speed: rad/s of the heading.
    """

    travel_speed: float = 0.9
    travel_acceleration: float = 1.5
    turn_speed: float = math.radians(45.0)


_AT_ONCE = 0.3
"""m/s that need no run-up: a standing robot shifts its weight so fast."""


class Governor:
    """Moves head and hands together, as one rigid pose, behind the operator."""

    def __init__(self, config: GovernorConfig | None = None) -> None:
        """Start without any pose."""
        self._config = config or GovernorConfig()
        self._place: np.ndarray | None = None
        self._yaw = self._speed = 0.0

    def reset(self) -> None:
        """The next pose is taken as it is."""
        self._place = None

    def follow(self, targets: KeyPoints, period: float) -> KeyPoints:
        """``targets``, or as far on the way there as the robot can be.

        Args:
            targets: where the operator wants head and hands, robot's world.
            period: seconds since the targets before.
        """
        head, heading = targets.position[0], rotations.heading(targets.quat[0])
        yaw = float(rotations.yaw(heading))
        if self._place is None or period <= 0.0:
            self._place, self._yaw, self._speed = head.copy(), yaw, 0.0
            return targets
        self._travel(head, period)
        self._place[2] = head[2]
        turn = self._config.turn_speed * period
        ahead = float(rotations.wrap_angle(np.array(yaw - self._yaw)))
        self._yaw += float(np.clip(ahead, -turn, turn))
        back = rotations.from_yaw(np.array(self._yaw - yaw))
        backs = np.broadcast_to(back, targets.quat.shape)
        around = rotations.rotate(backs, targets.position - head)
        return KeyPoints(self._place + around, rotations.multiply(backs, targets.quat))

    def _travel(self, head: np.ndarray, period: float) -> None:
        """One step of the head's place over the ground towards ``head``."""
        assert self._place is not None
        config = self._config
        gained = self._speed + config.travel_acceleration * period
        reach = min(config.travel_speed, max(_AT_ONCE, gained)) * period
        way = head[:2] - self._place[:2]
        distance = float(np.linalg.norm(way))
        share = 1.0 if distance <= reach else reach / distance
        self._place[:2] += share * way
        self._speed = share * distance / period
