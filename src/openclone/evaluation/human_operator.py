"""A recorded human as an operator, with the measures that only a recording tells.

A headset sees three points. A recording knows the whole skeleton, so the replayed
operator can be calibrated as retargeting does it: from the ground up, along the chest's
heading, with ways scaled by the length of the legs. Then the session and the retargeted
motion beside it mean the same thing.
"""

from __future__ import annotations

import math

from openclone.motion.contacts import ground_level, level_ground
from openclone.motion.proportions import SHANK, THIGH
from openclone.motion.skeleton import HumanMotion, operator_points
from openclone.spatial import rotations
from openclone.teleop.calibration import (
    BodyProportions,
    CalibrationConfig,
    measure_operator,
)
from openclone.teleop.messages import OperatorRecording, recording_at_rate

_TOE_HEIGHT = 0.03
"""Metres; the toe joint of a standing foot above the floor."""


def operator_of_motion(
    motion: HumanMotion,
) -> tuple[OperatorRecording, CalibrationConfig]:
    """Head and wrists of ``motion`` above a floor at z = 0, and their calibration."""
    motion = level_ground(motion)
    positions, quats = operator_points(motion)
    positions = positions.copy()
    positions[..., 2] -= ground_level(motion, "toe") - _TOE_HEIGHT
    calibration = CalibrationConfig(
        operator=measure_operator(positions, quats, BodyProportions()),
        heading_deg=math.degrees(float(rotations.yaw(motion.orientation("chest")[0]))),
        travel_scale=(THIGH + SHANK) / motion.leg_length,
    )
    return recording_at_rate(motion.name, motion.fps, positions, quats), calibration
