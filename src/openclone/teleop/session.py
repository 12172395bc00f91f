"""A whole session: a recorded operator drives the simulated robot."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from openclone.odometry.ground_truth import GroundTruthOdometry
from openclone.odometry.noise import OdometryNoiseConfig
from openclone.policy.bundle import Bundle
from openclone.policy.controller import StudentController
from openclone.robot.kinematics import Kinematics
from openclone.robot.model import standing_qpos
from openclone.simulation.robot import SimulatedRobot
from openclone.spatial.clock import ManualClock, MonotonicClock
from openclone.teleop.calibration import measure_operator
from openclone.teleop.loop import LoopConfig, LoopStats, TeleopLoop
from openclone.teleop.messages import OperatorRecording, Subscriber, check_recording
from openclone.teleop.operators.replay import ReplayConfig, ReplayOperator
from openclone.teleop.recorder import TickLog, TickRecorder
from openclone.teleop.robots.simulated import SimulatedLink


@dataclass(frozen=True)
class SessionConfig:
    """Settings of a session; see the parts."""

    loop: LoopConfig = field(default_factory=LoopConfig)
    replay: ReplayConfig = field(default_factory=ReplayConfig)


@dataclass(frozen=True)
class SessionResult:
    """What a session leaves.

    Attributes:
        stats: ticks, overruns, durations, falls.
        log: all ticks as arrays.
        recording_time_s: (T,), seconds into the recording that the operator's frame
            of each tick shows; -1 before the first frame.
    """

    stats: LoopStats
    log: TickLog
    recording_time_s: np.ndarray


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
) -> SessionResult:
    """Replay ``recording`` as the operator of a simulated G1, closed loop.

    Args:
        recording: the operator.
        bundle: the policy.
        seconds: length of the run; None: until the recording has been played.
        realtime: in real time with a headset-like thread, or as fast as possible
            (then everything is reproducible).
        subscribers: receive every tick; their ``put`` must return at once.
        noise: of the stand-in odometry (Eq. 2); None: exact positions.
        seed: of that noise.
        config: settings of the parts.
        robot: the simulated robot to use, as it stands; None: a new one, standing.

    Raises:
        InputError: the recording is malformed.
    """
    check_recording(recording)
    config = config or SessionConfig()
    loop_config = config.loop
    calibration = loop_config.calibration
    if calibration.operator is None:
        operator_body = measure_operator(
            recording.positions, recording.quats, calibration.proportions
        )
        calibration = replace(calibration, operator=operator_body)
        loop_config = replace(loop_config, calibration=calibration)
    if robot is None:
        robot = SimulatedRobot()
        robot.reset(standing_qpos())
    odometry = GroundTruthOdometry(noise, np.random.default_rng(seed))
    operator = ReplayOperator(recording, config.replay, realtime=realtime)
    recorder = TickRecorder()
    loop = TeleopLoop(
        operator,
        SimulatedLink(robot, odometry),
        odometry,
        StudentController(bundle),
        MonotonicClock() if realtime else ManualClock(),
        config=loop_config,
        kinematics=Kinematics(robot.model),
        subscribers=(recorder, *subscribers),
    )
    stats = loop.run(seconds)
    log = recorder.log()
    shown = operator.recording_time(log.operator_stamp_ns)
    shown = np.where(log.operator_stamp_ns < 0, -1.0, shown)
    return SessionResult(stats, log, shown)
