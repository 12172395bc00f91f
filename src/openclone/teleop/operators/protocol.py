"""What the loop needs from any operator."""

from __future__ import annotations

from typing import Protocol

from openclone.spatial.clock import Clock
from openclone.teleop.messages import OperatorFrame


class Operator(Protocol):
    """A source of operator frames that never makes the loop wait."""

    def start(self, clock: Clock) -> None:
        """Connect; frames carry receive stamps of ``clock``."""
        ...

    def stop(self) -> None:
        """Disconnect."""
        ...

    def latest(self, now_ns: int) -> OperatorFrame | None:
        """The newest frame, or None before the first."""
        ...

    def finished(self, now_ns: int) -> bool:
        """Whether no more will come; always False for a living operator."""
        ...
