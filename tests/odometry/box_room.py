"""A room of boxes with exact answers: rays against boxes, IMU from analytic motion."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from openclone.spatial import rotations

GRAVITY = np.array((0.0, 0.0, -9.80665))
IMU_FROM_LIDAR = np.array((-0.011, -0.02329, 0.04412))
STILL = 1.2
"""Seconds without motion at the start of every path."""


def ramp(t: np.ndarray) -> np.ndarray:
    """0 while still, 1 two seconds later, three times differentiable."""
    s = np.clip((np.asarray(t, dtype=float) - STILL) / 2.0, 0.0, 1.0)
    return s**4 * (35 - 84 * s + 70 * s**2 - 20 * s**3)


@dataclass(frozen=True)
class Motion:
    """World position ``(n, 3)`` and yaw-pitch-roll ``(n, 3)`` of the IMU at times."""

    position: Callable[[np.ndarray], np.ndarray]
    angles: Callable[[np.ndarray], np.ndarray]

    def quat(self, t: np.ndarray) -> np.ndarray:
        return rotations.from_euler(self.angles(t), "ZYX")

    def acceleration(self, t: np.ndarray, h: float = 1e-3) -> np.ndarray:
        p = self.position
        return (
            -p(t + 2 * h) + 16 * p(t + h) - 30 * p(t) + 16 * p(t - h) - p(t - 2 * h)
        ) / (12 * h * h)

    def velocity(self, t: np.ndarray, h: float = 1e-3) -> np.ndarray:
        p = self.position
        return (8 * (p(t + h) - p(t - h)) - (p(t + 2 * h) - p(t - 2 * h))) / (12 * h)

    def rate(self, t: np.ndarray, h: float = 1e-4) -> np.ndarray:
        turn = rotations.multiply(
            rotations.conjugate(self.quat(t - h)), self.quat(t + h)
        )
        return rotations.to_rotation_vector(turn) / (2 * h)


def walking(radius: float = 1.5, turn_rate: float = 0.4) -> Motion:
    """A walk around a circle with bob, sway and a looking-around head."""

    def position(t: np.ndarray) -> np.ndarray:
        t, k = np.asarray(t, dtype=float), ramp(t)
        phase = turn_rate * (t - STILL) * k
        return np.stack(
            (
                radius * np.sin(phase),
                radius * (1 - np.cos(phase)) + 0.02 * k * np.sin(2 * np.pi * 0.9 * t),
                0.02 * k * np.sin(2 * np.pi * 1.8 * t),
            ),
            -1,
        )

    def angles(t: np.ndarray) -> np.ndarray:
        t, k = np.asarray(t, dtype=float), ramp(t)
        phase = turn_rate * (t - STILL) * k
        return np.stack(
            (
                phase + 0.2 * k * np.sin(0.7 * t),
                0.06 * k * np.sin(2 * np.pi * 1.8 * t),
                0.05 * k * np.sin(2 * np.pi * 0.9 * t + 1.0),
            ),
            -1,
        )

    return Motion(position, angles)


def spinning(rate: float = 2.0) -> Motion:
    """A turn on the spot at ``rate`` rad/s once the ramp is over."""

    def position(t: np.ndarray) -> np.ndarray:
        t, k = np.asarray(t, dtype=float), ramp(t)
        return np.stack((0.1 * k * np.sin(t), 0.1 * k * np.sin(1.3 * t), 0 * t), -1)

    def angles(t: np.ndarray) -> np.ndarray:
        t, k = np.asarray(t, dtype=float), ramp(t)
        return np.stack((rate * (t - STILL) * k, 0.05 * k * np.sin(3 * t), 0 * t), -1)

    return Motion(position, angles)


@dataclass(frozen=True)
class Room:
    """The inside of a box and solid boxes in it: rows of lower and upper corner."""

    walls: np.ndarray
    solids: np.ndarray

    def ranges(self, origins: np.ndarray, directions: np.ndarray) -> np.ndarray:
        """Distance ``(n,)`` to the first surface along unit directions."""
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = 1.0 / directions
            low = (self.walls[0] - origins) * inverse
            high = (self.walls[1] - origins) * inverse
            best = np.maximum(low, high).min(axis=1)
            for lower, upper in self.solids:
                a, b = (lower - origins) * inverse, (upper - origins) * inverse
                enter = np.minimum(a, b).max(axis=1)
                leave = np.maximum(a, b).min(axis=1)
                hit = (enter < leave) & (enter > 0.0)
                best = np.where(hit, np.minimum(best, enter), best)
        return best


def furnished() -> Room:
    """8 x 7 x 3 m around the start at 1.3 m height, with furniture and a recess."""
    solids = [
        ((2.5, -2.0, -1.3), (3.3, -0.5, -0.5)),
        ((-3.0, 2.6, -1.3), (-1.5, 3.5, 0.7)),
        ((1.0, 3.0, -1.3), (2.2, 3.5, 0.1)),
        ((-3.5, -1.5, -1.3), (-2.9, 0.5, 0.5)),
        ((3.5, 2.0, -1.3), (4.5, 3.5, 1.7)),
        ((-0.5, -3.5, 0.3), (0.8, -3.1, 1.0)),
        ((-1.0, 1.6, 1.4), (1.0, 2.4, 1.7)),
    ]
    walls = np.array(((-3.5, -3.53, -1.3), (4.47, 3.5, 1.7)))
    return Room(walls, np.array(solids))


def empty_room(half: float = 3.0) -> Room:
    """A cube without furniture, sensor in the middle."""
    return Room(np.array(((-half,) * 3, (half,) * 3)), np.zeros((0, 2, 3)))


@dataclass(frozen=True)
class Sensors:
    """Errors of the sensors; deviations are per sample."""

    range_sigma: float = 0.02
    no_return: float = 0.1
    gyro_sigma: float = 0.005
    accel_sigma: float = 0.05
    gyro_bias: np.ndarray = field(
        default_factory=lambda: np.array((0.01, -0.008, 0.005))
    )
    accel_bias: np.ndarray = field(
        default_factory=lambda: np.array((0.03, -0.04, 0.05))
    )
    points: int = 20_000
    imu_hz: int = 200
    inverted: bool = False


@dataclass
class World:
    """A sensor on its path through a room, with exact poses."""

    motion: Motion
    room: Room
    sensors: Sensors
    rng: np.random.Generator

    def pose(self, t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Position and quaternion of the IMU."""
        quat = self.motion.quat(t)
        if self.sensors.inverted:
            quat = rotations.multiply(quat, np.array((0.0, 1.0, 0.0, 0.0)))
        return self.motion.position(t), quat

    def imu(self, time: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Gyro and accelerometer samples ``(n, 3)``."""
        s = self.sensors
        rate = self.motion.rate(time)
        force = self.motion.acceleration(time) - GRAVITY
        felt = rotations.rotate_inverse(self.pose(time)[1], force)
        if s.inverted:
            rate = rate * np.array((1.0, -1.0, -1.0))
        noise = self.rng.standard_normal((2, *rate.shape))
        gyro = rate + s.gyro_bias + s.gyro_sigma * noise[0]
        return gyro, felt + s.accel_bias + s.accel_sigma * noise[1]

    def scan(self, start: float, period: float = 0.1) -> tuple[np.ndarray, np.ndarray]:
        """Points ``(n, 3)`` in the LiDAR frame and their stamps, in 1 ms steps."""
        s, count = self.sensors, self.sensors.points
        steps = np.arange(count) * 100 // count
        times = start + period * (np.arange(100) + 1) / 100
        azimuth = self.rng.uniform(-np.pi, np.pi, count)
        elevation = np.deg2rad(self.rng.uniform(-7.0, 52.0, count))
        rays = np.stack(
            (
                np.cos(elevation) * np.cos(azimuth),
                np.cos(elevation) * np.sin(azimuth),
                np.sin(elevation),
            ),
            -1,
        )
        position, quat = self.pose(times)
        origin = position + rotations.rotate(quat, IMU_FROM_LIDAR)
        matrix = rotations.to_matrix(quat)[steps]
        directions = np.einsum("nij,nj->ni", matrix, rays)
        ranges = self.room.ranges(origin[steps], directions)
        ranges = ranges + s.range_sigma * self.rng.standard_normal(count)
        ranges[self.rng.random(count) < s.no_return] = 0.0
        stamps = np.rint(times[steps] * 1e9).astype(np.int64)
        return rays * ranges[:, None], stamps


@dataclass(frozen=True)
class Event:
    """One message: an IMU sample or a scan, at the time it is complete."""

    time: float
    gyro: np.ndarray | None = None
    accel: np.ndarray | None = None
    points: np.ndarray | None = None
    stamps: np.ndarray | None = None


def stream(world: World, seconds: float, begin: float = 0.0) -> list[Event]:
    """All messages of a run, in order; the IMU comes first where both are due."""
    events = []
    times = begin + np.arange(round(seconds * world.sensors.imu_hz) + 1) / (
        world.sensors.imu_hz
    )
    gyro, accel = world.imu(times)
    for k, t in enumerate(times.tolist()):
        events.append(Event(t, gyro=gyro[k], accel=accel[k]))
        if k and k * 10 % world.sensors.imu_hz == 0:
            points, stamps = world.scan(t - 0.1)
            events.append(Event(t, points=points, stamps=stamps))
    return events
