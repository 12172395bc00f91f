"""The IMU in the Mid-360's housing: rotation rate and specific force at 200 Hz.

The ideal reading is taken from how the housing really moved between physics steps, as
an integrating sensor would: added up, the samples give back the motion. On top come
bias, random walk, noise, and the ringing of the structure after each footfall, which a
model of rigid links does not have.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np

from openclone.spatial import rotations

GRAVITY = 9.81
IMU_IN_LIDAR = (0.011, 0.02329, -0.04412)
"""Metres; the IMU in the LiDAR's frame, whose axes it shares (Livox)."""


@dataclass(frozen=True)
class ShockConfig:
    """How a footfall makes the head ring.

    Attributes:
        hertz: of the ringing, a limb's structural mode.
        damping: ratio.
        threshold: N; a smaller rise of the contact force within one step is no impact.
        speed_per_newton: m/s that the housing is kicked per newton of rise.
        spin_per_newton: rad/s per newton, likewise.
    """

    hertz: float = 35.0
    damping: float = 0.12
    threshold: float = 40.0
    speed_per_newton: float = 1.2e-4
    spin_per_newton: float = 3.0e-4


@dataclass(frozen=True)
class ImuConfig:
    """Errors of the IMU, the size of a consumer part's (TDK ICM-40609-D and kin).

    Attributes:
        gyro_sigma: rad/s, white noise of one sample.
        accel_sigma: m/s², likewise.
        gyro_bias: rad/s, standard deviation of the bias at power-on, per axis.
        accel_bias: m/s², likewise.
        gyro_walk: rad/s per √s, drift of the bias.
        accel_walk: m/s² per √s, likewise.
        shock: ringing after footfalls; None: none.
    """

    gyro_sigma: float = 0.001
    accel_sigma: float = 0.015
    gyro_bias: float = 0.005
    accel_bias: float = 0.05
    gyro_walk: float = 2.0e-5
    accel_walk: float = 3.0e-4
    shock: ShockConfig | None = field(default_factory=ShockConfig)


@dataclass(frozen=True)
class ImuSample:
    """One reading.

    Attributes:
        stamp_ns: when, the sensor's clock.
        gyro: (3,), rad/s, IMU frame.
        accel: (3,), m/s², specific force (at rest: up, 9.81), IMU frame.
    """

    stamp_ns: int
    gyro: np.ndarray
    accel: np.ndarray


def ideal_readings(
    positions_w: np.ndarray, quats: np.ndarray, step_s: float
) -> tuple[np.ndarray, np.ndarray]:
    """Gyroscope and accelerometer at all but the first and last of n poses.

    Args:
        positions_w: (n, 3), metres, of the IMU, ``step_s`` apart.
        quats: (n, 4), wxyz, world from IMU.
        step_s: seconds.

    Returns:
        Rotation rates ``(n - 2, 3)``, rad/s, and specific forces ``(n - 2, 3)``, m/s²,
        IMU frame.
    """
    turn = rotations.multiply(rotations.conjugate(quats[:-2]), quats[2:])
    gyro = rotations.to_rotation_vector(turn) / (2.0 * step_s)
    bend = positions_w[2:] - 2.0 * positions_w[1:-1] + positions_w[:-2]
    force_w = bend / step_s**2 + np.array([0.0, 0.0, GRAVITY])
    return gyro, rotations.rotate_inverse(quats[1:-1], force_w)


class Ringing:
    """Damped oscillators, one per axis, that footfalls kick; they come back to zero."""

    def __init__(self, config: ShockConfig, step_s: float) -> None:
        """At rest; exact solution for steps of ``step_s``."""
        omega = 2.0 * math.pi * config.hertz
        decay, ringing = (
            config.damping * omega,
            omega * math.sqrt(1 - config.damping**2),
        )
        cosine, sine = math.cos(ringing * step_s), math.sin(ringing * step_s) / ringing
        shrink = math.exp(-decay * step_s)
        self._advance = shrink * np.array(
            [[cosine + decay * sine, sine], [-(omega**2) * sine, cosine - decay * sine]]
        )
        self._step_s = step_s
        self._state = np.zeros((2, 6))

    def step(self, kick: np.ndarray) -> np.ndarray:
        """Kick with ``(6,)`` m/s and rad/s, let a step pass.

        Returns:
            (6,): mean acceleration, m/s², and mean rotation rate, rad/s, of the step.
        """
        before = self._state
        self._state = self._advance @ (before + np.stack((0.0 * kick, kick)))
        moved, sped = (self._state - before) / self._step_s
        return np.concatenate((sped[:3], moved[3:]))


