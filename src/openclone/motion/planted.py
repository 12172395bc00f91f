"""Feet that stay where they were while the rest of the body is edited.

Every edit of the pelvis or the upper body ends here: the legs are solved again so that
both soles keep the poses they had, and the pelvis moves aside so that the centre of
mass stays where it was, because that is what keeps the robot on its feet.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import mujoco
import numpy as np

from openclone.errors import InputError
from openclone.motion.sources.serial_chain import SerialChain
from openclone.motion.sources.whole_body import centre_of_mass, g1_model
from openclone.robot import g1
from openclone.robot.model import SOLE_CORNERS
from openclone.spatial import rotations

SIDES = ("left", "right")
_FEET = tuple(f"{side}_ankle_roll_link" for side in SIDES)
_REACH_TOLERANCE = 0.008
"""Metres by which an ankle may miss its place after the joints met their limits."""
_COM_GAIN = 1.3
"""Metres of pelvis per metre of centre of mass: the feet stay where they are."""
_COM_PASSES = 3
_LIFTED = 0.02
"""Metres; a sole that is higher is in the air."""
_MOVING = 0.15
"""Metres per second; a foot that is faster does not stand."""


class EditRefused(InputError):
    """An edit would not give a motion that the robot can carry out; says why.

    ``reason`` is the kind of fault, without numbers, for counting.
    """

    def __init__(
        self, what: str, *, reason: str, where: str = "", remedy: str = ""
    ) -> None:
        """See `InputError`; ``reason`` in two or three words."""
        super().__init__(what, where=where, remedy=remedy)
        self.reason = reason


@dataclass(frozen=True)
class Feet:
    """Poses of both feet (``*_ankle_roll_link``) over T frames, world.

    Attributes:
        position: (T, 2, 3), metres.
        quat: (T, 2, 4), wxyz.
    """

    position: np.ndarray
    quat: np.ndarray

    def lowest(self) -> np.ndarray:
        """(T, 2) height of each sole's lowest corner, metres."""
        return self.corners()[..., 2].min(axis=2)

    def corners(self) -> np.ndarray:
        """(T, 2, 4, 3) corners of the soles, metres, world."""
        turned = rotations.rotate(self.quat[:, :, None], SOLE_CORNERS)
        return self.position[:, :, None] + turned

    def standing(self, fps: float) -> np.ndarray:
        """(T, 2) whether each foot stands: low and hardly moving."""
        step = np.gradient(self.position[..., :2], 1.0 / fps, axis=0)
        slow = np.linalg.norm(step, axis=-1) < _MOVING
        return (self.lowest() < _LIFTED) & slow


def feet_of(qpos: np.ndarray) -> Feet:
    """The feet of the motion ``qpos (T, 36)``."""
    model = g1_model()
    data = mujoco.MjData(model)
    bodies = [model.body(name).id for name in _FEET]
    position = np.empty((len(qpos), 2, 3))
    quat = np.empty((len(qpos), 2, 4))
    for frame, row in enumerate(qpos):
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        position[frame], quat[frame] = data.xpos[bodies], data.xquat[bodies]
    return Feet(position, quat)


@cache
def _leg(side: int) -> SerialChain:
    return SerialChain.of(g1_model(), "pelvis", _FEET[side], (0.0, 0.0, 0.0))


def _solved_legs(qpos: np.ndarray, feet: Feet) -> np.ndarray:
    """Leg angles ``(T, 12)``, within their limits, that come nearest to ``feet``."""
    root, pelvis = qpos[:, :3], qpos[:, 3:7]
    angles = qpos[:, 7:19].copy()
    for side in range(2):
        local = rotations.rotate_inverse(pelvis, feet.position[:, side] - root)
        turn = rotations.multiply(rotations.conjugate(pelvis), feet.quat[:, side])
        columns = slice(6 * side, 6 * side + 6)
        found, _ = _leg(side).reach_pose(
            local, rotations.to_matrix(turn), angles[:, columns], 20
        )
        angles[:, columns] = found
    return np.clip(angles, g1.JOINT_LOWER[:12], g1.JOINT_UPPER[:12])


def replanted(
    qpos: np.ndarray, feet: Feet, com_xy: np.ndarray | None = None, *, what: str
) -> np.ndarray:
    """``qpos (T, 36)`` with legs that put the feet where they belong.

    Args:
        qpos: the edited motion; its leg angles are the first guess.
        feet: where the feet have to be.
        com_xy: (T, 2), metres, world: the pelvis moves until the centre of mass is
            above; None leaves the pelvis alone.
        what: names the motion and the edit in the refusal.

    Raises:
        EditRefused: a leg cannot reach.
    """
    qpos = qpos.copy()
    qpos[:, 7:19] = _solved_legs(qpos, feet)
    for _ in range(_COM_PASSES if com_xy is not None else 0):
        qpos[:, :2] += _COM_GAIN * (com_xy - centre_of_mass(qpos)[:, :2])
        qpos[:, 7:19] = _solved_legs(qpos, feet)
    miss = np.linalg.norm(feet_of(qpos).position - feet.position, axis=-1)
    frame, side = np.unravel_index(int(np.argmax(miss)), miss.shape)
    if miss[frame, side] > _REACH_TOLERANCE:
        raise EditRefused(
            f"the {SIDES[side]} leg cannot keep its foot in place, in frame {frame} "
            f"it is {1000 * miss[frame, side]:.0f} mm off ({_at_limit(qpos[frame])})",
            reason="out of reach",
            where=what,
            remedy="edit less, or choose a motion with shorter steps",
        )
    return qpos


def _at_limit(row: np.ndarray) -> str:
    """Which leg joints of ``row (36,)`` are at a limit."""
    legs = row[7:19]
    near = (legs < g1.JOINT_LOWER[:12] + 1e-3) | (legs > g1.JOINT_UPPER[:12] - 1e-3)
    names = [g1.JOINT_NAMES[index] for index in np.flatnonzero(near)]
    return "at its limit: " + ", ".join(names) if names else "the leg is too short"
