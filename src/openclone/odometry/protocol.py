"""What teleoperation needs from any odometry."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np


@dataclass(frozen=True)
class OdometryHealth:
    """Whether poses may be trusted now.

    Attributes:
        tracking: False while it starts up or after it lost its way.
        age_ns: age of the newest pose.
    """

    tracking: bool
    age_ns: int


class Odometry(Protocol):
    """Tells where the robot's base is in a world of its own, Z up."""

    def pose_at(self, stamp_ns: int) -> tuple[np.ndarray, np.ndarray]:
        """Position ``(3,)``, metres, and wxyz ``(4,)``, as known at ``stamp_ns``."""
        ...

    def health(self, stamp_ns: int) -> OdometryHealth:
        """The state of the odometry at ``stamp_ns``."""
        ...
