"""What a Unitree G1 (29 joints) is: joints, limits, motors, gains, key bodies.

Joints stand in Unitree's motor order 0-28 everywhere. Sources: joint names and limits
from the MJCF ``g1_29dof_rev_1_0`` that mjlab ships; motor armature, speed and effort
from mjlab's ``g1_constants.py`` (Unitree's motor data); gains from the same armature at
a natural frequency of 10 Hz with damping ratio 2 (BeyondMimic, arXiv 2508.08241).
A test compares this table with mjlab's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from openclone.errors import InputError

_NATURAL_FREQUENCY = 10.0 * 2.0 * math.pi
_DAMPING_RATIO = 2.0


@dataclass(frozen=True)
class Motor:
    """One motor type (or a linkage of two).

    Attributes:
        armature: reflected rotor inertia, kg m².
        max_torque: N m.
        max_speed: radians per second.
    """

    armature: float
    max_torque: float
    max_speed: float

    @property
    def kp(self) -> float:
        """Position gain, N m / rad."""
        return self.armature * _NATURAL_FREQUENCY**2

    @property
    def kd(self) -> float:
        """Velocity gain, N m s / rad."""
        return 2.0 * _DAMPING_RATIO * self.armature * _NATURAL_FREQUENCY


def _armature(rotors: tuple[float, ...], gears: tuple[float, ...]) -> float:
    """Inertia of a two-stage planetary gear's three rotors, seen at the output."""
    sun, middle, output = rotors
    first, second = gears
    return sun * (first * second) ** 2 + middle * second**2 + output


M5020 = Motor(
    _armature((0.139e-4, 0.017e-4, 0.169e-4), (1 + 46 / 18, 1 + 56 / 16)), 25, 37
)
M7520_14 = Motor(_armature((0.489e-4, 0.098e-4, 0.533e-4), (4.5, 1 + 48 / 22)), 88, 32)
M7520_22 = Motor(_armature((0.489e-4, 0.109e-4, 0.738e-4), (4.5, 5.0)), 139, 20)
M4010 = Motor(_armature((0.068e-4, 0.0, 0.0), (5.0, 5.0)), 5, 22)
M5020_PAIR = Motor(2 * M5020.armature, 50, 37)
"""Ankles, waist roll and pitch: a four-bar linkage driven by two motors."""


@dataclass(frozen=True)
class Joint:
    """One joint: name, range in radians, standing angle and motor."""

    name: str
    lower: float
    upper: float
    default: float
    motor: Motor


def _leg(side: str, inner: float, outer: float) -> tuple[Joint, ...]:
    return (
        Joint(f"{side}_hip_pitch_joint", -2.5307, 2.8798, -0.1, M7520_14),
        Joint(f"{side}_hip_roll_joint", inner, outer, 0.0, M7520_22),
        Joint(f"{side}_hip_yaw_joint", -2.7576, 2.7576, 0.0, M7520_14),
        Joint(f"{side}_knee_joint", -0.087267, 2.8798, 0.3, M7520_22),
        Joint(f"{side}_ankle_pitch_joint", -0.87267, 0.5236, -0.2, M5020_PAIR),
        Joint(f"{side}_ankle_roll_joint", -0.2618, 0.2618, 0.0, M5020_PAIR),
    )


def _arm(side: str, sign: float) -> tuple[Joint, ...]:
    low, high = (-1.5882, 2.2515) if sign > 0 else (-2.2515, 1.5882)
    return (
        Joint(f"{side}_shoulder_pitch_joint", -3.0892, 2.6704, 0.2, M5020),
        Joint(f"{side}_shoulder_roll_joint", low, high, 0.2 * sign, M5020),
        Joint(f"{side}_shoulder_yaw_joint", -2.618, 2.618, 0.0, M5020),
        Joint(f"{side}_elbow_joint", -1.0472, 2.0944, 0.6, M5020),
        Joint(f"{side}_wrist_roll_joint", -1.97222, 1.97222, 0.0, M5020),
        Joint(f"{side}_wrist_pitch_joint", -1.61443, 1.61443, 0.0, M4010),
        Joint(f"{side}_wrist_yaw_joint", -1.61443, 1.61443, 0.0, M4010),
    )