class SimulatedImu:
    """Turns poses of the housing and contact forces into readings."""

    def __init__(
        self, config: ImuConfig, step_s: float, rng: np.random.Generator
    ) -> None:
        """Draw the biases; ``step_s`` is the time between poses, 5 ms for 200 Hz."""
        self._config, self._step_s = config, step_s
        # Apart, so that it does not matter how many poses come at once.
        self._rng, self._shock_rng = rng.spawn(2)
        self.gyro_bias = config.gyro_bias * rng.standard_normal(3)
        self.accel_bias = config.accel_bias * rng.standard_normal(3)
        self._ringing = Ringing(config.shock, step_s) if config.shock else None
        self._stamps = np.zeros(0, dtype=np.int64)
        self._positions, self._quats = np.zeros((0, 3)), np.zeros((0, 4))
        self._force: np.ndarray | None = None

    def update(
        self,
        stamps_ns: np.ndarray,
        positions_w: np.ndarray,
        quats: np.ndarray,
        forces: np.ndarray,
    ) -> list[ImuSample]:
        """Take the newest poses; returns the readings of the poses before each.

        Args:
            stamps_ns: (n,), of the poses.
            positions_w: (n, 3), metres, of the IMU.
            quats: (n, 4), wxyz, world from IMU.
            forces: (n, 2), N, normal force on each foot.
        """
        shake = np.array([self._shake(force) for force in forces]).reshape(-1, 6)
        stamps = np.concatenate((self._stamps, stamps_ns))
        positions = np.concatenate((self._positions, positions_w))
        quats = np.concatenate((self._quats, quats))
        self._stamps, self._positions = stamps[-2:], positions[-2:]
        self._quats = quats[-2:]
        count = len(stamps) - 2
        if count < 1:
            return []
        gyro, accel = ideal_readings(positions, quats, self._step_s)
        config, draw = self._config, self._rng.standard_normal((count, 4, 3))
        walk = math.sqrt(self._step_s) * np.cumsum(draw[:, :2], axis=0)
        gyro_bias = self.gyro_bias + config.gyro_walk * walk[:, 0]
        accel_bias = self.accel_bias + config.accel_walk * walk[:, 1]
        self.gyro_bias, self.accel_bias = gyro_bias[-1], accel_bias[-1]
        shake = shake[-count:]
        gyro += gyro_bias + config.gyro_sigma * draw[:, 2] + shake[:, 3:]
        accel += accel_bias + config.accel_sigma * draw[:, 3] + shake[:, :3]
        rows = zip(stamps[1:-1].tolist(), gyro, accel, strict=True)
        return [ImuSample(*row) for row in rows]

    def _shake(self, force: np.ndarray) -> np.ndarray:
        """Ringing (6,) after the contact forces rose to ``force (2,)``."""
        before, self._force = self._force, force
        shock = self._config.shock
        if self._ringing is None or shock is None:
            return np.zeros(6)
        rises = force - before if before is not None else np.zeros(2)
        rise = float(rises[rises > shock.threshold].sum())
        if rise == 0.0:
            return self._ringing.step(np.zeros(6))
        # Mostly along the body, which is the housing's z axis; the rest as it comes.
        draw = self._shock_rng.standard_normal(6)
        way = np.array([0.0, 0.0, 1.0]) + 0.5 * draw[:3]
        kick = (shock.speed_per_newton * way, shock.spin_per_newton * draw[3:])
        return self._ringing.step(rise * np.concatenate(kick))
