"""What the loop needs from any robot."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from openclone.simulation.robot import RobotReading


@dataclass(frozen=True)
class Truth:
    """What only a simulation knows.

    Attributes:
        qpos: (36,), qvel: (35,), MuJoCo coordinates.
        fallen: whether the robot has fallen.
    """

    qpos: np.ndarray
    qvel: np.ndarray
    fallen: bool


class RobotLink(Protocol):
    """The wire to one robot; no call blocks."""

    def read(self, now_ns: int) -> RobotReading:
        """The newest reading of the robot's sensors."""
        ...

    def write(self, joint_targets: np.ndarray) -> None:
        """Send position targets ``(29,)``, radians."""
        ...

    def damp(self) -> None:
        """Make the joints soft: damping without stiffness."""
        ...

    def truth(self) -> Truth | None:
        """The true state, if the robot is simulated."""
        ...
