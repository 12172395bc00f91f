"""What the filter made of one scan."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from openclone.odometry.clock_offset import LidarTurn


class Verdict(Enum):
    """What became of a scan."""

    GOOD = "good"
    DOUBTFUL = "used, but not mapped: it fits badly"
    UNMATCHED = "not used: it does not fit the map"
    BLIND = "not used: too few returns"


@dataclass(frozen=True)
class ScanReport:
    """What the filter made of a scan.

    Attributes:
        verdict: whether it was used.
        returns: points within range.
        matches: points matched to planes of the map.
        agreement: share of the planes found that the points lie on.
        residual: metres, root mean square of the matches.
        surprise: size of the correction in predicted standard deviations.
        weakest_sigma: metres, what the scan alone knows of the position along the
            direction it knows least.
        weakest_direction: (3,), world, unit.
        weakest_turn: rad, the same of the rotation.
        rejected: points with NaN or infinite coordinates.
        mismatch: rad, root mean square difference of what LiDAR and IMU say about the
            rotations between the newest scans.
        agrees: whether it is small.
        turn: how LiDAR alone sees the sensor turned, if the scan is good.
    """

    verdict: Verdict
    returns: int
    matches: int = 0
    agreement: float = 0.0
    residual: float = 0.0
    surprise: float = 0.0
    weakest_sigma: float = np.inf
    weakest_direction: np.ndarray = field(default_factory=lambda: np.zeros(3))
    weakest_turn: float = np.inf
    rejected: int = 0
    mismatch: float = 0.0
    agrees: bool = True
    turn: LidarTurn | None = None
