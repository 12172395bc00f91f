"""Recorded human motion in one canonical form, whatever file it came from.

The canonical skeleton has 18 joints. A joint's orientation is the identity in the
T-pose: upright, facing +X, arms out sideways, palms down, thumbs forward.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from openclone.errors import InputError
from openclone.spatial import rotations

JOINTS = (
    "hips", "chest", "neck", "head",
    "left_hip", "left_knee", "left_ankle", "left_toe",
    "left_shoulder", "left_elbow", "left_wrist",
    "right_hip", "right_knee", "right_ankle", "right_toe",
    "right_shoulder", "right_elbow", "right_wrist",
)  # fmt: skip
"""Canonical joints; ``toe`` is the ball of the foot."""
SIDES = ("left", "right")
MAX_FRAMES = 150_000
"""20 minutes at 120 Hz; reading that much takes 0.75 GB."""
_METRES = {
    "m": 1.0,
    "cm": 0.01,
    "mm": 0.001,
    "inch": 0.0254,
    "CMU's inch / 0.45": 0.0254 / 0.45,
}
_LEG_RANGE = (0.55, 1.15)
_MAX_SPEED = 20.0
"""Metres per second relative to the hips; no hand or foot is faster."""
# Columns are the hand frame's axes in the T-pose: x along the fingers, z the thumb.
_LEFT_HAND = rotations.from_matrix(np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]], float))
_RIGHT_HAND = rotations.from_matrix(
    np.array([[0, 0, 1], [-1, 0, 0], [0, -1, 0]], float)
)


@dataclass(frozen=True)
class HumanMotion:
    """A recording of T frames in the Z-up world.

    Attributes:
        name: the recording's name.
        fps: frames per second.
        positions: (T, 18, 3), metres, world; joints in the order of `JOINTS`.
        quats: (T, 18, 4), wxyz, world from joint; identity in the T-pose.
    """

    name: str
    fps: float
    positions: np.ndarray
    quats: np.ndarray

    @property
    def num_frames(self) -> int:
        """T."""
        return len(self.positions)

    def joint(self, name: str) -> np.ndarray:
        """(T, 3), metres, world: positions of the joint called ``name``."""
        return self.positions[:, JOINTS.index(name)]

    def orientation(self, name: str) -> np.ndarray:
        """(T, 4), world from joint, of the joint called ``name``."""
        return self.quats[:, JOINTS.index(name)]

    def bone_length(self, upper: str, lower: str) -> float:
        """Metres; median distance of two joints."""
        bone = self.joint(lower) - self.joint(upper)
        return float(np.median(np.linalg.norm(bone, axis=1)))

    @property
    def leg_length(self) -> float:
        """Metres from hip to ankle along the straight leg, mean of both legs."""
        parts = [
            self.bone_length(f"{side}_hip", f"{side}_knee")
            + self.bone_length(f"{side}_knee", f"{side}_ankle")
            for side in SIDES
        ]
        return float(np.mean(parts))

    @property
    def hip_center(self) -> np.ndarray:
        """(T, 3), metres, world: midpoint of the hip joints."""
        return 0.5 * (self.joint("left_hip") + self.joint("right_hip"))

    def resampled(self, fps: float) -> HumanMotion:
        """The same motion at another frame rate (linear, slerp)."""
        seconds = (self.num_frames - 1) / self.fps
        count = max(int(np.floor(seconds * fps + 1e-6)) + 1, 2)
        at = np.minimum(np.arange(count) / fps * self.fps, self.num_frames - 1)
        low = np.minimum(at.astype(int), self.num_frames - 2)
        part = (at - low)[:, None]
        weight = part[..., None]
        positions = (
            self.positions[low] * (1 - weight) + self.positions[low + 1] * weight
        )
        quats = rotations.slerp(self.quats[low], self.quats[low + 1], part)
        return replace(self, fps=float(fps), positions=positions, quats=quats)


def scale_to_metres(leg_length: float, where: str) -> float:
    """Metres per file unit, judged by the length of a leg in file units.

    Raises:
        InputError: no usual unit makes this a human leg.
    """
    for scale in _METRES.values():
        if _LEG_RANGE[0] <= leg_length * scale <= _LEG_RANGE[1]:
            return scale
    raise InputError(
        f"a leg of {leg_length:.4g} file units is no human leg in any of "
        + ", ".join(_METRES),
        where=where,
        remedy="scale the recording to metres or centimetres",
    )


def make_motion(
    name: str, fps: float, positions: np.ndarray, quats: np.ndarray, where: str
) -> HumanMotion:
    """Check the arrays and make a motion of them.

    Raises:
        InputError: too few or many frames, odd rate, or values that are not finite.
    """
    if not 2 <= len(positions) <= MAX_FRAMES:
        raise InputError(
            f"{len(positions)} frames, expected 2 to {MAX_FRAMES}",
            where=where,
            remedy="record or cut the motion to that length",
        )
    if not 5 <= fps <= 1000:
        raise InputError(
            f"frame rate {fps:.4g} Hz, expected 5 to 1000",
            where=where,
            remedy="correct the frame time",
        )
    if not (np.isfinite(positions).all() and np.isfinite(quats).all()):
        raise InputError("a pose is not finite", where=where, remedy="repair the file")
    if np.abs(positions).max() > 1000:
        raise InputError(
            "a joint is more than 1 km from the origin",
            where=where,
            remedy="repair the root positions or their unit",
        )
    quats = rotations.make_continuous(rotations.normalize(quats))
    motion = HumanMotion(name, float(fps), positions, quats)
    if not _LEG_RANGE[0] <= motion.leg_length <= _LEG_RANGE[1]:
        raise InputError(
            f"a leg is {motion.leg_length:.3g} m long",
            where=where,
            remedy="correct the unit of length or the skeleton",
        )
    return without_flips(motion)


def without_flips(motion: HumanMotion) -> HumanMotion:
    """Bridge single frames in which the body flips over, trim them at the ends.

    Recordings that were resampled by their Euler angles have them wherever an angle
    passes 180 degrees.
    """
    relative = motion.positions - motion.hip_center[:, None]
    speed = np.linalg.norm(np.diff(relative, axis=0), axis=-1).max(1) * motion.fps
    jumps = np.flatnonzero(speed > _MAX_SPEED)
    if not len(jumps):
        return motion
    reach = max(round(0.15 * motion.fps), 2)
    groups = np.split(jumps, np.flatnonzero(np.diff(jumps) > reach) + 1)
    positions, quats = motion.positions.copy(), motion.quats.copy()
    first, last = 0, motion.num_frames - 1
    for group in groups:
        before, after = int(group[0]) - 2, int(group[-1]) + 3
        if before < reach:
            first = after
        elif after > motion.num_frames - 1 - reach:
            last = min(last, before)
        else:
            at = np.arange(before, after + 1)
            part = ((at - before) / (after - before))[:, None]
            a, b = positions[before], positions[after]
            positions[at] = a + (b - a) * part[..., None]
            quats[at] = rotations.slerp(
                np.broadcast_to(quats[before], quats[at].shape), quats[after], part
            )
    span = slice(first, last + 1)
    if last - first < 2:
        return motion
    quats = rotations.make_continuous(quats[span])
    return replace(motion, positions=positions[span], quats=quats)


def start_at_origin(motion: HumanMotion) -> HumanMotion:
    """Move the first frame's hips to xy = (0, 0) and turn its heading to +X."""
    turn = rotations.conjugate(rotations.heading(motion.orientation("hips")[0]))
    shift = np.append(motion.hip_center[0, :2], 0.0)
    return replace(
        motion,
        positions=rotations.rotate(turn[None, None], motion.positions - shift),
        quats=rotations.multiply(
            np.broadcast_to(turn, motion.quats.shape), motion.quats
        ),
    )


def operator_points(motion: HumanMotion) -> tuple[np.ndarray, np.ndarray]:
    """What a headset would report of this human: head, left and right wrist.

    The head is the identity when it looks along +X; a hand is the identity when the
    arm points along +X with the palm inward and the thumb up (the G1's hand frame).

    Returns:
        Positions (T, 3, 3), metres, and orientations (T, 3, 4), wxyz, world.
    """
    positions = np.stack(
        [motion.joint(name) for name in ("head", "left_wrist", "right_wrist")], 1
    )
    quats = np.stack(
        (
            motion.orientation("head"),
            rotations.multiply(motion.orientation("left_wrist"), _LEFT_HAND),
            rotations.multiply(motion.orientation("right_wrist"), _RIGHT_HAND),
        ),
        1,
    )
    return positions, quats
