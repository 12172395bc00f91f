"""Standing quietly: a still operator, a robot that should not step or sway.

The paper has no such figure; users of such systems complain about nothing more often.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from openclone.evaluation import metrics
from openclone.evaluation.episode import Episode, make_reference, run_clip
from openclone.motion.clip import ClipInfo, clip_from_qpos
from openclone.odometry.noise import OdometryNoiseConfig
from openclone.policy.bundle import Bundle
from openclone.robot import g1
from openclone.robot.model import CONTROL_PERIOD, build_model, standing_qpos
from openclone.robot.state import key_point_poses
from openclone.simulation.robot import SimulatedRobot

SETTLE_SECONDS = 1.0
"""Left out of the sway: the robot finds its balance after the start."""
DEFAULT_NOISE = OdometryNoiseConfig()


@dataclass(frozen=True)
class StandingReport:
    """How quietly the robot stood.

    Attributes:
        seconds: how long it stood, until the end or a fall.
        fell: whether it fell.
        falls: the same as a number.
        steps: times a foot left the ground for 40 ms or more, from the first instant.
        sway_mm: largest horizontal distance of head or pelvis from its mean place.
        drift_mm: horizontal distance of the head from its target at the end.
        speed_mm_s: mean horizontal speed of the pelvis.
    """

    seconds: float
    fell: bool
    falls: int
    steps: int
    sway_mm: float
    drift_mm: float
    speed_mm_s: float

    def to_json(self) -> dict[str, object]:
        """The fields by name."""
        return asdict(self)


def evaluate_standing(
    bundle: Bundle,
    *,
    seconds: float = 60.0,
    noise: OdometryNoiseConfig | None = DEFAULT_NOISE,
    seed: int = 0,
) -> StandingReport:
    """Let the robot stand in its default pose with a still operator.

    Args:
        bundle: the student.
        seconds: how long.
        noise: Eq. 2's constants, or None for perfect odometry.
        seed: of the odometry noise.
    """
    model = build_model()
    frames = max(2, round(seconds / CONTROL_PERIOD) + 1)
    info = ClipInfo("stand", "stand", "standing pose", "", 1.0 / CONTROL_PERIOD)
    clip = clip_from_qpos(info, np.tile(standing_qpos(), (frames, 1)))
    reference = make_reference(clip, model)
    robot = SimulatedRobot(model)
    robot.reset(reference.qpos[0], reference.start_velocity)
    rng = np.random.default_rng(seed)
    trace, _ = run_clip(Episode(robot, bundle, noise, rng), reference)
    assert trace.contact is not None
    settle = min(round(SETTLE_SECONDS / CONTROL_PERIOD), len(trace.position) - 1)
    points, _ = key_point_poses(trace.position, trace.quat)
    pelvis = trace.position[:, g1.ROOT]
    both = np.stack((points[:, 0], pelvis), axis=1)[settle:]
    speed = np.linalg.norm(np.diff(pelvis[settle:, :2], axis=0), axis=1)
    mean_speed = float(speed.mean()) / CONTROL_PERIOD if len(speed) else 0.0
    return StandingReport(
        seconds=len(trace.position) * CONTROL_PERIOD,
        fell=trace.fell,
        falls=int(trace.fell),
        steps=metrics.count_steps(trace.contact),
        sway_mm=metrics.sway(both),
        drift_mm=metrics.measure(trace).drift_mm,
        speed_mm_s=1000.0 * mean_speed,
    )
