"""Odometry from another program: poses arrive as ``nav_msgs/Odometry`` or the like."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from openclone.odometry.motion_model import ConstantVelocity
from openclone.odometry.protocol import OdometryHealth


@dataclass(frozen=True)
class ExternalOdometryConfig:
    """How far a foreign source is trusted.

    Attributes:
        stale_ns: older poses no longer count as tracking.
        max_speed: m/s; a faster jump between two poses is refused.
        max_jump_m: metres allowed on top of it, for the source's own corrections.
        restart_count: so many refused jumps in a row are believed: it was relocated.
    """

    stale_ns: int = 300_000_000
    max_speed: float = 5.0
    max_jump_m: float = 0.3
    restart_count: int = 10


class ExternalOdometry:
    """Serves poses that some transport delivers (`protocol.PoseOdometry`).

    It is unhealthy before the first pose, when poses stop coming, and while they jump.
    """

    def __init__(self, config: ExternalOdometryConfig | None = None) -> None:
        """Wait for the first pose."""
        self._config = config or ExternalOdometryConfig()
        self._motion = ConstantVelocity(self._config.stale_ns)
        self.reset()

    def reset(self) -> None:
        """Forget all poses."""
        self._motion.reset()
        self._newest: tuple[int, np.ndarray] | None = None
        self._offset_ns = 0
        self._refused_jumps = 0
        self.refused = 0

    def add_pose(
        self, stamp_ns: int, position: np.ndarray, quat: np.ndarray, received_ns: int
    ) -> bool:
        """Take one pose.

        Args:
            stamp_ns: when it held, in the source's clock.
            position: (3,), metres, in the source's world, Z up.
            quat: (4,), wxyz, world from base.
            received_ns: when it arrived, in this program's clock.

        Returns:
            False if it was refused (and counted in ``refused``): NaN, a quaternion that
            is none, a stamp that does not rise, or a jump.
        """
        position, quat = np.asarray(position, float), np.asarray(quat, float)
        if self._is_valid(stamp_ns, position, quat) and not self._jumps(
            stamp_ns, position
        ):
            # The least delay seen relates the two clocks; a slow message moves nothing.
            offset_ns = received_ns - stamp_ns
            if self._newest is None or offset_ns < self._offset_ns:
                self._offset_ns = offset_ns
            self._newest = (stamp_ns, position.copy())
            quat = quat / np.linalg.norm(quat)
            self._motion.update(stamp_ns + self._offset_ns, position, quat)
            return True
        self.refused += 1
        return False

    def pose_at(self, stamp_ns: int) -> tuple[np.ndarray, np.ndarray]:
        """Position (3,) and wxyz (4,) at ``stamp_ns`` of this program's clock."""
        return self._motion.pose_at(stamp_ns)

    def health(self, stamp_ns: int) -> OdometryHealth:
        """Tracking while poses are fresh and do not jump."""
        newest_ns = self._motion.stamp_ns
        if newest_ns is None:
            return OdometryHealth(tracking=False, age_ns=0)
        age_ns = stamp_ns - newest_ns
        fresh = age_ns <= self._config.stale_ns and not self._refused_jumps
        return OdometryHealth(tracking=fresh, age_ns=age_ns)

    def _is_valid(self, stamp_ns: int, position: np.ndarray, quat: np.ndarray) -> bool:
        if position.shape != (3,) or quat.shape != (4,):
            return False
        size = float(np.linalg.norm(quat))
        return (
            bool(np.isfinite(position).all())
            and 0.9 < size < 1.1
            and (self._newest is None or stamp_ns > self._newest[0])
        )

    def _jumps(self, stamp_ns: int, position: np.ndarray) -> bool:
        if self._newest is None:
            return False
        before_ns, before = self._newest
        way = float(np.linalg.norm(position - before))
        elapsed = (stamp_ns - before_ns) * 1e-9
        config = self._config
        if way <= config.max_jump_m + config.max_speed * elapsed:
            self._refused_jumps = 0
            return False
        self._refused_jumps += 1
        if self._refused_jumps >= config.restart_count:
            self._refused_jumps = 0
            self._motion.reset()
            return False
        return True
