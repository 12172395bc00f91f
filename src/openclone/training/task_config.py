"""Settings of the tracking task."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Literal

from openclone.training.randomization import TABLE_A2, RandomizationConfig
from openclone.training.reward_table import FAST, RewardWeights

Guidance = Literal["pose", "arms", "springs", "angles", "feedforward"]
"""Joint targets that need no learning: the default pose, as for the student; the same,
but arms as in feedforward; that with springs from the robot's legs to the reference's;
the reference's angles; those that also give the reference's
torques."""
View = Literal["reference", "command", "legs"]
"""What the teacher sees of the motion: all of it; head and hands as the student does;
or these and the legs. The critic sees all of it."""


@dataclass(frozen=True)
class TerminationLimits:
    """When an episode ends early.

    Attributes:
        height: metres, torso height error (BeyondMimic: 0.25).
        angle: radians, torso orientation error (BeyondMimic: 0.8).
        end_effector: metres, height error of wrists and ankles; inf: off.
        distance: metres, mean distance of head and hands (section 4.1: 1.5).
    """

    height: float = 0.25
    angle: float = 0.8
    end_effector: float = 0.25
    distance: float = 0.8


@dataclass(frozen=True)
class TaskConfig:
    """Settings of the tracking task.

    Attributes:
        num_envs: robots simulated together.
        episode_steps: control steps until an episode is cut.
        limits: early termination.
        weights: reward weights.
        failure_share: share of resets drawn by failure rate; see `StartFrames`.
        run_up: control steps before the chosen place at which episodes may begin: a
            robot comes to it as it then is, late perhaps, and not as the reference.
        recorded_weight: how many times more often than synthetic motions the rest
            draws those made from recordings, per second of motion.
        displaced_share: share of resets away from the reference (Table A2, born
            distance and heading).
        born_distance: metres, largest displacement.
        born_heading: radians, largest heading offset.
        born_by_area: draw displacements evenly over the disc instead of evenly in
            distance (Table A2), which puts more robots near the reference.
        standing_share: share of resets in the standing pose at the reference's place.
        push_interval: seconds between pushes on average (Table A2: 5).
        push_speed: m/s, largest horizontal push (Table A2: 1.5).
        lead_frames: control steps by which the place of the observed reference runs
            ahead of the rewarded one. A policy that sees a moving target and its
            velocity follows it at a distance (0.18 s measured); this takes it away.
        preview: control steps ahead at which the teacher also sees the reference; the
            paper's teacher sees the next step alone.
        look_share: share of episodes in which the head's orientation is commanded;
            the paper's student (section 3.1) is never told it.
        guidance: what the teacher's action is an offset to.
        view: what the teacher sees of the motion.
        randomization: the other rows of Table A2.
    """

    num_envs: int = 256
    episode_steps: int = 500
    limits: TerminationLimits = field(default_factory=TerminationLimits)
    weights: RewardWeights = FAST
    failure_share: float = 0.7
    run_up: int = 25
    recorded_weight: float = 1.0
    displaced_share: float = 0.1
    born_distance: float = 0.3
    born_heading: float = 0.35
    standing_share: float = 0.0
    push_interval: float = 5.0
    push_speed: float = 0.5
    lead_frames: int = 10
    look_share: float = 0.7
    guidance: Guidance = "feedforward"
    view: View = "reference"
    preview: tuple[int, ...] = (5, 10, 20, 40)
    born_by_area: bool = True
    randomization: RandomizationConfig = field(default_factory=RandomizationConfig)


TABLE_A2_TASK = TaskConfig(
    displaced_share=1.0,
    born_distance=2.0,
    born_heading=math.radians(20.0),
    born_by_area=False,
    push_interval=5.0,
    push_speed=1.5,
    randomization=TABLE_A2,
)
"""Every row of Table A2 as printed."""
