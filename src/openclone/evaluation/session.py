"""What a teleoperation session achieved, beside the motion the operator meant.

Unlike `tracking`, everything counts here: operator's frame rate, filters, ramp, delay.
"""

from __future__ import annotations

import numpy as np

from openclone.evaluation.metrics import Trace
from openclone.evaluation.programme import Part
from openclone.evaluation.tracking import ClipResult, clip_result
from openclone.robot.kinematics import Kinematics
from openclone.robot.model import CONTROL_PERIOD
from openclone.spatial import rotations
from openclone.teleop.messages import Phase
from openclone.teleop.session import SessionResult


def reference_at(qpos: np.ndarray, time_s: np.ndarray) -> np.ndarray:
    """The motion ``qpos (T, 36)`` at 50 Hz, sampled at ``time_s (n,)``, seconds."""
    frame = np.clip(time_s / CONTROL_PERIOD, 0, len(qpos) - 1)
    low = np.minimum(frame.astype(int), len(qpos) - 2)
    part = (frame - low)[:, None]
    sampled = qpos[low] * (1 - part) + qpos[low + 1] * part
    quat = rotations.slerp(qpos[low, 3:7], qpos[low + 1, 3:7], part[:, 0])
    return np.concatenate((sampled[:, :3], quat, sampled[:, 7:]), axis=1)


def session_results(
    result: SessionResult,
    reference_qpos: np.ndarray,
    parts: tuple[Part, ...],
    kinematics: Kinematics,
) -> dict[str, ClipResult]:
    """Metrics of each part of the programme that the session reached.

    Lead-in and tail, in which the operator stands still, count for no part. The part
    in which the robot falls, or the safety machine lets it go, ends there and fails.

    Args:
        result: the session.
        reference_qpos: (T, 36), the programme at 50 Hz in the robot's world.
        parts: its clips.
        kinematics: of the G1.
    """
    shown_s = result.recording_time_s
    end_s = (len(reference_qpos) - 1) * CONTROL_PERIOD
    reference = reference_at(reference_qpos, shown_s)
    log = result.log
    failed = log.fallen | (log.phase == Phase.DAMPING)
    stop = int(np.argmax(failed)) if failed.any() else log.num_ticks
    # A failure in the tail counts for the part before it.
    stop_s = min(shown_s[stop], end_s - CONTROL_PERIOD) if failed.any() else np.inf
    began = shown_s > 0.0
    if stop_s <= 0.0:
        began = shown_s >= 0.0  # failed before the operator moved: that must count
    moving = began & (shown_s < end_s) & (np.arange(len(shown_s)) <= stop)
    results = {}
    for part in parts:
        first_s, last_s = part.first * CONTROL_PERIOD, part.last * CONTROL_PERIOD
        ticks = np.flatnonzero(moving & (shown_s >= first_s) & (shown_s < last_s))
        if len(ticks) < 2:
            continue
        position, quat = kinematics.trajectory(log.qpos[ticks])
        wanted, wanted_quat = kinematics.trajectory(reference[ticks])
        fell = bool(first_s <= stop_s < last_s)
        trace = Trace(CONTROL_PERIOD, position, quat, wanted, wanted_quat, None, fell)
        results[part.name] = clip_result(
            part.category, trace, log.qpos[ticks], reference[ticks]
        )
    return results
