"""What real LiDAR odometry does besides wandering: it is late, slow, blind, or jumps.

Training shows these faults to the student on top of the error of Eq. 2 (`noise`). They
act on positions; orientation comes from the robot's IMU and has none of them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class OdometryFaultsConfig:
    """Faults of an odometry; all are off by default.

    Attributes:
        delay: seconds, largest age of what is published; drawn for each episode.
        scan_rate_hz: corrections by the LiDAR per second (section 3.2: 10); None: one
            in every control step.
        propagation: between scans the IMU carries the position on; without it the last
            position is held.
        velocity_error: m/s, standard deviation per axis of the velocity with which the
            IMU carries it on, new after every scan.
        dropout_interval: seconds between losses of scans on average; None: never.
        dropout_seconds: seconds, longest loss; uniform from 0.
        jump_interval: seconds between jumps on average; None: never.
        jump_size: metres, largest jump; uniform from 0, in any direction.
        jump_seconds: seconds after which a jump is taken back, on average.
    """

    delay: float = 0.0
    scan_rate_hz: float | None = None
    propagation: bool = True
    velocity_error: float = 0.0
    dropout_interval: float | None = None
    dropout_seconds: float = 0.5
    jump_interval: float | None = None
    jump_size: float = 0.10
    jump_seconds: float = 2.0


REAL = OdometryFaultsConfig(
    delay=0.06,
    scan_rate_hz=10.0,
    velocity_error=0.05,
    dropout_interval=20.0,
    jump_interval=20.0,
)
"""A 10 Hz LiDAR odometry with its usual bad moments."""

_HALF_NANOSECOND = 5e-10


class OdometryFaults:
    """The positions that the odometries of a batch of robots publish."""

    def __init__(
        self,
        position: np.ndarray,
        config: OdometryFaultsConfig,
        period: float,
        rng: np.random.Generator,
    ) -> None:
        """Start without faults in the air.

        Args:
            position: (n, 3), metres, world, where the robots are.
            config: which faults there are.
            period: seconds between calls of `step`.
            rng: source of all draws.
        """
        self.config, self._period, self._rng = config, period, rng
        count = len(position)
        kept = int(np.ceil(config.delay / period - 1e-9)) + 2
        self._past = np.repeat(position[None].astype(float), kept, axis=0)
        self.delay = np.zeros(count)
        """(n,) seconds, this episode's."""
        self._anchor = position.astype(float).copy()
        """Position published at the last scan."""
        self._seen = self._anchor.copy()
        """True position of which that scan was taken."""
        self._drift = np.zeros((count, 3))
        self._since_scan = np.zeros(count)
        self._phase = np.zeros(count)
        self._blind = np.zeros(count)
        self.jump = np.zeros((count, 3))
        """(n, 3), metres: the jump that the scans suffer from now."""
        self.reset(np.arange(count), position)

    @property
    def blind(self) -> np.ndarray:
        """(n,) bool: whether scans are being lost."""
        return self._blind > 0

    def reset(self, ids: np.ndarray, position: np.ndarray) -> None:
        """New episodes of ``ids``, at ``position (len(ids), 3)``: no faults yet."""
        self._past[:, ids] = position
        self._anchor[ids] = self._seen[ids] = position
        self._drift[ids] = self.jump[ids] = 0.0
        self._blind[ids] = self._since_scan[ids] = self._phase[ids] = 0.0
        self.delay[ids] = self._rng.uniform(0.0, self.config.delay, len(ids))
        if self.config.scan_rate_hz is not None:
            scan_period = 1.0 / self.config.scan_rate_hz
            # Scans are not in step with the control loop.
            self._phase[ids] = self._rng.uniform(0.0, scan_period, len(ids))

    def step(self, position: np.ndarray, error: np.ndarray) -> np.ndarray:
        """Advance by one period.

        Args:
            position: (n, 3), metres, world, true.
            error: (n, 3), metres, of scans taken now (Eq. 2).

        Returns:
            (n, 3), metres: what the odometries publish now.
        """
        self._past = np.concatenate((position[None], self._past[:-1]))
        late = self._late()
        self._start_dropouts()
        self._start_jumps()
        scanned = self._scan()
        self._anchor[scanned] = (late + error + self.jump)[scanned]
        self._seen[scanned] = late[scanned]
        count = int(scanned.sum())
        drift = self._rng.standard_normal((count, 3)) * self.config.velocity_error
        self._drift[scanned] = drift
        if not self.config.propagation:
            return self._anchor.copy()
        carried = late - self._seen + self._since_scan[:, None] * self._drift
        return self._anchor + carried

    def _late(self) -> np.ndarray:
        """True positions of ``delay`` ago, (n, 3)."""
        back = self.delay / self._period
        whole = back.astype(int)
        part = (back - whole)[:, None]
        robots = np.arange(len(back))
        newer, older = self._past[whole, robots], self._past[whole + 1, robots]
        return (1.0 - part) * newer + part * older

    def _scan(self) -> np.ndarray:
        """(n,) bool: robots whose scan arrives now."""
        rate = self.config.scan_rate_hz
        scan_period = self._period if rate is None else 1.0 / rate
        self._phase += self._period
        due = self._phase >= scan_period - _HALF_NANOSECOND
        self._phase[due] -= scan_period
        arrived = due & (self._blind <= 0)
        self._blind -= self._period
        self._since_scan += self._period
        self._since_scan[arrived] = 0.0
        return arrived

    def _start_dropouts(self) -> None:
        interval = self.config.dropout_interval
        if interval is None:
            return
        begins = self._rng.random(len(self._blind)) < self._period / interval
        begins &= self._blind <= 0
        seconds = self._rng.uniform(0.0, self.config.dropout_seconds, begins.sum())
        self._blind[begins] = seconds

    def _start_jumps(self) -> None:
        config = self.config
        if config.jump_interval is None:
            return
        count = len(self.jump)
        ends = self._rng.random(count) < self._period / config.jump_seconds
        self.jump[ends] = 0.0
        begins = self._rng.random(count) < self._period / config.jump_interval
        direction = self._rng.standard_normal((int(begins.sum()), 3))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        size = self._rng.uniform(0.0, config.jump_size, (len(direction), 1))
        self.jump[begins] = size * direction
