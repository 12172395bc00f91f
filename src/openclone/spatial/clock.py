"""Time for control loops: monotonic nanoseconds and absolute deadlines."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Protocol

SPIN_NS = 150_000
"""The operating system may wake a sleeper this late, so the last bit is spun."""


class Clock(Protocol):
    """A clock that can be waited on."""

    def now_ns(self) -> int:
        """Nanoseconds from an arbitrary origin; never goes back."""
        ...

    def sleep_until(self, deadline_ns: int) -> None:
        """Return at ``deadline_ns``, or at once if it has passed."""
        ...


class MonotonicClock:
    """Real time."""

    def __init__(self, spin_ns: int = SPIN_NS) -> None:
        """Spin for the last ``spin_ns``; 0 for threads that may be a little late."""
        self._spin_ns = spin_ns

    def now_ns(self) -> int:
        """Nanoseconds of the system's monotonic clock."""
        return time.monotonic_ns()

    def sleep_until(self, deadline_ns: int) -> None:
        """Sleep, then spin for the last fraction of a millisecond."""
        remaining = deadline_ns - time.monotonic_ns() - self._spin_ns
        if remaining > 0:
            time.sleep(remaining * 1e-9)
        while time.monotonic_ns() < deadline_ns:
            pass


class ManualClock:
    """Time that passes only when told: for tests and faster-than-real-time runs."""

    def __init__(self, start_ns: int = 0) -> None:
        """Start at ``start_ns``."""
        self._now_ns = start_ns

    def now_ns(self) -> int:
        """The time set last."""
        return self._now_ns

    def sleep_until(self, deadline_ns: int) -> None:
        """Jump to ``deadline_ns``; never back."""
        self._now_ns = max(self._now_ns, deadline_ns)

    def advance(self, duration_ns: int) -> None:
        """Let ``duration_ns`` pass."""
        self._now_ns += duration_ns


@dataclass(frozen=True)
class Wake:
    """One wake-up of a `Ticker`.

    Attributes:
        index: number of wake-ups before this one.
        deadline_ns: when it should have happened.
        now_ns: when it happened.
    """

    index: int
    deadline_ns: int
    now_ns: int


class Ticker:
    """Wakes a loop at ``start + k * period``, with k whole.

    Deadlines are absolute, so lateness never accumulates. A loop body that takes
    longer than its period misses deadlines: each counts as an overrun, the newest is
    served late, older ones are skipped.
    """

    def __init__(self, clock: Clock, period_ns: int) -> None:
        """The first `wait` returns at once and sets the start."""
        self._clock = clock
        self._period_ns = period_ns
        self._next_ns: int | None = None
        self._index = 0
        self.overruns = 0

    def wait(self) -> Wake:
        """Block until the next deadline."""
        now = self._clock.now_ns()
        if self._next_ns is None:
            self._next_ns = now
        if now > self._next_ns:
            skipped = (now - self._next_ns) // self._period_ns
            self.overruns += skipped + 1
            self._next_ns += skipped * self._period_ns
        deadline = self._next_ns
        self._clock.sleep_until(deadline)
        wake = Wake(self._index, deadline, self._clock.now_ns())
        self._index += 1
        self._next_ns = deadline + self._period_ns
        return wake
