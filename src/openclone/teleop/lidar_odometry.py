"""LiDAR odometry of the simulated robot, from the sensors to the pose of the pelvis.

The control loop feeds it each tick and is answered at once. Tracing a LiDAR frame and
registering it take tens of milliseconds and run in a thread of their own, which spends
them in compiled code that leaves the interpreter free. Without real time everything
happens in the caller, and a frame is registered only when its result would have come.
"""

from __future__ import annotations

import queue
import threading
import time
from collections import deque
from dataclasses import dataclass, field
from typing import Literal

import mujoco
import numpy as np

from openclone.errors import InputError, OpenCloneError
from openclone.odometry.protocol import OdometryHealth, SensorOdometry
from openclone.simulation.imu import ImuSample
from openclone.simulation.lidar import Motion
from openclone.simulation.sensors import HeadSensors, imu_pose
from openclone.spatial.poses import Pose
from openclone.teleop.realtime import realtime_priority

SensorOdometryName = Literal["lio", "rko"]
_PRIORITY = 5
"""Of SCHED_FIFO: above every ordinary thread, below the control loop."""


@dataclass(frozen=True)
class LidarOdometryConfig:
    """Settings.

    Attributes:
        still_s: seconds that the robot is held still before the start.
        latency_s: seconds from the end of a frame to its result, without real time.
        max_waiting: frames; with more of them waiting in real time one is left out.
    """

    still_s: float = 1.5
    latency_s: float = 0.04
    max_waiting: int = 2


@dataclass(frozen=True)
class OdometryCost:
    """What the odometry did and took.

    Attributes:
        scans: frames registered.
        dropped: frames left out, because they came too fast or were refused.
        untrusted: frames after which the odometry did not trust itself.
        scan_ms, scan_p99_ms: CPU time of registering one frame: mean, 99th percentile.
        trace_ms: CPU time of simulating one frame.
    """

    scans: int = 0
    dropped: int = 0
    untrusted: int = 0
    scan_ms: float = 0.0
    scan_p99_ms: float = 0.0
    trace_ms: float = 0.0


@dataclass
class _Tally:
    """Counts that the worker keeps."""

    scan_ns: list[int] = field(default_factory=list)
    trace_ns: list[int] = field(default_factory=list)
    dropped: int = 0
    untrusted: int = 0


