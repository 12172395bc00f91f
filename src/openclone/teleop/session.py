"""A whole session: a recorded operator drives the simulated robot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from openclone.errors import InputError
from openclone.odometry.ground_truth import GroundTruthOdometry
from openclone.odometry.noise import OdometryNoiseConfig
from openclone.odometry.protocol import SensorOdometry
from openclone.policy.bundle import Bundle
from openclone.policy.controller import StudentController
from openclone.robot.kinematics import Kinematics
from openclone.robot.model import standing_qpos
from openclone.simulation.robot import SimulatedRobot
from openclone.simulation.sensors import HeadSensors, SensorConfig
from openclone.simulation.worlds import World, build_world
from openclone.spatial.clock import ManualClock, MonotonicClock
from openclone.spatial.poses import Pose
from openclone.teleop.calibration import measure_operator
from openclone.teleop.lidar_odometry import (
    LidarOdometry,
    LidarOdometryConfig,
    OdometryCost,
    SensorOdometryName,
)
from openclone.teleop.loop import LoopConfig, LoopStats, TeleopLoop
from openclone.teleop.messages import OperatorRecording, Subscriber, check_recording
from openclone.teleop.operators.replay import ReplayConfig, ReplayOperator
from openclone.teleop.recorder import TickLog, TickRecorder
from openclone.teleop.robots.simulated import SimulatedLink

OdometryName = Literal["ground-truth", "lio", "rko"]


@dataclass(frozen=True)
class SessionConfig:
    """Settings of a session; see the parts."""

    loop: LoopConfig = field(default_factory=LoopConfig)
    replay: ReplayConfig = field(default_factory=ReplayConfig)
    sensors: SensorConfig = field(default_factory=SensorConfig)
    odometry: LidarOdometryConfig = field(default_factory=LidarOdometryConfig)


@dataclass(frozen=True)
class SessionResult:
    """What a session leaves.

    Attributes:
        stats: ticks, overruns, durations, falls.
        log: all ticks as arrays.
        recording_time_s: (T,), seconds into the recording that the operator's frame
            of each tick shows; -1 before the first frame.
        odometry_cost: what LiDAR odometry did and took; zeros without it.
    """

    stats: LoopStats
    log: TickLog
    recording_time_s: np.ndarray
    odometry_cost: OdometryCost = field(default_factory=OdometryCost)


def run_teleop(
    recording: OperatorRecording,
    bundle: Bundle,
    *,
    seconds: float | None = None,
    realtime: bool = True,
    subscribers: Sequence[Subscriber] = (),
    noise: OdometryNoiseConfig | None = None,
    seed: int = 0,
    config: SessionConfig | None = None,
    robot: SimulatedRobot | None = None,
    world: str = "flat",
    odometry: OdometryName = "ground-truth",
) -> SessionResult:
    """Replay ``recording`` as the operator of a simulated G1, closed loop.

    Args:
        recording: the operator.
        bundle: the policy.
        seconds: length of the run; None: until the recording has been played.
        realtime: with a headset-like thread, or as fast as possible and reproducible.
        subscribers: receive every tick; their ``put`` must return at once.
        noise: of the stand-in odometry (Eq. 2); None: exact positions.
        seed: of that noise, or of the sensors' errors.
        config: settings of the parts.
        robot: to use as it stands; None: a new one at the origin of ``world``.
        world: name of a world of `simulation.worlds`.
        odometry: the truth with ``noise``, or FAST-LIO2 or rko_lio on the sensors.

    Raises:
        InputError: the recording is malformed, or there is no such world or odometry.
        OpenCloneError: the LiDAR odometry does not start in this world.
    """
    check_recording(recording)
    config = config or SessionConfig()
    surroundings = World("given", robot.model) if robot else build_world(world)
    if robot is None:
        robot = SimulatedRobot(surroundings.model)
        robot.reset(standing_qpos())
    source = _odometry(odometry, robot, surroundings, config, noise, seed, realtime)
    operator = ReplayOperator(recording, config.replay, realtime=realtime)
    recorder = TickRecorder()
    loop = TeleopLoop(
        operator,
        SimulatedLink(robot, source),
        source,
        StudentController(bundle),
        MonotonicClock() if realtime else ManualClock(),
        config=_measured(config.loop, recording),
        kinematics=Kinematics(robot.model),
        subscribers=(recorder, *subscribers),
    )
    cost = OdometryCost()
    try:
        stats = loop.run(seconds)
    finally:
        if isinstance(source, LidarOdometry):
            source.close()
            cost = source.cost()
    return _result(stats, recorder.log(), operator, cost)


def _result(
    stats: LoopStats, log: TickLog, operator: ReplayOperator, cost: OdometryCost
) -> SessionResult:
    """What happened, with the recording's time of every tick."""
    shown = operator.recording_time(log.operator_stamp_ns)
    shown = np.where(log.operator_stamp_ns < 0, -1.0, shown)
    return SessionResult(stats, log, shown, cost)


def _measured(config: LoopConfig, recording: OperatorRecording) -> LoopConfig:
    """``config`` with the operator's measures, from ``recording`` if not given."""
    calibration = config.calibration
    if calibration.operator is not None:
        return config
    body = measure_operator(
        recording.positions, recording.quats, calibration.proportions
    )
    return replace(config, calibration=replace(calibration, operator=body))


def _odometry(
    name: OdometryName,
    robot: SimulatedRobot,
    world: World,
    config: SessionConfig,
    noise: OdometryNoiseConfig | None,
    seed: int,
    realtime: bool,
) -> GroundTruthOdometry | LidarOdometry:
    """The odometry of that name, started."""
    if name == "ground-truth":
        return GroundTruthOdometry(noise, np.random.default_rng(seed))
    estimator = make_estimator(name)
    sensors = HeadSensors(robot, world, seed, config.sensors)
    odometry = LidarOdometry(
        sensors, estimator, robot.model, config.odometry, realtime=realtime
    )
    odometry.begin(Pose(*robot.base_pose()), robot.reading().joint_angles)
    return odometry


def make_estimator(name: SensorOdometryName) -> SensorOdometry:
    """FAST-LIO2, compiled, or rko_lio.

    Raises:
        InputError: there is no such odometry, or its package is missing.
    """
    # Both pull in libraries that a session without LiDAR does not need.
    if name == "lio":
        from openclone.odometry.fast_lio import FastLio
        from openclone.odometry.warmup import warm_up

        warm_up()
        return FastLio()
    if name == "rko":
        from openclone.odometry.rko import RkoLio

        return RkoLio()
    raise InputError(f"unknown odometry {name!r}", remedy="use ground-truth, lio, rko")
