"""A robot limb as a chain of hinges: forward and inverse kinematics over many frames.

The geometry is read from the MuJoCo model, with its tilted and offset axes, so the
result agrees with MuJoCo to rounding. All functions work on a batch of frames at once.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np

from openclone.robot import g1
from openclone.spatial import rotations

_DAMPING = 1e-5
_MAX_STEP = 0.4
"""Radians per iteration and joint; keeps Newton's method near its linearization."""


@dataclass(frozen=True)
class ChainPose:
    """Where the parts of a chain are, in the frame of its base.

    Attributes:
        pivots: (B, n, 3), metres: a point on each hinge axis.
        axes: (B, n, 3): unit hinge axes.
        position: (B, 3), metres: the tip.
        rotation: (B, 3, 3): base from tip.
    """

    pivots: np.ndarray
    axes: np.ndarray
    position: np.ndarray
    rotation: np.ndarray

    def jacobian(self) -> np.ndarray:
        """(B, 6, n): tip velocity, then angular velocity, per joint speed."""
        lever = self.position[:, None] - self.pivots
        linear = np.cross(self.axes, lever)
        return np.concatenate((linear, self.axes), axis=2).swapaxes(1, 2)


@dataclass(frozen=True)
class SerialChain:
    """The hinges between a base body and a tip body.

    Attributes:
        joints: (n,) indices of the hinges in motor order.
        offsets: (n, 3), metres: body positions in their parents.
        turns: (n, 3, 3): body rotations in their parents at zero angle.
        axes: (n, 3): hinge axes in their bodies.
        tip: (3,), metres: the tip in the last body.
    """

    joints: np.ndarray
    offsets: np.ndarray
    turns: np.ndarray
    axes: np.ndarray
    tip: np.ndarray

    @staticmethod
    def of(
        model: mujoco.MjModel, base: str, end: str, tip: tuple[float, float, float]
    ) -> SerialChain:
        """Read the chain from body ``base`` to body ``end`` (each body one hinge)."""
        bodies = []
        body = model.body(end).id
        while body != model.body(base).id:
            bodies.insert(0, body)
            body = int(model.body_parentid[body])
        hinges = [int(model.body_jntadr[body]) for body in bodies]
        names = [model.joint(hinge).name for hinge in hinges]
        return SerialChain(
            np.array([g1.joint_index(name) for name in names]),
            model.body_pos[bodies].copy(),
            rotations.to_matrix(model.body_quat[bodies]),
            model.jnt_axis[hinges].copy(),
            np.array(tip),
        )

    @property
    def lower(self) -> np.ndarray:
        """(n,) lower joint limits, radians."""
        return g1.JOINT_LOWER[self.joints]

    @property
    def upper(self) -> np.ndarray:
        """(n,) upper joint limits, radians."""
        return g1.JOINT_UPPER[self.joints]

    def forward(self, angles: np.ndarray) -> ChainPose:
        """Pose of the chain for ``angles (B, n)``, radians."""
        count = len(angles)
        position = np.zeros((count, 3))
        rotation = np.broadcast_to(np.eye(3), (count, 3, 3))
        pivots, axes = [], []
        for index in range(len(self.joints)):
            position = position + rotation @ self.offsets[index]
            rotation = rotation @ self.turns[index]
            axis = self.axes[index]
            pivots.append(position)
            axes.append(rotation @ axis)
            turn = rotations.from_axis_angle(axis, angles[:, index])
            rotation = rotation @ rotations.to_matrix(turn)
        tip = position + rotation @ self.tip
        return ChainPose(np.stack(pivots, 1), np.stack(axes, 1), tip, rotation)

    def reach_pose(
        self,
        position: np.ndarray,
        rotation: np.ndarray,
        start: np.ndarray,
        iterations: int = 12,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Joint angles that put the tip at a full pose, by damped Newton steps.

        Args:
            position: (B, 3), metres, base frame.
            rotation: (B, 3, 3), base from tip.
            start: (B, n), radians, first guess.
            iterations: upper bound on steps.

        Returns:
            Angles ``(B, n)`` and the remaining position error ``(B,)``, metres.
        """
        angles = start.copy()
        eye = _DAMPING * np.eye(len(self.joints))
        for _ in range(iterations):
            pose = self.forward(angles)
            linear = position - pose.position
            quat = rotations.from_matrix(rotation @ pose.rotation.swapaxes(1, 2))
            error = np.concatenate((linear, rotations.to_rotation_vector(quat)), 1)
            if np.abs(error).max() < 1e-6:
                break
            jacobian = pose.jacobian()
            transposed = jacobian.swapaxes(1, 2)
            step = np.linalg.solve(
                transposed @ jacobian + eye, transposed @ error[..., None]
            )
            angles = angles + np.clip(step[..., 0], -_MAX_STEP, _MAX_STEP)
        distance = np.linalg.norm(position - self.forward(angles).position, axis=1)
        return angles, distance

    def reach_point(self, position: np.ndarray, rest: np.ndarray) -> np.ndarray:
        """Angles ``(n,)`` that bring the tip to a point and stay near a rest pose.

        Args:
            position: (3,), metres, base frame.
            rest: (n,), radians; spare freedom relaxes towards it.
        """
        angles = rest.copy()
        for _ in range(60):
            pose = self.forward(angles[None])
            jacobian = pose.jacobian()[0, :3]
            inverse = jacobian.T @ np.linalg.inv(
                jacobian @ jacobian.T + 1e-3 * np.eye(3)
            )
            towards = inverse @ (position - pose.position[0])
            spare = 0.1 * (rest - angles)
            step = towards + spare - inverse @ (jacobian @ spare)
            angles = angles + np.clip(step, -0.2, 0.2)
            angles = np.clip(angles, self.lower + 0.1, self.upper - 0.1)
        return angles