JOINTS: tuple[Joint, ...] = (
    *_leg("left", -0.5236, 2.9671),
    *_leg("right", -2.9671, 0.5236),
    Joint("waist_yaw_joint", -2.618, 2.618, 0.0, M7520_14),
    Joint("waist_roll_joint", -0.52, 0.52, 0.0, M5020_PAIR),
    Joint("waist_pitch_joint", -0.52, 0.52, 0.0, M5020_PAIR),
    *_arm("left", 1.0),
    *_arm("right", -1.0),
)
"""The 29 joints in Unitree's motor order. Standing angles: CLONE's legs (hip pitch
-0.1, knee 0.3, ankle -0.2) and mjlab's arms."""

NUM_JOINTS = len(JOINTS)
JOINT_NAMES = tuple(joint.name for joint in JOINTS)
LOWER_BODY = slice(0, 12)
"""The legs; the rest is waist and arms."""

JOINT_LOWER = np.array([joint.lower for joint in JOINTS])
JOINT_UPPER = np.array([joint.upper for joint in JOINTS])
DEFAULT_POSE = np.array([joint.default for joint in JOINTS])
KP = np.array([joint.motor.kp for joint in JOINTS])
KD = np.array([joint.motor.kd for joint in JOINTS])
ARMATURE = np.array([joint.motor.armature for joint in JOINTS])
MAX_TORQUE = np.array([float(joint.motor.max_torque) for joint in JOINTS])
MAX_SPEED = np.array([float(joint.motor.max_speed) for joint in JOINTS])
ACTION_SCALE = 0.25 * MAX_TORQUE / KP
"""Radians of joint target per unit of action (BeyondMimic)."""

STANDING_HEIGHT = 0.783675
"""Metres, pelvis above the ground with `DEFAULT_POSE` legs (mjlab's home keyframe)."""
HEAD_OFFSET = (0.0, 0.0, 0.4)
"""Metres; the head key point in the frame of ``torso_link``."""
HAND_OFFSET = (0.06, 0.0, 0.0)
"""Metres; a hand key point in the frame of ``*_wrist_yaw_link``."""
LIDAR_POSITION = (0.0002835, 0.00003, 0.428434)
LIDAR_RPY = (math.pi, 0.0511207, 0.0)
"""Mid-360 in the frame of ``torso_link``, metres and radians: mounted upside down."""

KEY_BODIES = (
    "pelvis",
    "left_hip_roll_link", "left_knee_link", "left_ankle_roll_link",
    "right_hip_roll_link", "right_knee_link", "right_ankle_roll_link",
    "torso_link",
    "left_shoulder_roll_link", "left_elbow_link", "left_wrist_yaw_link",
    "right_shoulder_roll_link", "right_elbow_link", "right_wrist_yaw_link",
)  # fmt: skip
"""Bodies whose poses are compared with the reference, in rewards and metrics."""
ROOT = KEY_BODIES.index("pelvis")
TORSO = KEY_BODIES.index("torso_link")
FEET = (
    KEY_BODIES.index("left_ankle_roll_link"),
    KEY_BODIES.index("right_ankle_roll_link"),
)
WRISTS = (
    KEY_BODIES.index("left_wrist_yaw_link"),
    KEY_BODIES.index("right_wrist_yaw_link"),
)


def joint_index(name: str) -> int:
    """Position of a joint in motor order.

    Raises:
        InputError: the G1 has no such joint.
    """
    try:
        return JOINT_NAMES.index(name)
    except ValueError:
        raise InputError(
            f"the G1 has no joint {name!r}",
            remedy="use a name from `openclone robot joints`, such as "
            + ", ".join(JOINT_NAMES[:3]),
        ) from None
