"""Watches the stream of scan reports and decides whether the odometry is lost."""

from __future__ import annotations

import numpy as np

from openclone.odometry import manifold as m
from openclone.odometry.health import HealthConfig, LioHealth
from openclone.odometry.scan_report import ScanReport, Verdict

WALK_ACCEL = 5.0
"""m/s², what a walker's head may do unseen."""
WALK_TURN = 8.0
"""rad/s², the same for turning."""


class Watch:
    """Counters and the newest report of one odometry."""

    def __init__(self, config: HealthConfig) -> None:
        """Nothing has happened yet."""
        self._config = config
        self.refused = self.restarts = 0
        self._scans = self._skipped = self._dropped_points = 0
        self._begin()

    def _begin(self) -> None:
        self.clock_offset_ns = 0
        self.scan_ns: int | None = None
        self._used_ns: int | None = None
        self._report: ScanReport | None = None
        self._reason = "waiting for data"
        self._doubts = 0

    def restart(self) -> None:
        """The sensor's clock jumped: the odometry starts anew."""
        self.restarts += 1
        self._begin()
        self._reason = "restarted: the clock jumped"

    def wait(self, stamp_ns: int, reason: str) -> None:
        """A scan came, but the odometry has not started."""
        self.scan_ns, self._used_ns = stamp_ns, None
        self._reason = reason

    def take(self, stamp_ns: int, report: ScanReport) -> None:
        """The filter has worked on a scan."""
        config = self._config
        self.scan_ns, self._report = stamp_ns, report
        self._dropped_points += report.rejected
        used = report.verdict in (Verdict.GOOD, Verdict.DOUBTFUL)
        self._scans += int(used)
        self._skipped += int(not used)
        if used:
            self._used_ns = stamp_ns
        if report.verdict is Verdict.BLIND:
            return
        doubt = ""
        first = report.matches == 0 and report.verdict is Verdict.GOOD
        if report.verdict is Verdict.UNMATCHED:
            doubt = "the scan does not fit the map"
        elif not first and report.agreement < config.min_agreement:
            doubt = f"only {report.agreement:.0%} of the points lie on their planes"
        elif report.residual > config.max_residual:
            doubt = f"points lie {report.residual * 100:.1f} cm off their planes"
        elif report.surprise > config.max_surprise:
            doubt = f"IMU and LiDAR disagree by {report.surprise:.0f} sigma"
        elif not report.agrees:
            doubt = (
                f"LiDAR and IMU turn differently by {report.mismatch * 1e3:.0f} mrad"
            )
        if doubt:
            self._doubts, self._reason = config.recovery_scans, doubt
        else:
            self._doubts = max(0, self._doubts - 1)

    def clocks_differ(self, step_ns: int, *, upset: bool) -> None:
        """The LiDAR's stamps, the past ones too, are corrected by ``step_ns``.

        ``upset``: so much that the poses so far are not to be trusted.
        """
        if upset:
            late = f"{step_ns * 1e-6:.0f} ms"
            self._doubts = self._config.recovery_scans
            self._reason = f"the clocks of LiDAR and IMU differ by {late}"
        self.clock_offset_ns += step_ns
        if self.scan_ns is not None:
            self.scan_ns += step_ns
        if self._used_ns is not None:
            self._used_ns += step_ns

    def health(
        self,
        now_ns: int,
        blind: float,
        pose_ns: int | None,
        covariance: np.ndarray | None,
        imu_gaps: int,
        map_cells: int,
    ) -> LioHealth:
        """Health at ``now_ns``.

        Args:
            now_ns: nanoseconds.
            blind: seconds, longest time without IMU sample since the covariance.
            pose_ns: stamp of the newest pose.
            covariance: (23, 23), of the filter at the newest scan used.
            imu_gaps: pauses so far.
            map_cells: size of the map.
        """
        report = self._report
        scan_age = now_ns - self._used_ns if self._used_ns is not None else 0
        pose, sigma, turn = None, np.inf, np.inf
        if covariance is not None and np.isfinite(covariance).all():
            pose = covariance[:6, :6].copy()
            sigma, turn = self._sigmas(covariance, scan_age * 1e-9, blind)
        reason = self._why_lost(scan_age * 1e-9, blind, sigma, turn)
        open_sigma = report.weakest_sigma if report else np.inf
        return LioHealth(
            tracking=not reason,
            age_ns=now_ns - pose_ns if pose_ns is not None else 0,
            reason=reason,
            scan_age_ns=scan_age,
            residual=report.residual if report else 0.0,
            matches=report.matches if report else 0,
            agreement=report.agreement if report else 0.0,
            surprise=report.surprise if report else 0.0,
            position_sigma=sigma,
            turn_sigma=turn,
            covariance=pose,
            degenerate=open_sigma > self._config.degenerate_sigma,
            weakest_direction=report.weakest_direction if report else None,
            scans=self._scans,
            skipped_scans=self._skipped,
            refused=self.refused,
            dropped_points=self._dropped_points,
            imu_gaps=imu_gaps,
            restarts=self.restarts,
            clock_offset_ns=self.clock_offset_ns,
            map_cells=map_cells,
        )

    @staticmethod
    def _sigmas(
        covariance: np.ndarray, scan_age: float, blind: float
    ) -> tuple[float, float]:
        """Standard deviations in metres and rad, grown since the newest scan.

        Without IMU samples the motion is unknown by a walker's accelerations.
        """
        ahead = max(scan_age, 0.0)
        moved = covariance[m.E_POS, m.E_POS] + covariance[m.E_VEL, m.E_VEL] * ahead**2
        position = np.sqrt(np.linalg.eigvalsh(moved)[-1])
        turn = np.sqrt(np.linalg.eigvalsh(covariance[m.E_ROT, m.E_ROT])[-1])
        return (
            float(position + 0.5 * WALK_ACCEL * blind**2),
            float(turn + 0.5 * WALK_TURN * blind**2),
        )

    def _why_lost(
        self, scan_age: float, blind: float, sigma: float, turn: float
    ) -> str:
        config = self._config
        if self._used_ns is None:
            return self._reason
        if scan_age > config.max_scan_age:
            return f"no usable scan for {scan_age:.2f} s"
        if blind > config.max_imu_age:
            return f"no IMU sample for {blind:.2f} s"
        if self._doubts:
            return self._reason
        if not sigma <= config.max_position_sigma:
            return f"position uncertain by {sigma * 100:.0f} cm"
        if not turn <= config.max_turn_sigma:
            return f"rotation uncertain by {turn:.3f} rad"
        return ""