class LidarOdometry:
    """An `odometry.protocol.Odometry` for the pelvis, from the head's sensors."""

    def __init__(
        self,
        sensors: HeadSensors,
        estimator: SensorOdometry,
        model: mujoco.MjModel,
        config: LidarOdometryConfig | None = None,
        *,
        realtime: bool = True,
    ) -> None:
        """Connect ``sensors`` to ``estimator``; `begin` starts both.

        Args:
            sensors: of the robot.
            estimator: fresh; takes readings while it registers a scan in another
                thread, and scans that end before the newest reading.
            model: any with the G1's bodies, for the way from pelvis to head.
            config: settings.
            realtime: work in a thread, or in the caller and reproducibly.
        """
        self._sensors, self._estimator = sensors, estimator
        self._config = config or LidarOdometryConfig()
        self._realtime = realtime
        self._model, self._data = model, mujoco.MjData(model)
        self._world_from_odometry = Pose.identity()
        self._imu_from_base = Pose.identity()
        self._offset_ns = 0
        self._tally = _Tally()
        self._late: deque[Motion] = deque()
        self._work: queue.Queue[Motion | None] = queue.Queue()
        self._thread: threading.Thread | None = None
        self._failure: BaseException | None = None

    def begin(self, base: Pose, joint_angles: np.ndarray) -> None:
        """Hold the robot still until the odometry has started; then follow it.

        Args:
            base: world from pelvis at the start, with the tilt that the robot's own
                IMU reports: the pose that all later ones go on from.
            joint_angles: (29,), radians.

        Raises:
            OpenCloneError: the odometry did not start.
        """
        self._sensors.hold_still(self._config.still_s)
        for sample in self._sensors.take_imu():
            self._feed(sample)
        for motion in self._sensors.take_motions():
            self._register(motion)
        now_ns = self._sensors.now_ns
        if not self._estimator.health(now_ns).tracking:
            raise OpenCloneError(
                f"the LiDAR odometry did not start within {self._config.still_s:g} s; "
                "this world may show it too few surfaces"
            )
        self._imu_from_base = self._mount(joint_angles)
        odometry_from_base = (
            Pose(*self._estimator.pose_at(now_ns)) @ self._imu_from_base
        )
        self._world_from_odometry = base @ odometry_from_base.inverse()
        self._tally = _Tally()
        if self._realtime:
            self._thread = threading.Thread(target=self._labour, daemon=True)
            self._thread.start()

    def observe(self, now_ns: int, joint_angles: np.ndarray) -> None:
        """Take what the sensors delivered until ``now_ns``; call in every tick.

        Args:
            now_ns: the loop's clock.
            joint_angles: (29,), radians; the waist's tell where the head is.
        """
        self._offset_ns = self._sensors.now_ns - now_ns
        self._imu_from_base = self._mount(joint_angles)
        for sample in self._sensors.take_imu():
            self._feed(sample)
        for motion in self._sensors.take_motions():
            if not self._realtime:
                self._late.append(motion)
            elif self._work.qsize() < self._config.max_waiting:
                self._work.put(motion)
            else:
                self._tally.dropped += 1
        due_ns = self._sensors.now_ns - round(self._config.latency_s * 1e9)
        while self._late and int(self._late[0].stamps_ns[-1]) <= due_ns:
            self._register(self._late.popleft())

    def pose_at(self, stamp_ns: int) -> tuple[np.ndarray, np.ndarray]:
        """Position ``(3,)``, metres, and wxyz ``(4,)`` of the pelvis, world."""
        imu = Pose(*self._estimator.pose_at(stamp_ns + self._offset_ns))
        base = self._world_from_odometry @ imu @ self._imu_from_base
        return base.position, base.quat

    def health(self, stamp_ns: int) -> OdometryHealth:
        """As the estimator says.

        Raises:
            OpenCloneError: its thread has died.
        """
        if self._failure is not None:
            raise OpenCloneError(
                f"the odometry's thread failed: {self._failure}"
            ) from self._failure
        return self._estimator.health(stamp_ns + self._offset_ns)

    def close(self) -> None:
        """End the thread."""
        if self._thread is not None:
            self._work.put(None)
            self._thread.join()
            self._thread = None

    def cost(self) -> OdometryCost:
        """What has been done since `begin`."""
        tally = self._tally
        scan_ms = 1e-6 * np.array(tally.scan_ns or [0])
        return OdometryCost(
            scans=len(tally.scan_ns),
            dropped=tally.dropped,
            untrusted=tally.untrusted,
            scan_ms=float(scan_ms.mean()),
            scan_p99_ms=float(np.percentile(scan_ms, 99)),
            trace_ms=1e-6 * float(np.mean(tally.trace_ns or [0])),
        )

    def _feed(self, sample: ImuSample) -> None:
        self._estimator.add_imu(sample.stamp_ns, sample.gyro, sample.accel)

    def _labour(self) -> None:
        """The thread: register frames until None comes."""
        try:
            # A robot whose odometry is late stops as one whose loop is late.
            with realtime_priority(_PRIORITY):
                while (motion := self._work.get()) is not None:
                    self._register(motion)
        except BaseException as error:  # the loop must hear of it, whatever it is
            self._failure = error

    def _register(self, motion: Motion) -> None:
        """Trace a frame and give it to the estimator."""
        began_ns = time.thread_time_ns()
        frame = self._sensors.lidar.trace(motion)
        traced_ns = time.thread_time_ns()
        self._tally.trace_ns.append(traced_ns - began_ns)
        try:
            self._estimator.add_scan(frame.points, frame.stamps_ns)
        except InputError:
            self._tally.dropped += 1
            return
        self._tally.scan_ns.append(time.thread_time_ns() - traced_ns)
        trusted = self._estimator.health(frame.end_ns).tracking
        self._tally.untrusted += not trusted

    def _mount(self, joint_angles: np.ndarray) -> Pose:
        """IMU from pelvis for these joint angles."""
        self._data.qpos[:7] = (0, 0, 0, 1, 0, 0, 0)
        self._data.qpos[7:] = joint_angles
        mujoco.mj_kinematics(self._model, self._data)
        return imu_pose(self._data).inverse()
