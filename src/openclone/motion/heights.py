"""Head-height edits (Fig. 3): the same motion, lower, with the feet where they were."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from openclone.motion.clip import Clip, clip_from_qpos
from openclone.motion.contacts import smooth
from openclone.motion.planted import EditRefused, feet_of, replanted
from openclone.motion.soundness import check_edit
from openclone.motion.sources.elbow_room import LEFT_ROLL, RIGHT_ROLL, spread
from openclone.motion.sources.track import minimum_jerk
from openclone.motion.sources.whole_body import centre_of_mass
from openclone.robot import g1
from openclone.robot.kinematics import Kinematics
from openclone.spatial import rotations

FIG_3_HEIGHTS = (1.2, 1.1, 1.0, 0.9, 0.8, 0.7, 0.6)
"""Metres of the head above the ground: standing to deep squatting (section 4)."""
_WAIST_PITCH = 21
SHOULDER_PITCH = (22, 29)
"""Columns of qpos."""
_PELVIS_SHARE = 0.6
"""Share of the lean that the hips take; the waist takes the rest."""
_PASSES = 8
VERSION = 1
"""Raise when the output changes: cached clips of older versions are made again."""
_SHORT_S = 4.0


@dataclass(frozen=True)
class HeightConfig:
    """How a body goes down.

    Attributes:
        approach_s: seconds from the motion's own height to the wanted one; 0 is there
            from the first frame.
        lean: radians that the trunk bends at 0.6 m below standing.
        bend: exponent of the lean over the depth; below 1 the trunk bends early.
    """

    approach_s: float = 0.0
    lean: float = 1.05
    bend: float = 0.7


@cache
def _kinematics() -> Kinematics:
    return Kinematics()


def head_heights(qpos: np.ndarray) -> np.ndarray:
    """(T,) height of the head key point, metres, for ``qpos (T, 36)``."""
    return np.array([_kinematics().key_points(row)[0][0, 2] for row in qpos])


def _pitched(quat: np.ndarray, pitch: np.ndarray) -> np.ndarray:
    """``quat (T, 4)`` with the body leaning forward by ``pitch (T,)`` radians more.

    The lean is about the body's own left, kept level.
    """
    heading = rotations.heading(quat)
    axis = rotations.rotate(heading, np.tile([0.0, 1.0, 0.0], (len(quat), 1)))
    return rotations.multiply(
        rotations.from_rotation_vector(axis * pitch[:, None]), quat
    )


def _lowered(qpos: np.ndarray, drop: np.ndarray, lean: np.ndarray) -> np.ndarray:
    """The pelvis ``drop (T,)`` metres lower, the trunk ``lean (T,)`` radians ahead."""
    low = qpos.copy()
    low[:, 2] -= drop
    low[:, 3:7] = _pitched(qpos[:, 3:7], _PELVIS_SHARE * lean)
    waist = low[:, _WAIST_PITCH] + (1.0 - _PELVIS_SHARE) * lean
    limits = g1.JOINT_LOWER[14] + 0.02, g1.JOINT_UPPER[14] - 0.02
    low[:, _WAIST_PITCH] = np.clip(waist, *limits)
    for column in SHOULDER_PITCH:
        # The arms keep their direction in the world: hanging arms go on hanging.
        low[:, column] -= lean
    upper = slice(19, 36)
    low[:, upper] = np.clip(
        low[:, upper], g1.JOINT_LOWER[12:] + 0.01, g1.JOINT_UPPER[12:] - 0.01
    )
    return low


def lowered_name(name: str, height: float) -> str:
    """Name of the clip ``name`` with the head at ``height`` metres."""
    return f"{name}~head{round(100 * height):03d}"


def with_head_height(
    clip: Clip, height: float, config: HeightConfig | None = None
) -> Clip:
    """``clip`` with the head at ``height`` metres (its median), feet planted.

    The head keeps its own ups and downs about the new height. Hips and waist bend
    the trunk forward as the body sinks, and the centre of mass stays above the same
    points of the ground.

    Raises:
        EditRefused: the legs cannot, or the result is not clean; says why.
    """
    config = config or HeightConfig()
    heads = head_heights(clip.qpos)
    weight = np.ones(clip.num_frames)
    if config.approach_s > 0:
        weight = minimum_jerk(
            np.arange(clip.num_frames) / (config.approach_s * clip.info.fps)
        )
    settled = heads[weight > 0.999]
    if not len(settled):
        raise EditRefused(
            f"the approach of {config.approach_s:g} s is longer than the clip",
            reason="too short",
            where=clip.info.name,
            remedy="choose a shorter one",
        )
    wanted = heads + weight * (height - float(np.median(settled)))
    name = lowered_name(clip.info.name, height)
    qpos = _at_heights(clip, heads, wanted, config, name)
    info = replace(clip.info, name=name, category=_category(clip, heads, height))
    edited = clip_from_qpos(info, qpos)
    check_edit(edited, (clip,))
    return edited


def gone_down(clip: Clip, height: float) -> Clip:
    """``clip`` going down at its beginning until the head is at ``height`` metres.

    Raises:
        EditRefused: see `with_head_height`.
    """
    approach_s = 0.9 if clip.seconds < _SHORT_S else 1.2
    return with_head_height(clip, height, HeightConfig(approach_s=approach_s))


def _category(clip: Clip, heads: np.ndarray, height: float) -> str:
    """What the lowered motion shows: squatting, or walking in a crouch."""
    if height > 0.93 * float(np.median(heads)):
        return clip.info.category
    travelled = np.ptp(clip.root_position[:, :2], axis=0).max()
    return "crouchwalk" if travelled > 0.5 else "squat"


def height_series(
    clip: Clip, heights: tuple[float, ...] = FIG_3_HEIGHTS
) -> tuple[list[Clip], list[str]]:
    """``clip`` at each of ``heights``, and why the missing ones were refused."""
    clips, refusals = [], []
    for height in heights:
        try:
            clips.append(with_head_height(clip, height))
        except EditRefused as refusal:
            refusals.append(str(refusal))
    return clips, refusals


def _at_heights(
    clip: Clip, heads: np.ndarray, wanted: np.ndarray, config: HeightConfig, what: str
) -> np.ndarray:
    """Positions whose head is ``wanted (T,)`` metres high."""
    qpos, feet = clip.qpos, feet_of(clip.qpos)
    depth = smooth(np.clip(heads - wanted, 0.0, None), 0.1 * clip.info.fps)
    lean = config.lean * (depth / 0.6) ** config.bend
    drop = heads - wanted
    for _ in range(_PASSES):
        low = _lowered(qpos, drop, lean)
        drop = drop + head_heights(low) - wanted
    low = _lowered(qpos, drop, lean)
    com_xy = centre_of_mass(qpos)[:, :2]
    low = replanted(low, feet, com_xy, what=what)
    offset = spread(low)
    if offset.any():
        low[:, LEFT_ROLL] += offset[:, 0]
        low[:, RIGHT_ROLL] -= offset[:, 1]
        low[:, 19:] = np.clip(low[:, 19:], g1.JOINT_LOWER[12:], g1.JOINT_UPPER[12:])
        low = replanted(low, feet, com_xy, what=what)
    return low
