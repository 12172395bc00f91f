"""How well the odometry knows where the robot is while the robot lives by it.

An operator walks laps with stops through a simulated world. The student follows with
LiDAR odometry closing the loop: the command is compared with where the odometry puts
head and hands. The simulator alone knows the truth.
"""

from __future__ import annotations

import math
import time
from dataclasses import asdict, dataclass, replace

import numpy as np

from openclone.errors import InputError
from openclone.evaluation.operator import calibration_of_operator, operator_of
from openclone.motion.clip import Clip, ClipInfo, clip_from_qpos
from openclone.motion.sources.choreography import FPS
from openclone.motion.sources.gliding import Laps, carried_body
from openclone.odometry.noise import OdometryNoiseConfig
from openclone.policy.bundle import Bundle
from openclone.robot.kinematics import Kinematics
from openclone.robot.model import CONTROL_PERIOD
from openclone.spatial import rotations
from openclone.teleop.loop import LoopConfig
from openclone.teleop.messages import Subscriber
from openclone.teleop.recorder import TickLog
from openclone.teleop.session import (
    OdometryName,
    SessionConfig,
    SessionResult,
    run_teleop,
)

_PATROL = Laps(speed=0.35, radius=2.2, leg=2.5, ease_s=0.8, pause_s=1.5, sink=0.02)
"""The radius: the packaged student falls in sharper turns."""
_STRAIGHT_WORLDS = ("corridor",)


@dataclass(frozen=True)
class OdometryReport:
    """Errors of the odometry against the simulator, and what it cost.

    Attributes:
        world, odometry: where, and which odometry.
        seconds: simulated, until the end or a fall.
        fell: whether the robot fell.
        stop_reason: what made the safety machine let go, or "".
        path_m: metres that the pelvis really went, horizontally.
        mean_mm, max_mm: distance of the believed from the true pelvis.
        end_mm: the same at the end.
        heading_mean_deg, heading_max_deg: error of the heading.
        minute_mean_mm: mean position error of every full minute.
        healthy_percent: frames after which the odometry trusted itself.
        scans: LiDAR frames used.
        scan_ms, scan_p99_ms: CPU time per frame for the odometry.
        trace_ms: CPU time per frame for the simulated LiDAR.
        cpu_per_second: CPU seconds of everything per simulated second.
        tick_p50_ms, tick_p99_ms: of the control loop; without real time the sensors'
            simulation and the odometry happen in it.
        overruns: deadlines missed (real time only).
    """

    world: str
    odometry: str
    seconds: float
    fell: bool
    stop_reason: str
    path_m: float
    mean_mm: float
    max_mm: float
    end_mm: float
    heading_mean_deg: float
    heading_max_deg: float
    minute_mean_mm: tuple[float, ...]
    healthy_percent: float
    scans: int
    scan_ms: float
    scan_p99_ms: float
    trace_ms: float
    cpu_per_second: float
    tick_p50_ms: float
    tick_p99_ms: float
    overruns: int

    def to_json(self) -> dict[str, object]:
        """The fields by name."""
        return asdict(self)


def patrol(seconds: float, *, radius: float = _PATROL.radius) -> Clip:
    """A walk with stops, as an operator's head and hands show it: legs do not move.

    Args:
        seconds: how long.
        radius: metres, of laps to the left; infinite: straight ahead.
    """
    info = ClipInfo("patrol", "forward", "openclone", "Apache-2.0", FPS)
    laps = replace(_PATROL, radius=radius)
    return clip_from_qpos(info, carried_body(seconds, laps))


def evaluate_odometry(
    bundle: Bundle,
    *,
    world: str = "room",
    odometry: OdometryName = "lio",
    seconds: float = 60.0,
    seed: int = 0,
    realtime: bool = False,
    subscribers: tuple[Subscriber, ...] = (),
) -> OdometryReport:
    """Walk through ``world`` for ``seconds`` with ``odometry`` closing the loop.

    Args:
        bundle: the student.
        world: name of a world of `simulation.worlds`.
        odometry: which one; "ground-truth" is the truth with the error of Eq. 2.
        seconds: simulated time.
        seed: of the sensors' errors.
        realtime: keep real time with threads, or run reproducibly.
        subscribers: also receive every tick.

    Raises:
        InputError: the walk would leave the corridor.
    """
    straight = world in _STRAIGHT_WORLDS
    if straight and seconds > 150.0:
        raise InputError(
            f"a walk of {seconds:.0f} s would leave the corridor",
            remedy="use at most 150 s, or another world",
        )
    clip = patrol(seconds, radius=math.inf if straight else _PATROL.radius)
    began = time.process_time()
    result = run_teleop(
        operator_of(clip, Kinematics()),
        bundle,
        seconds=seconds,
        realtime=realtime,
        subscribers=subscribers,
        noise=OdometryNoiseConfig() if odometry == "ground-truth" else None,
        seed=seed,
        config=SessionConfig(LoopConfig(calibration=calibration_of_operator())),
        world=world,
        odometry=odometry,
    )
    return make_report(result, world, odometry, time.process_time() - began)


def make_report(
    result: SessionResult, world: str, odometry: str, cpu_s: float
) -> OdometryReport:
    """Compare what the session's odometry believed with what was true."""
    log, stats, cost = result.log, result.stats, result.odometry_cost
    error_mm, heading_deg = pose_errors(log)
    seconds = log.num_ticks * CONTROL_PERIOD
    minute = round(60.0 / CONTROL_PERIOD)
    minutes = [
        float(error_mm[k : k + minute].mean())
        for k in range(0, len(error_mm) - minute + 1, minute)
    ]
    path = np.linalg.norm(np.diff(log.qpos[:, :2], axis=0), axis=1).sum()
    return OdometryReport(
        world=world,
        odometry=odometry,
        seconds=seconds,
        fell=bool(stats.falls),
        stop_reason=stats.stop_reason,
        path_m=float(path),
        mean_mm=float(error_mm.mean()),
        max_mm=float(error_mm.max()),
        end_mm=float(error_mm[-1]),
        heading_mean_deg=float(heading_deg.mean()),
        heading_max_deg=float(heading_deg.max()),
        minute_mean_mm=tuple(minutes),
        healthy_percent=100.0 * (1.0 - cost.untrusted / max(cost.scans, 1)),
        scans=cost.scans,
        scan_ms=cost.scan_ms,
        scan_p99_ms=cost.scan_p99_ms,
        trace_ms=cost.trace_ms,
        cpu_per_second=cpu_s / max(seconds, 1e-9),
        tick_p50_ms=stats.p50_ms,
        tick_p99_ms=stats.p99_ms,
        overruns=stats.overruns,
    )


def pose_errors(log: TickLog) -> tuple[np.ndarray, np.ndarray]:
    """Distance in mm and heading error in degrees, ``(T,)`` each, of the pelvis."""
    distance = np.linalg.norm(log.base_position - log.qpos[:, :3], axis=1)
    turn = rotations.yaw(log.base_quat) - rotations.yaw(log.qpos[:, 3:7])
    return 1000.0 * distance, np.abs(np.degrees(rotations.wrap_angle(turn)))
