"""Poses at the rate of the IMU between the poses of a slower odometry.

The IMU is integrated from the newest pose on. Each pose corrects what was integrated,
by fixed shares (an observer): the head of a walking robot turns and bobs faster than
ten poses a second can show, and the difference of two poses is a poor velocity.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass, field

import numpy as np

from openclone.odometry import manifold as m
from openclone.odometry.filter import coast
from openclone.odometry.history import LivePoses
from openclone.odometry.imu import (
    STANDARD_GRAVITY,
    ClockJump,
    ImuBuffer,
    ImuConfig,
)
from openclone.spatial import rotations


@dataclass(frozen=True)
class FollowerConfig:
    """How far one pose corrects what the IMU said.

    Attributes:
        shift: share of the position's error.
        speed: share of the same error over the time since the last pose, for the
            velocity.
        turn: share of the rotation's error.
        drift: share of the rotation's error over the same time, for the gyro's bias.
        max_shift: metres; a greater error means that the pose jumped: it is taken.
        max_turn: rad, the same.
        history: poses kept.
        max_ahead: seconds that `pose_at` looks beyond the newest IMU sample.
        stream: limits of plausible IMU samples.
    """

    shift: float = 0.4
    speed: float = 0.1
    turn: float = 0.3
    drift: float = 0.03
    max_shift: float = 0.3
    max_turn: float = 0.3
    history: int = 1024
    max_ahead: float = 0.1
    stream: ImuConfig = field(default_factory=ImuConfig)


class ImuFollower:
    """Integrates the IMU and lets poses correct it; any thread may call."""

    def __init__(self, config: FollowerConfig | None = None) -> None:
        """Wait for a first pose."""
        self._config = config or FollowerConfig()
        self._lock = threading.Lock()
        self._imu = ImuBuffer(self._config.stream)
        self._history = LivePoses(
            self._imu, self._config.history, self._config.max_ahead
        )
        self._state = np.zeros(m.STATE_SIZE)
        self._state[m.ROT] = np.eye(3).ravel()
        self._state[m.GRAVITY] = (0.0, 0.0, -STANDARD_GRAVITY)
        self._stamp_ns: int | None = None

    def add_imu(self, stamp_ns: int, gyro: np.ndarray, accel: np.ndarray) -> None:
        """One reading: (3,) rad/s and (3,) m/s², IMU frame.

        Raises:
            InputError: wrong shape, unit or order.
        """
        with self._lock:
            try:
                self._imu.append(stamp_ns, gyro, accel)
            except ClockJump:
                self._imu.clear()
                self._history.clear()
                self._stamp_ns = None
                self._imu.append(stamp_ns, gyro, accel)
            if self._stamp_ns is not None:
                self._history.follow(stamp_ns)

    def correct(self, stamp_ns: int, position: np.ndarray, quat: np.ndarray) -> None:
        """A pose of the IMU: (3,) metres, world (Z up), and (4,) wxyz."""
        with self._lock:
            if self._stamp_ns is None:
                self._take(position, quat)
            else:
                self._pull(stamp_ns, position, quat)
            self._stamp_ns = stamp_ns
            self._history.restart(stamp_ns, self._state)

    def pose_at(self, stamp_ns: int) -> tuple[np.ndarray, np.ndarray]:
        """Position (3,) and wxyz (4,); the origin before the first pose."""
        with self._lock:
            if not len(self._history):
                return np.zeros(3), np.array(rotations.IDENTITY)
            rot, position = self._history.at(stamp_ns)
        return position, rotations.from_matrix(rot)

    def _take(self, position: np.ndarray, quat: np.ndarray) -> None:
        """Go on from a pose, at rest as far as is known."""
        state = self._state.copy()
        state[m.ROT] = rotations.to_matrix(quat).ravel()
        state[m.POS], state[m.VEL] = position, 0.0
        self._state = state

    def _pull(self, stamp_ns: int, position: np.ndarray, quat: np.ndarray) -> None:
        """Integrate up to the pose and correct by the shares of the error."""
        assert self._stamp_ns is not None
        config = self._config
        times, gyro, accel = self._imu.between(self._stamp_ns, stamp_ns)
        state = coast(self._state, times, gyro, accel).copy()
        rot = state[m.ROT].reshape(3, 3)
        period = max((stamp_ns - self._stamp_ns) * 1e-9, 1e-3)
        shift = position - state[m.POS]
        turn = m.log_rotation(np.ascontiguousarray(rot.T @ rotations.to_matrix(quat)))
        far = np.linalg.norm(shift) > config.max_shift
        if far or np.linalg.norm(turn) > config.max_turn or period > 0.5:
            self._take(position, quat)
            return
        state[m.POS] += config.shift * shift
        state[m.VEL] += config.speed / period * shift
        state[m.GYRO_BIAS] -= config.drift / period * turn
        state[m.ROT] = (rot @ m.exp_rotation(config.turn * turn)).ravel()
        self._state = state
