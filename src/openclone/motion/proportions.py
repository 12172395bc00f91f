"""The G1's proportions as the retargeting sees them, and its settings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from openclone.robot.model import SOLE_Z

FPS = 50.0
THIGH, SHANK, UPPER_ARM, FOREARM = 0.306, 0.318, 0.185, 0.184
"""Metres; limb lengths of the G1, hip to knee to ankle, shoulder to elbow to wrist."""
HIP_HEIGHT = -0.133
HIP_HALF_WIDTH = 0.1165
"""Metres; hip centres in the pelvis frame."""
SHOULDER = np.array([0.004, 0.1468, 0.245])
"""Metres; left shoulder centre in the frame of ``torso_link``."""
TORSO = np.array([-0.004, 0.0, 0.044])
"""Metres; origin of ``torso_link`` in the pelvis frame, waist straight."""
ANKLE_HEIGHT = -SOLE_Z


@dataclass(frozen=True)
class RetargetConfig:
    """Weights and limits of the retargeting.

    Attributes:
        crouch: share of the straight leg used at the human's full height; keeps the
            knees off their singular straight pose.
        min_knee: radians, smallest bend of a knee.
        max_ankle: radians, largest bend of an ankle, toes towards the shin.
        lowest_pelvis: metres; the ankles allow no deeper squat on flat feet.
        smooth_s: seconds, width of the Gaussian over the targets.
        max_joint_speed: radians per second.
        clearance: metres that links keep from each other.
        swing_clearance: metres that the sole of a stepping foot rises; the scaled
            human foot, whose toes bend, would drag the robot's stiff sole.
        least_width: metres between the feet across the heading; 0: they may come as
            near as they like, but not cross.
        most_shift: metres that the centre of mass moves aside for balance; 0: off.
        solves: IK steps per frame, at most.
        first_solves: IK steps for the first frame.
        converged: radians; smaller steps end a frame early.
    """

    crouch: float = 0.97
    min_knee: float = 0.08
    max_ankle: float = 0.8
    lowest_pelvis: float = 0.38
    smooth_s: float = 0.03
    max_joint_speed: float = 15.0
    clearance: float = 0.005
    swing_clearance: float = 0.05
    least_width: float = 0.16
    most_shift: float = 0.15
    solves: int = 4
    first_solves: int = 120
    converged: float = 0.002
