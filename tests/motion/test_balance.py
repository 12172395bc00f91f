"""Balance: the inverted pendulum's own laws."""

from __future__ import annotations

import numpy as np
import pytest

from openclone.motion.balance import GRAVITY, balancing_shift, nearest_inside

FPS = 50.0
HEIGHT = 0.65
SOLE = np.array([[0.1, 0.03], [0.1, -0.03], [-0.06, 0.03], [-0.06, -0.03]])
BOTH = np.stack([SOLE + np.array([0.0, 0.1]), SOLE - np.array([0.0, 0.1])])


def zmp_of(com: np.ndarray) -> np.ndarray:
    """Zero-moment point (T, 2) of a point mass at constant height."""
    acceleration = np.gradient(np.gradient(com[:, :2], axis=0), axis=0) * FPS**2
    return com[:, :2] - HEIGHT / GRAVITY * acceleration


def rest(frames: int, place: tuple[float, float]) -> np.ndarray:
    return np.tile(np.array([*place, HEIGHT]), (frames, 1))


def test_a_balanced_body_is_left_alone() -> None:
    com = rest(100, (0.02, 0.01))
    corners = np.tile(BOTH, (100, 1, 1, 1))
    shift = balancing_shift(com, corners, np.ones((100, 2), bool), FPS, 0.15)
    assert np.abs(shift).max() < 1e-9


def test_standing_on_one_foot_the_body_goes_above_it() -> None:
    com = rest(200, (0.02, 0.0))
    contact = np.ones((200, 2), bool)
    contact[60:140, 1] = False
    corners = np.tile(BOTH, (200, 1, 1, 1))
    shift = balancing_shift(com, corners, contact, FPS, 1.0)
    # The left sole begins at y = 0.07; the carrying part of it a little further in.
    assert 0.07 < shift[100, 1] < 0.1
    assert np.abs(shift[:, 0]).max() < 1e-9
    # Zero long before and after: time constant sqrt(z / g) = 0.26 s.
    assert abs(shift[0, 1]) < 0.002
    assert abs(shift[-1, 1]) < 0.002


def test_swaying_over_alternating_feet_needs_the_pressure_under_them() -> None:
    time = np.arange(300) / FPS
    com = np.stack((0.0 * time, 0.02 * np.sin(np.pi * time), 0 * time + HEIGHT), 1)
    contact = np.stack((np.sin(np.pi * time) > -0.1, np.sin(np.pi * time) < 0.1), 1)
    corners = np.tile(BOTH, (300, 1, 1, 1))
    shift = balancing_shift(com, corners, contact, FPS, 1.0)
    middle = slice(75, -75)

    def outside(path: np.ndarray) -> np.ndarray:
        zmp = zmp_of(path)
        left = contact[:, 0] & ~contact[:, 1]
        return np.maximum(0.07 - np.where(left, zmp[:, 1], -zmp[:, 1]), 0.0)[middle][
            contact[middle].sum(1) == 1
        ]

    assert outside(com).mean() > 0.02
    assert outside(com + np.pad(shift, ((0, 0), (0, 1)))).mean() < 0.005


def test_flight_keeps_its_speed() -> None:
    time = np.arange(150) / FPS
    com = np.stack((0.0 * time, 0.03 * np.sin(2 * np.pi * time), 0 * time + HEIGHT), 1)
    contact = np.ones((150, 2), bool)
    contact[70:85] = False
    corners = np.tile(BOTH, (150, 1, 1, 1))
    shift = balancing_shift(com, corners, contact, FPS, 1.0)
    path = com[:, :2] + shift
    acceleration = np.gradient(np.gradient(path, axis=0), axis=0)[73:82] * FPS**2
    before = np.gradient(np.gradient(com[:, :2], axis=0), axis=0)[73:82] * FPS**2
    assert np.abs(before).max() > 0.8
    assert np.abs(acceleration).max() < 0.1


def test_shifts_are_bounded() -> None:
    corners = np.tile(BOTH, (100, 1, 1, 1))
    far = balancing_shift(
        rest(100, (0.0, 2.0)), corners, np.ones((100, 2), bool), FPS, 0.15
    )
    assert 0.14 < np.linalg.norm(far, axis=1).max() <= 0.15


@pytest.mark.parametrize(
    ("point", "nearest"),
    [((0.0, 0.0), (0.0, 0.0)), ((0.2, 0.0), (0.1, 0.0)), ((0.2, 0.2), (0.1, 0.03))],
)
def test_nearest_inside(
    point: tuple[float, float], nearest: tuple[float, float]
) -> None:
    assert nearest_inside(np.array(point), SOLE) == pytest.approx(nearest)
