"""Whether FAST-LIO2's pose may be trusted, and why not."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from openclone.odometry.protocol import OdometryHealth


@dataclass(frozen=True)
class HealthConfig:
    """Limits beyond which the odometry calls itself lost.

    Attributes:
        max_scan_age: seconds since the newest scan that was used.
        max_imu_age: seconds without IMU sample since the newest scan.
        max_position_sigma: metres.
        max_turn_sigma: rad.
        min_agreement: share of the planes found that the points must lie on.
        max_residual: metres, root mean square of the matches.
        max_surprise: correction of a scan in predicted standard deviations.
        degenerate_sigma: metres; a scan that alone knows the position worse than
            this in some direction is degenerate (a corridor). This alone does not
            end tracking: the covariance tells what it costs.
        recovery_scans: good scans in a row that end a doubtful time.
    """

    max_scan_age: float = 0.3
    max_imu_age: float = 0.1
    max_position_sigma: float = 0.05
    max_turn_sigma: float = 0.02
    min_agreement: float = 0.7
    max_residual: float = 0.04
    max_surprise: float = 6.0
    degenerate_sigma: float = 0.05
    recovery_scans: int = 3


@dataclass(frozen=True)
class LioHealth(OdometryHealth):
    """State of the odometry.

    Attributes:
        reason: why ``tracking`` is False; empty while tracking.
        scan_age_ns: time since the end of the newest scan that was used.
        residual: metres, root mean square distance of the matches to their planes.
        matches: points of the newest scan that were matched.
        agreement: share of the planes found that the points lie on.
        surprise: correction by the newest scan in predicted standard deviations.
        position_sigma: metres, standard deviation along the worst direction.
        turn_sigma: rad, the same of the rotation.
        covariance: (6, 6), rotation (rad, IMU frame) and position (metres, world).
        degenerate: whether the newest scan leaves a direction open.
        weakest_direction: (3,), world, the direction known least.
        scans: scans used.
        skipped_scans: scans that were blind or did not fit.
        refused: samples and scans that raised an error.
        dropped_points: points with NaN or infinite coordinates.
        imu_gaps: pauses of the IMU above 50 ms.
        restarts: new starts after a jump of the clock.
        clock_offset_ns: what is added to the LiDAR's stamps to get those of the IMU.
        map_cells: size of the map.
    """

    reason: str = ""
    scan_age_ns: int = 0
    residual: float = 0.0
    matches: int = 0
    agreement: float = 0.0
    surprise: float = 0.0
    position_sigma: float = np.inf
    turn_sigma: float = np.inf
    covariance: np.ndarray | None = None
    degenerate: bool = False
    weakest_direction: np.ndarray | None = None
    scans: int = 0
    skipped_scans: int = 0
    refused: int = 0
    dropped_points: int = 0
    imu_gaps: int = 0
    restarts: int = 0
    clock_offset_ns: int = 0
    map_cells: int = 0
