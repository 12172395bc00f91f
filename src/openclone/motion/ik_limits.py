"""What holds the inverse kinematics back: joint ranges, speeds, other links."""

from __future__ import annotations

import mink
import mujoco
import numpy as np

from openclone.motion.skeleton import SIDES
from openclone.robot import g1

_TRUNK = ("torso", "head", "pelvis")
_ARM = ("elbow_yaw", "wrist", "hand")
_LEG = ("hip", "thigh", "shin")
Pairs = list[tuple[list[str], list[str]]]
"""Groups of collision geoms; each of one group is kept apart from each of another."""


def _named(side: str, parts: tuple[str, ...]) -> list[str]:
    return [f"{side}_{part}_collision" for part in parts]


def arm_pairs() -> Pairs:
    """Arms with each other, the trunk, the legs and the floor."""
    trunk = [f"{part}_collision" for part in _TRUNK]
    legs = _named("left", _LEG) + _named("right", _LEG)
    left, right = _named("left", _ARM), _named("right", _ARM)
    upper = [f"{side}_shoulder_yaw_collision" for side in SIDES]
    return [
        (left + upper, right + upper),
        (left + right + upper, trunk + legs),
        # The hands of those who kneel and reach down.
        (["floor"], left + right),
    ]


def leg_pairs() -> Pairs:
    """Legs with each other, the trunk and the floor."""
    legs = _named("left", _LEG) + _named("right", _LEG)
    inner = (*_LEG, "linkage_brace")
    return [
        (["torso_collision"], legs),
        (_named("left", ("thigh", "shin", *inner[3:])), _named("right", inner[1:])),
        (["floor"], legs),
    ]


class Apart(mink.CollisionAvoidanceLimit):
    """Links keep ``clearance`` metres from each other.

    mink hands the solver a row for each pair of links; only those near each other
    are passed on.
    """

    def __init__(self, model: mujoco.MjModel, pairs: Pairs, clearance: float) -> None:
        # mink divides the allowed approach by the time step; ours is 1, so that the
        # gain is the share of the free distance used in one step.
        super().__init__(
            model,
            pairs,
            gain=0.5,
            minimum_distance_from_collisions=clearance,
            collision_detection_distance=0.08,
            # Negative: links that did get inside each other are driven apart.
            bound_relaxation=-0.001,
        )

    def compute_qp_inequalities(
        self, configuration: mink.Configuration, dt: float
    ) -> mink.Constraint:
        """``rows @ step <= room``, of the pairs that are near each other."""
        rows, room = super().compute_qp_inequalities(configuration, dt)
        assert rows is not None
        assert room is not None
        near = np.isfinite(room)
        return mink.Constraint(G=rows[near], h=room[near])


class FrameLimit(mink.Limit):
    """Joint ranges, and how far a joint may move between two frames.

    mink's own velocity limit bounds one solver step; with several steps a frame the
    solver would either lag or exceed the speed.
    """

    def __init__(self, lower: np.ndarray, upper: np.ndarray, reach: float) -> None:
        self._range = lower, upper
        self._reach = reach
        rows = np.concatenate((np.zeros((g1.NUM_JOINTS, 6)), np.eye(g1.NUM_JOINTS)), 1)
        self._rows = np.concatenate((rows, -rows))
        self.start(None)

    def start(self, joints: np.ndarray | None) -> None:
        """Begin a frame after ``joints (29,)``; None lifts the speed limit."""
        self._lower, self._upper = self._range
        if joints is not None:
            self._lower = np.maximum(self._lower, joints - self._reach)
            self._upper = np.minimum(self._upper, joints + self._reach)

    def compute_qp_inequalities(
        self, configuration: mink.Configuration, dt: float
    ) -> mink.Constraint:
        """``rows @ step <= room``."""
        joints = configuration.q[7:]
        room = np.concatenate((self._upper - joints, joints - self._lower))
        return mink.Constraint(G=self._rows, h=np.maximum(room, 0.0))
