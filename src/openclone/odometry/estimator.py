"""One scan through FAST-LIO2: propagate, undistort, match, update, map.

Single-threaded and without any idea of streams; `fast_lio` feeds it.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field, replace

import numpy as np

from openclone.odometry import manifold as m
from openclone.odometry.clock_offset import LidarTurn
from openclone.odometry.filter import (
    ImuNoise,
    apply_step,
    gauss_newton_step,
    propagate,
)
from openclone.odometry.matching import OUTLIER, Evidence, MatchConfig, Matcher
from openclone.odometry.scan import Scan, ScanConfig, Thinned, prepare
from openclone.odometry.scan_report import ScanReport, Verdict
from openclone.odometry.voxel_map import MapConfig, VoxelMap

DISTRUST, DISTRUST_ARM_M = 2.0, 0.3
"""Deviation of a doubtful prediction over the mismatch; metres for its position."""
UPSET = (0.05, 0.02, 1.0)
"""Deviations in rad, metres and m/s of a state that wrong stamps led to."""
MISFIT = 0.05
"""rad, mismatch that a scan stands for which does not fit the map well."""
UNDISTORTIONS = 2
"""Times that a scan is undistorted anew while the velocity is in doubt."""
MISMATCH_SCANS = 3
"""Scans over which disagreement about the rotation is averaged."""


@dataclass(frozen=True)
class UpdateConfig:
    """The iterated update and when its result is believed.

    Attributes:
        iterations: at most as many steps.
        doubtful_iterations: the same while LiDAR and IMU disagree.
        done_turn: rad, a smaller step ends the iterations.
        done_shift: metres, the same.
        search_shift: metres; after a greater step the planes are searched again.
        min_returns: returns below which a scan counts as blind.
        min_matches: matches below which a scan is not used.
        min_agreement: share of matches among planes below which it is not used.
        good_agreement: the same, below which it is not mapped.
        max_surprise: correction in standard deviations above which it is not mapped.
        settle: scans that must agree with the IMU again before they are mapped.
        max_unmapped: scans after which they are mapped all the same: the odometry
            must not lose its way in new places because one sensor is poor.
        max_mismatch: rad between the turns of LiDAR and IMU from scan to scan, above
            which one of them is wrong: then the IMU is trusted less.
    """

    iterations: int = 4
    doubtful_iterations: int = 12
    done_turn: float = 1e-4
    done_shift: float = 3e-4
    search_shift: float = 0.01
    min_returns: int = 100
    min_matches: int = 60
    min_agreement: float = 0.3
    good_agreement: float = 0.7
    max_surprise: float = 8.0
    settle: int = 3
    max_unmapped: int = 20
    max_mismatch: float = 0.005


@dataclass(frozen=True)
class EstimatorConfig:
    """Everything between an IMU interval with a scan and a new state."""

    imu: ImuNoise = field(default_factory=ImuNoise)
    scan: ScanConfig = field(default_factory=ScanConfig)
    match: MatchConfig = field(default_factory=MatchConfig)
    map: MapConfig = field(default_factory=MapConfig)
    update: UpdateConfig = field(default_factory=UpdateConfig)


@dataclass(frozen=True)
class Interval:
    """The IMU between the filter's time and the end of a scan.

    Attributes:
        start_ns: the filter's time.
        times: (n,), seconds after ``start_ns``.
        gyro: (n, 3), rad/s.
        accel: (n, 3), m/s².
        up: (3,), the world's up in the IMU frame at the end, if a second IMU tells.
        up_sigma: rad, its standard deviation.
    """

    start_ns: int
    times: np.ndarray
    gyro: np.ndarray
    accel: np.ndarray
    up: np.ndarray | None = None
    up_sigma: float = 0.0


def weakest(information: np.ndarray) -> tuple[float, np.ndarray, float]:
    """What a scan alone knows least: metres, direction ``(3,)``, radians.

    Args:
        information: (23, 23), H'R⁻¹H; rotation and position are used.
    """
    ridge = 1e-6 * np.eye(3)
    rot, pos = information[:3, :3] + ridge, information[3:6, 3:6] + ridge
    mixed = information[:3, 3:6]
    values, vectors = np.linalg.eigh(pos - mixed.T @ np.linalg.solve(rot, mixed))
    turns = np.linalg.eigvalsh(rot - mixed @ np.linalg.solve(pos, mixed.T))
    shift_sigma = float(1.0 / np.sqrt(max(values[0], 1e-12)))
    turn_sigma = float(1.0 / np.sqrt(max(turns[0], 1e-12)))
    return shift_sigma, vectors[:, 0], turn_sigma


def lidar_turn(evidence: Evidence) -> np.ndarray:
    """Rotation ``(3,)`` to the best fit of the scan alone, without any prior."""
    information = evidence.information[:6, :6] + np.diag((1.0,) * 3 + (1e2,) * 3)
    return -np.linalg.solve(information, evidence.gradient[:6])[:3]


def turn_since(interval: Interval, stamp_ns: int, bias: np.ndarray) -> np.ndarray:
    """Rotation ``(3, 3)`` from a stamp to the interval's end, by the gyroscope."""
    begin = (stamp_ns - interval.start_ns) * 1e-9
    rot, times = np.eye(3), interval.times
    for k in range(len(times) - 1):
        period = times[k + 1] - max(times[k], begin)
        if period > 0.0:
            rate = 0.5 * (interval.gyro[k] + interval.gyro[k + 1]) - bias
            rot = rot @ m.exp_rotation(rate * period)
    return rot


