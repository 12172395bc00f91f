"""FAST-LIO2: LiDAR and IMU in, pose out.

    lio = FastLio()
    lio.add_imu(stamp_ns, gyro, accel)          # 200 Hz
    state = lio.add_scan(points, stamps_ns)     # 10 Hz
    position, quat = lio.pose_at(stamp_ns)      # any time, any thread
    lio.health().tracking

`warmup.warm_up` compiles the inner loops beforehand; they are cached on disk.
Written from the paper (Xu, Cai, He, Lin, Zhang: FAST-LIO2, T-RO 2022).
"""

from __future__ import annotations

import threading
from collections import deque
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from openclone.errors import InputError
from openclone.odometry import manifold as m
from openclone.odometry.clock_offset import ClockConfig, ClockOffset
from openclone.odometry.estimator import Estimator, EstimatorConfig, Interval
from openclone.odometry.health import HealthConfig, LioHealth
from openclone.odometry.history import LivePoses
from openclone.odometry.imu import (
    STANDARD_GRAVITY,
    ClockJump,
    ImuBuffer,
    ImuConfig,
    check_stamp,
    check_vector,
)
from openclone.odometry.initialization import StartConfig, start, unrest
from openclone.odometry.scan import Scan, check_scan
from openclone.odometry.scan_report import ScanReport, Verdict
from openclone.odometry.state import OdometryState
from openclone.odometry.voxel_map import VoxelMap
from openclone.odometry.watch import Watch
from openclone.spatial import rotations

MID360_IMU_FROM_LIDAR = (-0.011, -0.02329, 0.04412)
"""Metres. Livox states the IMU at (11.0, 23.29, -44.12) mm in the cloud's frame."""

MAX_UNSEEN = 0.25
"""Seconds of the still second that no scan need show."""
RETRY_SCANS = 3
"""After so many more scans a start that failed is tried again."""


@dataclass(frozen=True)
class FastLioConfig:
    """Defaults fit a Livox Mid-360 indoors.

    Attributes:
        estimator: noise, thinning, matching, map and update.
        start: static initialization.
        stream: limits of plausible IMU samples.
        clock: search for an offset between the clocks of LiDAR and IMU.
        health: when the odometry calls itself lost.
        lidar_position: metres, the LiDAR's origin in the IMU frame.
        lidar_quat: wxyz, IMU from LiDAR.
        estimate_extrinsic: whether the two above are refined; they need motion about
            all axes to show.
        tilt_sigma: rad, trust in `FastLio.add_tilt`.
        history: poses kept for `FastLio.pose_at`, at the rate of the IMU.
        max_ahead: seconds that `FastLio.pose_at` looks beyond the newest sample.
        max_lead: seconds that a scan may end after the newest IMU sample.
    """

    estimator: EstimatorConfig = field(default_factory=EstimatorConfig)
    start: StartConfig = field(default_factory=StartConfig)
    stream: ImuConfig = field(default_factory=ImuConfig)
    clock: ClockConfig = field(default_factory=ClockConfig)
    health: HealthConfig = field(default_factory=HealthConfig)
    lidar_position: tuple[float, float, float] = MID360_IMU_FROM_LIDAR
    lidar_quat: tuple[float, float, float, float] = rotations.IDENTITY
    estimate_extrinsic: bool = False
    tilt_sigma: float = 0.01
    history: int = 2048
    max_ahead: float = 0.1
    max_lead: float = 0.5


