"""One motion after another without a seam: continuous transitions between clips.

The second clip is moved and turned to where the first one ends. What still differs
(pose and velocity) is carried over and fades out while the second clip plays. Feet do
not fade: a foot keeps its place on the ground until the second clip lifts it, and only
in the air it moves over to the place that the second clip gives it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from openclone.motion.clip import Clip, clip_from_qpos
from openclone.motion.planted import EditRefused, Feet, feet_of, replanted
from openclone.motion.soundness import check_edit
from openclone.motion.sources.track import minimum_jerk
from openclone.spatial import rotations


@dataclass(frozen=True)
class BlendConfig:
    """How two clips are joined.

    Attributes:
        seconds: in which pose and velocity go over.
        max_step: metres by which a foot's place may differ between the clips.
        max_twist_deg: the same for its direction.
    """

    seconds: float = 0.8
    max_step: float = 0.15
    max_twist_deg: float = 25.0


def _between_feet(feet: Feet, frame: int) -> tuple[np.ndarray, float]:
    """Middle of the feet (2,), metres, and their mean yaw, radians."""
    yaws = rotations.yaw(feet.quat[frame])
    mean = yaws[0] + 0.5 * rotations.wrap_angle(yaws[1] - yaws[0])
    return feet.position[frame, :, :2].mean(axis=0), float(mean)


def moved(qpos: np.ndarray, shift: np.ndarray, yaw: float) -> np.ndarray:
    """``qpos (T, 36)`` turned by ``yaw`` about the origin, then shifted ``(2,)``."""
    turn = rotations.from_yaw(np.full(len(qpos), yaw))
    out = qpos.copy()
    out[:, :3] = rotations.rotate(turn, qpos[:, :3])
    out[:, :2] += shift
    out[:, 3:7] = rotations.multiply(turn, qpos[:, 3:7])
    return out


def _aligned(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """``second`` placed so that its first frame's feet are at ``first``'s last."""
    there, yaw_there = _between_feet(feet_of(first[-1:]), 0)
    here, yaw_here = _between_feet(feet_of(second[:1]), 0)
    yaw = yaw_there - yaw_here
    turned = moved(second, np.zeros(2), yaw)
    here, _ = _between_feet(feet_of(turned[:1]), 0)
    return moved(turned, there - here, 0.0)


def _fading(
    offset: np.ndarray, rate: np.ndarray, frames: int, fps: float
) -> np.ndarray:
    """(frames, n) from ``offset`` with speed ``rate`` (n,) to rest at zero.

    Quintic: position, velocity and acceleration are continuous at both ends.
    """
    seconds = frames / fps
    s = (np.arange(frames) / frames)[:, None]
    still = 1.0 - minimum_jerk(s)
    pulse = s * (1.0 - s) ** 3 * (1.0 + 3.0 * s)
    return offset * still + rate * seconds * pulse


def _faded_pose(
    first: np.ndarray, second: np.ndarray, fps: float, frames: int
) -> np.ndarray:
    """``second`` (T, 36) that starts in the pose and at the speed of ``first``."""
    out = second.copy()
    count = min(frames, len(second))
    plain = np.r_[0:3, 7:36]
    offset = first[-1, plain] - second[0, plain]
    rate = (first[-1, plain] - first[-2, plain]) - (second[1, plain] - second[0, plain])
    out[:count, plain] += _fading(offset, rate * fps, frames, fps)[:count]
    turn = rotations.multiply(first[-1, 3:7], rotations.conjugate(second[0, 3:7]))
    spin = rotations.to_rotation_vector(turn)
    still = _fading(spin, np.zeros(3), frames, fps)[:count]
    out[:count, 3:7] = rotations.multiply(
        rotations.from_rotation_vector(still), second[:count, 3:7]
    )
    return out


def _planted_feet(
    feet: Feet, start: Feet, fps: float, name: str, config: BlendConfig
) -> Feet:
    """``feet`` (T) that stand where ``start`` (one frame) has them until lifted."""
    position, quat = feet.position.copy(), feet.quat.copy()
    standing = feet.standing(fps)
    for side in range(2):
        offset = start.position[0, side] - feet.position[0, side]
        twist = rotations.wrap_angle(
            rotations.yaw(start.quat[0, side]) - rotations.yaw(feet.quat[0, side])
        )
        if (
            np.linalg.norm(offset[:2]) > config.max_step
            or abs(np.degrees(twist)) > config.max_twist_deg
        ):
            raise EditRefused(
                f"a foot stands {100 * np.linalg.norm(offset[:2]):.0f} cm and "
                f"{abs(np.degrees(twist)):.0f} deg elsewhere in the second clip",
                reason="other stance",
                where=name,
                remedy="join clips that end and start in similar stances",
            )
        share = _kept_share(standing[:, side])
        position[:, side, :2] += share[:, None] * offset[:2]
        turn = rotations.from_yaw(share * twist)
        quat[:, side] = rotations.multiply(turn, quat[:, side])
    return Feet(position, quat)


def _kept_share(standing: np.ndarray) -> np.ndarray:
    """(T,) 1 until the foot is first in the air, 0 after that flight."""
    air = np.flatnonzero(~standing)
    if not len(air):
        return np.ones(len(standing))
    landed = np.flatnonzero(standing[air[0] :])
    stop = air[0] + (int(landed[0]) if len(landed) else len(standing) - air[0])
    phase = (np.arange(len(standing)) - air[0]) / max(stop - air[0], 1)
    return 1.0 - minimum_jerk(phase)


def joined(first: Clip, second: Clip, config: BlendConfig | None = None) -> Clip:
    """``first``, then ``second`` where ``first`` ends, in one continuous motion.

    Raises:
        EditRefused: a foot stands elsewhere, is in the air at the seam, or the legs
            cannot follow.
    """
    config = config or BlendConfig()
    fps = first.info.fps
    name = f"{first.info.name}~then~{second.info.name.replace('/', '_')}"
    before = first.qpos
    after = _aligned(before, second.resampled(fps).qpos)
    frames = max(round(config.seconds * fps), 2)
    start, feet = feet_of(before[-1:]), feet_of(after)
    if start.lowest().max() > 0.02 or feet.lowest()[0].max() > 0.02:
        raise EditRefused(
            "a foot is in the air where the clips meet",
            reason="foot in the air",
            where=name,
            remedy="cut the clips where both feet stand",
        )
    planted = _planted_feet(feet, start, fps, name, config)
    # The pelvis goes with the feet, or the legs would have to span the difference.
    follow = (planted.position - feet.position)[..., :2].mean(axis=1)
    body = after.copy()
    body[:, :2] += follow
    body = _faded_pose(before, body, fps, frames)
    height = np.zeros_like(planted.position)
    rise = start.position[0, :, 2] - planted.position[0, :, 2]
    height[:frames, :, 2] = _fading(rise, np.zeros(2), frames, fps)[: len(height)]
    planted = Feet(planted.position + height, planted.quat)
    body = replanted(body, planted, what=name)
    info = replace(
        first.info,
        name=name,
        category="transition",
        source=f"{first.info.source}, then {second.info.source}",
        licence=_licences(first, second),
    )
    clip = clip_from_qpos(info, np.concatenate((before, body[1:])))
    check_edit(clip, (first, second))
    return clip


def _licences(first: Clip, second: Clip) -> str:
    names = dict.fromkeys((first.info.licence, second.info.licence))
    return "; ".join(names)
