"""Record what the simulated robot's LiDAR and IMU deliver, with the truth beside it.

The student walks an operator's patrol through a world, on true positions: the robot's
motion then does not depend on any odometry, and every odometry can be run on the same
recording afterwards.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import mujoco
import numpy as np

from openclone.evaluation.odometry import patrol
from openclone.evaluation.operator import calibration_of_operator, operator_of
from openclone.odometry.recording import SensorRecorder
from openclone.odometry.samples import ImuSample, LidarScan, PoseSample
from openclone.policy.bundle import Bundle
from openclone.robot.kinematics import Kinematics
from openclone.robot.model import standing_qpos
from openclone.simulation import imu as simulated
from openclone.simulation.lidar import Motion
from openclone.simulation.robot import SimulatedRobot
from openclone.simulation.sensors import HeadSensors, imu_pose
from openclone.simulation.worlds import build_world
from openclone.teleop.loop import LoopConfig
from openclone.teleop.messages import LoopTick
from openclone.teleop.session import SessionConfig, run_teleop

STILL_S = 1.5
"""Seconds at rest at the beginning, in which odometries start."""


@dataclass(frozen=True)
class RecordedWalk:
    """What was written.

    Attributes:
        scans, readings: how many.
        seconds: simulated, with the rest at the beginning.
        fell: whether the robot fell; the recording goes on.
    """

    scans: int
    readings: int
    seconds: float
    fell: bool


class _Drain:
    """Moves what the sensors have to the file after every tick of the loop."""

    def __init__(
        self,
        sensors: HeadSensors,
        model: mujoco.MjModel,
        recorder: SensorRecorder,
        progress: Callable[[int], None] | None,
    ) -> None:
        self._sensors, self._recorder = sensors, recorder
        self._model, self._data = model, mujoco.MjData(model)
        self._progress = progress
        self.scans = self.readings = 0

    def put(self, value: LoopTick, /) -> None:
        """A subscriber of the loop; the tick itself is of no interest here."""
        self.drain()

    def drain(self) -> None:
        """Write what is there: readings, frames and true poses in their order."""
        readings = deque(self._sensors.take_imu())
        for motion in self._sensors.take_motions():
            end_ns = int(motion.stamps_ns[-1])
            while readings and readings[0].stamp_ns <= end_ns:
                self._write_reading(readings.popleft())
            frame = self._sensors.lidar.trace(motion)
            self._write_truth(motion, end_ns)
            scan = LidarScan(frame.points.astype(np.float32), frame.stamps_ns)
            self._recorder.write(scan, end_ns)
            self.scans += 1
            if self._progress is not None:
                self._progress(self.scans)
        while readings:
            self._write_reading(readings.popleft())

    def _write_reading(self, sample: simulated.ImuSample) -> None:
        self._recorder.write(ImuSample(sample.stamp_ns, sample.gyro, sample.accel))
        self.readings += 1

    def _write_truth(self, motion: Motion, received_ns: int) -> None:
        """The IMU's poses at the knots; the last one also begins the next frame."""
        for stamp_ns, qpos in zip(motion.stamps_ns[:-1], motion.qpos, strict=False):
            self._data.qpos[:] = qpos
            mujoco.mj_kinematics(self._model, self._data)
            pose = imu_pose(self._data)
            truth = PoseSample(int(stamp_ns), pose.position, pose.quat)
            self._recorder.write(truth, received_ns)


def record_walk(
    path: Path,
    bundle: Bundle,
    *,
    world: str,
    seconds: float,
    seed: int = 0,
    progress: Callable[[int], None] | None = None,
) -> RecordedWalk:
    """Walk through ``world`` for ``seconds`` and write the sensors' stream to ``path``.

    Args:
        path: the MCAP file.
        bundle: the student.
        world: name of a world of `simulation.worlds`.
        seconds: simulated time of the walk.
        seed: of the sensors' errors.
        progress: told after each scan how many there are.

    Raises:
        InputError: there is no such world.
    """
    surroundings = build_world(world)
    robot = SimulatedRobot(surroundings.model)
    robot.reset(standing_qpos())
    sensors = HeadSensors(robot, surroundings, seed)
    clip = patrol(seconds, radius=math.inf) if world == "corridor" else patrol(seconds)
    with SensorRecorder(path) as recorder:
        drain = _Drain(sensors, surroundings.model, recorder, progress)
        sensors.hold_still(STILL_S)
        drain.drain()
        result = run_teleop(
            operator_of(clip, Kinematics()),
            bundle,
            seconds=seconds,
            realtime=False,
            subscribers=(drain,),
            config=SessionConfig(LoopConfig(calibration=calibration_of_operator())),
            robot=robot,
        )
        drain.drain()
    fell = bool(result.stats.falls)
    return RecordedWalk(drain.scans, drain.readings, sensors.now_ns * 1e-9, fell)