class FastLio:
    """LiDAR-inertial odometry of one sensor.

    Poses are on the IMU's clock: it carries them between the scans. If the LiDAR's
    clock is found to differ, its stamps are corrected (`LioHealth.clock_offset_ns`).

    `add_imu`, `add_scan` and `pose_at` may be called from different threads; a scan
    being matched blocks neither of the others. Input that cannot be used raises
    `InputError`, is counted, and changes nothing.
    """

    def __init__(self, config: FastLioConfig | None = None) -> None:
        """Wait for a still second; allocates all memory."""
        self.config = config or FastLioConfig()
        self._lock, self._scan_lock = threading.Lock(), threading.Lock()
        self._imu = ImuBuffer(self.config.stream)
        self._map = VoxelMap(self.config.estimator.map)
        self._history = LivePoses(self._imu, self.config.history, self.config.max_ahead)
        self._watch = Watch(self.config.health)
        self._lidar = np.concatenate(
            (
                rotations.to_matrix(np.array(self.config.lidar_quat)).ravel(),
                self.config.lidar_position,
            )
        )
        self._clear()

    def reset(self) -> None:
        """Start anew: forget map, poses and samples."""
        with self._scan_lock, self._lock:
            self._clear()
            self._map.clear()
            self._watch = Watch(self.config.health)

    def _clear(self) -> None:
        self._imu.clear()
        self._history.clear()
        self._estimator: Estimator | None = None
        self._waiting: list[Scan] = []
        self._tilts: deque[tuple[int, np.ndarray]] = deque(maxlen=1024)
        self._clock = ClockOffset(self.config.clock)

    def add_imu(self, stamp_ns: int, gyro: Any, accel: Any) -> None:
        """Take in an IMU sample.

        Args:
            stamp_ns: nanoseconds, later than every sample before.
            gyro: (3,), rad/s, IMU frame.
            accel: (3,), m/s², specific force: about +9.8 upwards at rest.

        Raises:
            InputError: wrong shape, unit or order; the sample is left out.
        """
        with self._lock:
            try:
                stamp = self._imu.append(stamp_ns, gyro, accel)
            except InputError:
                self._watch.refused += 1
                raise
            except ClockJump:
                self._clear()
                self._watch.restart()
                stamp = self._imu.append(stamp_ns, gyro, accel)
            if self._estimator is not None:
                self._history.follow(stamp)

    def add_tilt(self, stamp_ns: int, up: Any) -> None:
        """Anchor roll and pitch to another IMU.

        Args:
            stamp_ns: nanoseconds, on the clock of `add_imu`.
            up: (3,), the world's up as a vector in the LiDAR's IMU frame.
        """
        stamp = check_stamp(stamp_ns, "add_tilt")
        vector = check_vector(up, 2.0, "up", "add_tilt")
        if float(np.linalg.norm(vector)) < 0.5:
            raise InputError(
                f"up is {up}", where="add_tilt", remedy="pass a unit vector"
            )
        with self._lock:
            self._tilts.append((stamp, vector / np.linalg.norm(vector)))

    def add_scan(self, points: Any, stamps_ns: Any) -> OdometryState:
        """Take in a scan.

        Args:
            points: (N, 3), metres, LiDAR frame as measured (not undistorted). Zeros
                (no return), NaN and points out of range are left out.
            stamps_ns: (N,), whole nanoseconds, in any order within the scan; on the
                clock of `add_imu` up to 0.2 s, which is found while the sensor turns.

        Returns:
            The state at the scan's newest point, on the IMU's clock; by the IMU alone
            if the scan could not be used.

        Raises:
            InputError: wrong shape, unit or order, or no IMU samples up to the scan.
        """
        with self._scan_lock:
            try:
                scan = check_scan(points, stamps_ns, self.config.estimator.scan)
                with self._lock:
                    scan = scan.moved(self._clock.offset_ns)
                    self._check_order(scan)
                    estimator = self._estimator
            except InputError:
                self._watch.refused += 1
                raise
            if estimator is None:
                self._try_start(scan)
            else:
                report = estimator.advance(scan, self._interval(estimator, scan))
                self._publish(estimator, scan, report)
            health = self.health(scan.end_ns)
            return OdometryState.of(self._estimator, self._lidar, scan.end_ns, health)

    def pose_at(self, stamp_ns: int) -> tuple[np.ndarray, np.ndarray]:
        """Position ``(3,)``, metres, and wxyz ``(4,)`` of the IMU in the world.

        Between scans the IMU is integrated; ahead of its newest sample the motion
        goes on unchanged for at most ``max_ahead``. Before the start the pose is the
        origin, and `health` says so.

        Raises:
            InputError: the stamp is older than the poses kept.
        """
        stamp = check_stamp(stamp_ns, "pose_at")
        with self._lock:
            if len(self._history) == 0:
                return np.zeros(3), np.array(rotations.IDENTITY)
            if stamp < self._history.oldest_ns:
                raise InputError(
                    f"stamp {stamp} ns is older than the poses kept",
                    where="pose_at",
                    remedy=f"the oldest is {self._history.oldest_ns} ns",
                )
            rot, position = self._history.at(stamp)
        return position, rotations.from_matrix(rot)

    def health(self, stamp_ns: int | None = None) -> LioHealth:
        """Whether the pose at ``stamp_ns`` (default: now, by the newest data) holds."""
        with self._lock:
            return self._health(stamp_ns)

    def map_points(self) -> np.ndarray:
        """The map's cells ``(n, 3)``, metres, world."""
        with self._scan_lock:
            return self._map.points

    def _health(self, stamp_ns: int | None) -> LioHealth:
        imu_ns = self._imu.newest_ns if len(self._imu) else None
        pose_ns = self._history.newest_ns if len(self._history) else None
        estimator = self._estimator
        stamps = [s for s in (imu_ns, self._watch.scan_ns) if s is not None]
        now = max(stamps, default=0) if stamp_ns is None else int(stamp_ns)
        covariance, blind = None, 0.0
        if estimator is not None and imu_ns is not None:
            covariance = estimator.covariance
            blind = max(self._imu.longest_pause(estimator.stamp_ns), now - imu_ns)
        return self._watch.health(
            now, blind * 1e-9, pose_ns, covariance, self._imu.gaps, len(self._map)
        )

    def _check_order(self, scan: Scan) -> None:
        where = "add_scan"
        last = self._watch.scan_ns
        if last is not None and scan.end_ns <= last:
            raise InputError(
                f"the scan ends {last - scan.end_ns} ns before the one before it",
                where=where,
                remedy="scans must come in order; it was left out",
            )
        newest = self._imu.newest_ns if len(self._imu) else None
        lead = self.config.max_lead * 1e9
        if newest is None or scan.end_ns - newest > lead:
            late = "" if newest is None else f" {(scan.end_ns - newest) * 1e-9:.3f} s"
            raise InputError(
                f"the scan ends{late} after the newest IMU sample",
                where=where,
                remedy="add the IMU samples first, on the same clock",
            )

    def _interval(self, estimator: Estimator, scan: Scan) -> Interval:
        with self._lock:
            start_ns = estimator.stamp_ns
            times, gyro, accel = self._imu.between(start_ns, scan.end_ns)
            up = self._tilt_near(scan.end_ns)
        return Interval(start_ns, times, gyro, accel, up, self.config.tilt_sigma)

    def _tilt_near(self, stamp_ns: int) -> np.ndarray | None:
        """The second IMU's up within 20 ms of a stamp, if there is one."""
        best = min(self._tilts, key=lambda item: abs(item[0] - stamp_ns), default=None)
        if best is None or abs(best[0] - stamp_ns) > 20_000_000:
            return None
        return best[1]

    def _try_start(self, scan: Scan) -> None:
        """Start when the sensor was still for a second up to the end of ``scan``."""
        config = self.config.start
        begin = scan.end_ns - round(config.seconds * 1e9)
        self._waiting = [s for s in self._waiting if s.start_ns >= begin]
        self._waiting.append(scan)
        self._watch.wait(scan.end_ns, "waiting for one still second")
        with self._lock:
            unseen = self._waiting[0].start_ns - begin
            if self._imu.oldest_ns > begin or unseen > MAX_UNSEEN * 1e9:
                return
            _, gyro, accel = self._imu.between(begin, scan.end_ns)
            reason = unrest(gyro, accel, config)
            up = self._tilt_near(scan.end_ns)
        if reason:
            self._watch.wait(scan.end_ns, f"waiting for one still second: {reason}")
            return
        state, covariance = start(
            gyro,
            accel,
            self._lidar,
            config,
            up=up,
            up_sigma=self.config.tilt_sigma,
            estimate_extrinsic=self.config.estimate_extrinsic,
        )
        self._map.clear()
        estimator = Estimator(
            self.config.estimator,
            self._waiting[0].start_ns,
            state,
            covariance,
            self._map,
        )
        self._replay(estimator)

    def _replay(self, estimator: Estimator) -> None:
        """Run the scans of the still second; the start fails if they show motion."""
        waiting, self._waiting = self._waiting, self._waiting[RETRY_SCANS:]
        config = self.config.start
        path = [(estimator.stamp_ns, estimator.state)]
        for scan in waiting:
            report = estimator.advance(scan, self._interval(estimator, scan))
            speed = float(np.linalg.norm(estimator.state[m.VEL]))
            far = float(np.linalg.norm(estimator.state[m.POS]))
            if report.verdict is not Verdict.GOOD or speed > config.max_speed:
                self._watch.wait(scan.end_ns, f"not started: {report.verdict.value}")
                return
            if far > config.max_speed * config.seconds:
                self._watch.wait(scan.end_ns, "not started: the sensor moves")
                return
            self._watch.take(scan.end_ns, report)
            path.append((estimator.stamp_ns, estimator.state))
        gravities = [state[m.GRAVITY] for _, state in (path[0], path[-1])]
        tilt = float(np.linalg.norm(gravities[1] - gravities[0])) / STANDARD_GRAVITY
        if tilt > config.max_tilt:
            self._watch.wait(path[-1][0], "not started: the sensor slows down")
            return
        self._waiting = []
        with self._lock:
            self._estimator = estimator
            self._history.clear()
            for stamp, state in path:
                self._history.append(stamp, state, np.zeros(3))
            self._history.restart(estimator.stamp_ns, estimator.state)

    def _publish(self, estimator: Estimator, scan: Scan, report: ScanReport) -> None:
        with self._lock:
            if self._estimator is not estimator:
                return
            self._watch.take(scan.end_ns, report)
            if report.verdict in (Verdict.GOOD, Verdict.DOUBTFUL):
                self._compare_clocks(estimator, report)
                self._history.restart(estimator.stamp_ns, estimator.state)

    def _compare_clocks(self, estimator: Estimator, report: ScanReport) -> None:
        """Look for an offset of the clocks when LiDAR and IMU turn differently."""
        if report.turn is not None:
            self._clock.take(report.turn)
        if len(self._clock) == 0 or not self.config.clock.correct:
            return
        begin_ns, newest_ns = self._clock.begin_ns, self._imu.newest_ns
        times, gyro, _ = self._imu.between(begin_ns, newest_ns)
        bias = estimator.state[m.GYRO_BIAS]
        change_ns = self._clock.update(begin_ns, times, gyro - bias, newest_ns)
        if change_ns:
            upset = abs(change_ns) > self.config.clock.harmless * 1e9
            self._watch.clocks_differ(change_ns, upset=upset)
            estimator.clocks_set(change_ns, upset=upset)
