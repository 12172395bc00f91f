"""A track: one planned quantity over time, written as a sum of smooth moves.

People move a hand from rest to rest along the curve of least jerk (Flash and Hogan
1985), and longer movements look like sums of such curves that overlap. A track keeps a
list of moves and is evaluated at all frames at once.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

Shape = Callable[[np.ndarray], np.ndarray]
"""Maps phase 0..1 (before and after: 0 and 1) to a share of the move's amount."""

Amount = np.ndarray | list[float] | float


def minimum_jerk(phase: np.ndarray) -> np.ndarray:
    """From 0 to 1 with zero speed and acceleration at both ends."""
    phase = np.clip(phase, 0.0, 1.0)
    return phase**3 * (10.0 - 15.0 * phase + 6.0 * phase**2)


def there_and_back(phase: np.ndarray) -> np.ndarray:
    """From 0 up to 1 and back to 0, with a short stay on top."""
    return minimum_jerk(phase / 0.48) - minimum_jerk((phase - 0.52) / 0.48)


def raised(phase: np.ndarray) -> np.ndarray:
    """Like `there_and_back` with a longer stay: up and down take 0.42 each."""
    return minimum_jerk(phase / 0.42) - minimum_jerk((phase - 0.58) / 0.42)


def oscillation(cycles: float) -> Shape:
    """A sine of ``cycles`` periods that swells and fades."""

    def shape(phase: np.ndarray) -> np.ndarray:
        window = minimum_jerk(phase * 4.0) - minimum_jerk((phase - 0.75) * 4.0)
        return window * np.sin(2.0 * np.pi * cycles * phase)

    return shape


class Track:
    """A vector over time: a start value plus moves."""

    def __init__(self, start: np.ndarray | list[float]) -> None:
        """Rest at ``start (n,)``."""
        self._start = np.asarray(start, dtype=float)
        self._moves: list[tuple[float, float, np.ndarray, Shape]] = []
        self.end = self._start.copy()
        """(n,) value after all moves so far."""

    def add(self, start_s: float, end_s: float, amount: Amount, shape: Shape) -> None:
        """Add ``amount * shape(phase)``, the phase running from start to end."""
        delta = np.broadcast_to(np.asarray(amount, dtype=float), self._start.shape)
        self._moves.append((start_s, end_s, delta, shape))
        self.end = self.end + delta * shape(np.array(1.0))

    def move(self, start_s: float, end_s: float, target: Amount) -> None:
        """Go to ``target (n,)`` along the curve of least jerk."""
        self.add(start_s, end_s, np.asarray(target) - self.end, minimum_jerk)

    def bump(self, start_s: float, end_s: float, amount: Amount) -> None:
        """Go away by ``amount (n,)`` and come back."""
        self.add(start_s, end_s, amount, there_and_back)

    def at(self, time_s: np.ndarray) -> np.ndarray:
        """Values ``(T, n)`` at ``time_s (T,)``."""
        values = np.tile(self._start, (len(time_s), 1))
        for start_s, end_s, delta, shape in self._moves:
            phase = np.clip((time_s - start_s) / (end_s - start_s), 0.0, 1.0)
            values += shape(phase)[:, None] * delta
        return values
