"""An operator to replay, and the motion of the G1 that the operator means."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import numpy as np

    from openclone.evaluation.tracking import TrackingReport
    from openclone.motion.clip import Clip, ClipInfo
    from openclone.teleop.messages import OperatorRecording
    from openclone.teleop.session import SessionConfig, SessionResult


@dataclass(frozen=True)
class Performance:
    """An operator's recording and its meaning.

    Attributes:
        recording: head and wrists, operator's world.
        info: name and category of the motion.
        reference: (T, 36), the motion on the G1 at 50 Hz, in the robot's world; what
            metrics compare the robot with. None if the G1 cannot do it.
        config: settings that suit this operator.
    """

    recording: OperatorRecording
    info: ClipInfo
    reference: np.ndarray | None
    config: SessionConfig


def load_performance(
    path: Path, seconds: float | None, look: bool = False
) -> Performance:
    """Read a clip (.npz) or a human recording, which is retargeted for its metrics."""
    from openclone.teleop.loop import LoopConfig
    from openclone.teleop.operators.replay import ReplayConfig
    from openclone.teleop.session import SessionConfig
    from openclone.teleop.tracker import TrackerConfig

    tracker = TrackerConfig(look=look)
    # With a given length the operator stays at the end of the recording.
    replay = ReplayConfig(tail_s=1.0 if seconds is None else max(seconds, 1.0))
    if path.suffix == ".npz":
        from openclone.evaluation.operator import calibration_of_operator, operator_of
        from openclone.motion.clip import load_clip
        from openclone.robot.kinematics import Kinematics

        clip = load_clip(path)
        loop = LoopConfig(calibration_of_operator(), tracker)
        recording = operator_of(clip, Kinematics())
        config = SessionConfig(loop, replay)
        return Performance(recording, clip.info, _reference(clip), config)
    from openclone.evaluation.human_operator import operator_of_motion
    from openclone.motion.clip import ClipInfo
    from openclone.motion.library import read_recording
    from openclone.motion.retarget import CannotFollowError, retarget

    motion = read_recording(path)
    recording, calibration = operator_of_motion(motion)
    info = ClipInfo(path.stem, "transition", str(path), "unknown", motion.fps)
    try:
        reference = _reference(retarget(motion, info)[0])
    except CannotFollowError as error:
        print(f"no reference to measure against: {error}")
        reference = None
    config = SessionConfig(LoopConfig(calibration, tracker), replay)
    return Performance(recording, info, reference, config)


def _reference(clip: Clip) -> np.ndarray:
    """The clip at 50 Hz, placed where calibration places its operator."""
    from openclone.evaluation.programme import place_head
    from openclone.robot.kinematics import Kinematics
    from openclone.robot.model import CONTROL_PERIOD, standing_qpos

    kinematics = Kinematics()
    qpos = clip.resampled(1.0 / CONTROL_PERIOD).qpos
    head_xy = kinematics.key_points(standing_qpos())[0][0, :2].copy()
    return place_head(qpos, kinematics.bodies(qpos[0]), head_xy)


def measure_session(
    performance: Performance, result: SessionResult
) -> TrackingReport | None:
    """Compare the session with the motion that the operator meant.

    None if there is no reference, or if the session ended before the motion began.
    """
    from openclone.evaluation.programme import Part
    from openclone.evaluation.session import session_results
    from openclone.evaluation.tracking import TrackingReport
    from openclone.robot.kinematics import Kinematics

    info, reference = performance.info, performance.reference
    if reference is None:
        return None
    parts = (Part(info.name, info.category, 0, len(reference)),)
    results = session_results(result, reference, parts, Kinematics())
    return TrackingReport(results) if results else None