def faster(path: np.ndarray, velocity: np.ndarray) -> np.ndarray:
    """A ``path (n, 22)`` to the same end with ``velocity (3,)`` added, m/s, world."""
    out = path.copy()
    out[:, 10:13] += velocity * (path[:, :1] - path[-1, 0])
    out[:, 13:16] += velocity
    return out


def tilt_evidence(
    state: np.ndarray, up: np.ndarray, sigma: float
) -> tuple[np.ndarray, np.ndarray]:
    """H'R⁻¹H and H'R⁻¹z of a second IMU's up ``(3,)``: anchors roll and pitch."""
    seen = state[m.ROT].reshape(3, 3)[2]
    jacobian = m.skew(seen)
    information, gradient = np.zeros((m.ERROR_SIZE,) * 2), np.zeros(m.ERROR_SIZE)
    information[:3, :3] = jacobian.T @ jacobian / sigma**2
    gradient[:3] = jacobian.T @ (seen - up) / sigma**2
    return information, gradient


class Estimator:
    """State, covariance and map at the end of the newest scan."""

    def __init__(
        self,
        config: EstimatorConfig,
        stamp_ns: int,
        state: np.ndarray,
        covariance: np.ndarray,
        world: VoxelMap,
    ) -> None:
        """Begin at ``stamp_ns`` with an empty ``world``."""
        self.config = config
        self.stamp_ns = stamp_ns
        self.state, self.covariance = state, covariance
        self.map = world
        self._noise = config.imu.as_array()
        self._lidar_rot: np.ndarray | None = None
        self._mismatches: deque[float] = deque(maxlen=MISMATCH_SCANS)
        self._distrust = 0.0
        self._unsettled = self._unmapped = 0

    def advance(self, scan: Scan, interval: Interval) -> ScanReport:
        """Take in a scan; the state moves to its end, by the IMU alone if need be."""
        predicted, prior, path = propagate(
            self.state,
            self.covariance,
            interval.times,
            interval.gyro,
            interval.accel,
            self._noise,
        )
        prior = prior + self._doubt()
        lidar = predicted[m.ROT_LIDAR.start :].copy()
        thinned = prepare(scan, interval.start_ns, path, lidar, self.config.scan)
        if thinned.returns < self.config.update.min_returns:
            self._commit(scan.end_ns, predicted, prior)
            self._lidar_rot = None
            return ScanReport(Verdict.BLIND, thinned.returns, rejected=thinned.rejected)
        if len(self.map) == 0:
            self._commit(scan.end_ns, predicted, prior)
            self._extend(thinned, np.full(len(thinned.means), 2))
            return ScanReport(Verdict.GOOD, thinned.returns, rejected=thinned.rejected)
        matcher = Matcher(thinned, self.map, self.config.match)
        state, covariance, last = self._update(predicted, prior, matcher, interval)
        for _ in range(UNDISTORTIONS if self._unsettled else 0):
            moved = faster(path, state[m.VEL] - predicted[m.VEL])
            thinned = prepare(scan, interval.start_ns, moved, lidar, self.config.scan)
            matcher = Matcher(thinned, self.map, self.config.match)
            state, covariance, last = self._update(predicted, prior, matcher, interval)
        report = self._judge(predicted, prior, state, last, thinned)
        if report.verdict is Verdict.UNMATCHED:
            self._commit(scan.end_ns, predicted, prior)
            self._lidar_rot = None
            return report
        report = self._compare_turns(report, predicted, state, last, scan, interval)
        self._commit(scan.end_ns, state, covariance)
        if report.verdict is Verdict.GOOD and self._may_map():
            # A point off its plane may start a new cell, but must not bend old ones.
            self._extend(thinned, np.where(matcher.status == OUTLIER, 1, 2))
        return report

    def _update(
        self,
        predicted: np.ndarray,
        prior: np.ndarray,
        matcher: Matcher,
        interval: Interval,
    ) -> tuple[np.ndarray, np.ndarray, Evidence]:
        """The iterated update; also the evidence at its result."""
        config = self.config.update
        state, covariance, search = predicted, prior, True
        doubtful = self._unsettled > 0
        for _ in range(config.doubtful_iterations if doubtful else config.iterations):
            evidence = matcher.evidence(state, prior, search=search)
            information, gradient = evidence.information, evidence.gradient
            if interval.up is not None:
                extra = tilt_evidence(state, interval.up, interval.up_sigma)
                information, gradient = information + extra[0], gradient + extra[1]
            step, covariance = gauss_newton_step(
                state, predicted, prior, information, gradient
            )
            state, covariance = apply_step(state, covariance, step)
            turn, shift = np.linalg.norm(step[:3]), np.linalg.norm(step[3:6])
            if turn < config.done_turn and shift < config.done_shift:
                break
            # Points turn about the sensor; 3 m stands for their distance.
            search = bool(shift + 3.0 * turn > config.search_shift)
        return state, covariance, matcher.evidence(state, covariance, search=False)

    def _judge(
        self,
        predicted: np.ndarray,
        prior: np.ndarray,
        state: np.ndarray,
        evidence: Evidence,
        thinned: Thinned,
    ) -> ScanReport:
        config = self.config.update
        error = m.minus(state, predicted)[:6]
        surprise = float(np.sqrt(error @ np.linalg.solve(prior[:6, :6], error) / 6.0))
        verdict = Verdict.GOOD
        if (
            evidence.matches < config.min_matches
            or evidence.agreement < config.min_agreement
            or not np.isfinite(state).all()
        ):
            verdict = Verdict.UNMATCHED
        elif (
            evidence.agreement < config.good_agreement or surprise > config.max_surprise
        ):
            verdict = Verdict.DOUBTFUL
        shift, direction, turn = weakest(evidence.information)
        return ScanReport(
            verdict,
            thinned.returns,
            evidence.matches,
            evidence.agreement,
            evidence.residual,
            surprise,
            shift,
            direction,
            turn,
            thinned.rejected,
        )

    def _compare_turns(
        self,
        report: ScanReport,
        predicted: np.ndarray,
        state: np.ndarray,
        evidence: Evidence,
        scan: Scan,
        interval: Interval,
    ) -> ScanReport:
        """Add what LiDAR alone says about the rotation, and whether the IMU agrees."""
        turn = m.exp_rotation(lidar_turn(evidence))
        now = state[m.ROT].reshape(3, 3) @ turn
        if self._lidar_rot is not None:
            before = self.state[m.ROT].reshape(3, 3)
            expected = self._lidar_rot @ before.T @ predicted[m.ROT].reshape(3, 3)
            error = m.log_rotation(np.ascontiguousarray(expected.T @ now))
            self._mismatches.append(float(error @ error))
        self._lidar_rot = now
        middle_ns = (scan.start_ns + scan.end_ns) // 2
        back = turn_since(interval, middle_ns, state[m.GYRO_BIAS])
        mismatch = float(np.sqrt(sum(self._mismatches) / MISMATCH_SCANS))
        agrees = mismatch <= self.config.update.max_mismatch
        self._distrust = 0.0 if agrees else mismatch
        good = report.verdict is Verdict.GOOD
        if not good:
            self._distrust = max(mismatch, MISFIT)
        self._unsettled = (
            max(0, self._unsettled - 1)
            if agrees and good
            else self.config.update.settle
        )
        return replace(
            report,
            mismatch=mismatch,
            agrees=agrees,
            turn=LidarTurn(middle_ns, now @ back.T) if good else None,
        )

    def _may_map(self) -> bool:
        """Not while the pose is in doubt: a bent map would outlast the doubt."""
        if self._unsettled and self._unmapped < self.config.update.max_unmapped:
            self._unmapped += 1
            return False
        self._unmapped = self._unmapped if self._unsettled else 0
        return True

    def clocks_set(self, step_ns: int, *, upset: bool) -> None:
        """The LiDAR's stamps are corrected by ``step_ns``: so is that of the state.

        ``upset``: so much that the state may be off.
        """
        self.stamp_ns += step_ns
        self._mismatches.clear()
        self._lidar_rot = None
        if not upset:
            return
        deviations = np.zeros(m.ERROR_SIZE)
        deviations[m.E_ROT], deviations[m.E_POS], deviations[m.E_VEL] = UPSET
        self.covariance = self.covariance + np.diag(deviations**2)
        self._distrust = 0.0
        self._unsettled = self.config.update.settle

    def _doubt(self) -> np.ndarray | float:
        """What is added to the covariance of the prediction while the IMU errs."""
        if not self._distrust:
            return 0.0
        deviations = np.zeros(m.ERROR_SIZE)
        deviations[m.E_ROT] = DISTRUST * self._distrust
        deviations[m.E_POS] = DISTRUST * DISTRUST_ARM_M * self._distrust
        return np.diag(deviations**2)

    def _commit(self, stamp_ns: int, state: np.ndarray, covariance: np.ndarray) -> None:
        self.stamp_ns = stamp_ns
        self.state, self.covariance = state, covariance

    def _extend(self, thinned: Thinned, use: np.ndarray) -> None:
        rot = self.state[m.ROT].reshape(3, 3)
        inner = thinned.means @ self.state[m.ROT_LIDAR].reshape(3, 3).T
        world = (inner + self.state[m.POS_LIDAR]) @ rot.T + self.state[m.POS]
        self.map.follow(self.state[m.POS])
        self.map.insert(world, thinned.counts, use)
