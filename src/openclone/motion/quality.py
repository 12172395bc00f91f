"""What is wrong with a clip, in numbers, and the gate that turns bad clips away.

Everything except the distances from the targets is measured on the robot's motion
alone, so ready-made clips pass the same gate as retargeted ones.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from openclone.errors import InputError
from openclone.motion.contacts import runs
from openclone.robot import g1
from openclone.robot.model import SOLE_CORNERS, build_model
from openclone.spatial import rotations

if TYPE_CHECKING:
    from openclone.motion.targets import Targets

MEASURE_VERSION = 1
"""Raise when a figure changes its meaning: kept figures are measured again."""
_SIDES = ("left", "right")
_FEET = tuple(f"{side}_ankle_roll_link" for side in _SIDES)
_WRISTS = tuple(f"{side}_wrist_yaw_link" for side in _SIDES)
_TOUCH = 0.005
"""Metres above the ground below which a corner of a sole touches it."""
_OFF_GROUND = 0.02
"""Metres above the ground above which nothing supports the robot."""
_GRAVITY = 9.81
_LOST = 0.15
"""Metres from its target beyond which a hand or foot does something else."""
_NEAR_LIMIT = 0.01
"""Radians from a joint's limit that count as being at it."""


@dataclass(frozen=True)
class ClipQuality:
    """How good a clip is.

    Attributes:
        seconds: duration of the clip.
        ankle_mm, wrist_mm: mean distance of ankles and wrists from their targets,
            which are the human's, scaled; None for a clip that was not retargeted.
        lost_share: share of frames with an ankle or a wrist more than 150 mm away from
            its target; None likewise.
        slide_cm_s: mean horizontal speed of sole corners that touch the ground.
        ground_share: share of frames with a link more than 10 mm below the ground.
        self_share: share of frames with links more than 5 mm inside each other.
        limit_share: share of frames with a joint at its limit (within 0.01 rad).
        limit_joint: the joint that is at its limit most often, empty if none is.
        peak_speed: highest joint speed, rad/s.
        speed_ratio: highest joint speed over what that joint's motor reaches.
        peak_acceleration: highest joint acceleration, rad/s².
        spike_share: share of frames in which a joint jerks back and forth.
        float_s: longest time off the ground without falling, seconds.
        air_s: longest time off the ground, seconds.
        tilt_deg: greatest lean of the pelvis from upright.
        turn_rad_s: greatest speed of turning of the pelvis.
    """

    seconds: float
    ankle_mm: float | None
    wrist_mm: float | None
    lost_share: float | None
    slide_cm_s: float
    ground_share: float
    self_share: float
    limit_share: float
    limit_joint: str
    peak_speed: float
    speed_ratio: float
    peak_acceleration: float
    spike_share: float
    float_s: float
    air_s: float
    tilt_deg: float
    turn_rad_s: float

    @staticmethod
    def columns() -> tuple[str, ...]:
        """Names of the figures but the duration, in the order of `cells`."""
        return tuple(item.name for item in fields(ClipQuality))[1:]

    def cells(self) -> tuple[str, ...]:
        """The figures as text, for a table; empty where there is none."""
        values = (getattr(self, name) for name in self.columns())
        return tuple(
            f"{value:.4g}" if isinstance(value, float) else value or ""
            for value in values
        )

    def __str__(self) -> str:
        """One line for people."""
        parts = []
        if self.ankle_mm is not None and self.wrist_mm is not None:
            parts += [
                f"ankles {self.ankle_mm:.0f} mm",
                f"wrists {self.wrist_mm:.0f} mm",
            ]
        return ", ".join(
            [
                *parts,
                f"slide {self.slide_cm_s:.1f} cm/s",
                f"ground {self.ground_share:.1%}",
                f"self {self.self_share:.1%}",
                f"limits {self.limit_share:.0%}",
                f"peak {self.peak_speed:.1f} rad/s",
                f"tilt {self.tilt_deg:.0f} deg",
            ]
        )


@dataclass(frozen=True)
class Gate:
    """The worst figures with which a clip is accepted; named as in `ClipQuality`.

    ``ankle_mm`` and ``wrist_mm``: beyond them it would not be the same motion.
    ``tilt_deg``: nobody's pelvis tips over by more without falling; ``turn_rad_s``:
    nor does it turn faster: both are the mark of a recording that flips.
    """

    ankle_mm: float = 25.0
    wrist_mm: float = 100.0
    lost_share: float = 0.05
    slide_cm_s: float = 15.0
    ground_share: float = 0.01
    self_share: float = 0.01
    speed_ratio: float = 1.0
    spike_share: float = 0.05
    float_s: float = 0.3
    air_s: float = 1.0
    tilt_deg: float = 105.0
    turn_rad_s: float = 12.0
    min_seconds: float = 0.5


_REASONS = {
    "ankle_mm": "the feet are off their targets by {:.0f} mm",
    "wrist_mm": "the wrists are off their targets by {:.0f} mm",
    "lost_share": "a hand or foot is far from its target in {:.1%} of the frames",
    "slide_cm_s": "the standing feet slide at {:.1f} cm/s",
    "ground_share": "parts are under the ground in {:.1%} of the frames",
    "self_share": "links are inside each other in {:.1%} of the frames",
    "speed_ratio": "a joint turns at {:.2f} times its motor's speed",
    "spike_share": "joints jerk back and forth in {:.1%} of the frames",
    "float_s": "the robot floats for {:.2f} s",
    "air_s": "the robot is off the ground for {:.2f} s",
    "tilt_deg": "the body flips over: the pelvis leans by {:.0f} deg",
    "turn_rad_s": "the body flips round: the pelvis turns at {:.1f} rad/s",
}


def faults(quality: ClipQuality, gate: Gate | None = None) -> tuple[str, ...]:
    """Why a clip of this quality is turned away; empty if it is accepted."""
    gate = gate or Gate()
    found = []
    if quality.seconds < gate.min_seconds:
        found.append(f"only {quality.seconds:.2f} s (at least {gate.min_seconds:g})")
    for name, text in _REASONS.items():
        value, most = getattr(quality, name), getattr(gate, name)
        if value is not None and value > most:
            found.append(f"{text.format(value)} (at most {most:g})")
    return tuple(found)


@dataclass(frozen=True)
class _Body:
    """What the frames of a clip show, T frames, world.

    Attributes:
        corners: (T, 2, 4, 3), metres, corners of the left and right sole.
        feet, wrists: (T, 2, 3), metres.
        mass_centre: (T, 3), metres.
        buried, inside: (T,), a link is under the ground or inside another.
        touches: (T,), anything touches the ground.
    """

    corners: np.ndarray
    feet: np.ndarray
    wrists: np.ndarray
    mass_centre: np.ndarray
    buried: np.ndarray
    inside: np.ndarray
    touches: np.ndarray


class QualityMeter:
    """Measures clips; build once, use for many."""

    def __init__(self, model: mujoco.MjModel | None = None) -> None:
        """Use ``model``, which needs the floor and self-collisions, or build one."""
        self._model = model or build_model(floor=True, self_collision=True)
        self._data = mujoco.MjData(self._model)
        self._floor = self._model.geom("floor").id

    def _observe(self, qpos: np.ndarray) -> _Body:
        model, data, frames = self._model, self._data, len(qpos)
        feet = [model.body(name).id for name in _FEET]
        wrists = [model.body(name).id for name in _WRISTS]
        place, turn = np.empty((frames, 4, 3)), np.empty((frames, 2, 3, 3))
        mass_centre, depth = np.empty((frames, 3)), np.ones((frames, 2))
        for frame in range(frames):
            data.qpos[:] = qpos[frame]
            mujoco.mj_kinematics(model, data)
            mujoco.mj_comPos(model, data)
            mujoco.mj_collision(model, data)
            place[frame] = data.xpos[feet + wrists]
            turn[frame] = data.xmat[feet].reshape(2, 3, 3)
            mass_centre[frame] = data.subtree_com[0]
            if data.ncon:
                ground = (data.contact.geom == self._floor).any(1)
                for k, distances in enumerate(
                    (data.contact.dist[ground], data.contact.dist[~ground])
                ):
                    depth[frame, k] = distances.min(initial=1.0)
        corners = np.einsum("tfij,cj->tfci", turn, SOLE_CORNERS)
        return _Body(
            corners=corners + place[:, :2, None],
            feet=place[:, :2],
            wrists=place[:, 2:],
            mass_centre=mass_centre,
            buried=depth[:, 0] < -0.010,
            inside=depth[:, 1] < -0.005,
            touches=depth[:, 0] < 0.0,
        )

    def measure(
        self, qpos: np.ndarray, fps: float, targets: Targets | None = None
    ) -> ClipQuality:
        """Quality of ``qpos (T, 36)``.

        Args:
            qpos: the motion.
            fps: its rate.
            targets: what it was to follow, in its world; None if that is not known.

        Raises:
            InputError: fewer than three frames.
        """
        if len(qpos) < 3:
            raise InputError(
                f"{len(qpos)} frames are no motion", remedy="give at least 3 frames"
            )
        body = self._observe(qpos)
        speed = np.abs(np.diff(qpos[:, 7:], axis=0)) * fps
        near = (qpos[:, 7:] < g1.JOINT_LOWER + _NEAR_LIMIT) | (
            qpos[:, 7:] > g1.JOINT_UPPER - _NEAR_LIMIT
        )
        joint = g1.JOINT_NAMES[int(np.argmax(near.mean(0)))] if near.any() else ""
        up_z = 1.0 - 2.0 * (qpos[:, 4] ** 2 + qpos[:, 5] ** 2)
        tilt_deg = np.degrees(np.arccos(np.clip(up_z, -1.0, 1.0)))
        turn = rotations.angle_between(qpos[1:, 3:7], qpos[:-1, 3:7]) * fps
        air_s, float_s = _off_ground(body, fps)
        acceleration = np.diff(qpos[:, 7:], 2, axis=0) * fps**2
        return ClipQuality(
            seconds=(len(qpos) - 1) / fps,
            ankle_mm=_residual_mm(body.feet, targets, _FEET),
            wrist_mm=_residual_mm(body.wrists, targets, _WRISTS),
            lost_share=_lost_share(body, targets),
            slide_cm_s=_slide_cm_s(body.corners, fps),
            ground_share=float(body.buried.mean()),
            self_share=float(body.inside.mean()),
            limit_share=float(near.any(1).mean()),
            limit_joint=joint,
            peak_speed=float(speed.max()),
            speed_ratio=float((speed / g1.MAX_SPEED).max()),
            peak_acceleration=float(np.abs(acceleration).max(initial=0.0)),
            spike_share=_spike_share(acceleration, len(qpos)),
            float_s=float_s,
            air_s=air_s,
            tilt_deg=float(tilt_deg.max()),
            turn_rad_s=float(np.max(turn)),
        )


def _distances(
    found: np.ndarray, targets: Targets, links: tuple[str, ...]
) -> np.ndarray:
    """Distances (T, 2) in metres of ``found (T, 2, 3)`` from the targets of links."""
    wanted = np.stack([targets.position[link] for link in links], axis=1)
    return np.linalg.norm(found - wanted, axis=-1)


def _residual_mm(
    found: np.ndarray, targets: Targets | None, links: tuple[str, ...]
) -> float | None:
    """Mean distance of ``found (T, 2, 3)`` from the targets of ``links``."""
    if targets is None:
        return None
    return 1e3 * float(_distances(found, targets, links).mean())


def _lost_share(body: _Body, targets: Targets | None) -> float | None:
    """Share of frames in which an ankle or wrist is far from its target."""
    if targets is None:
        return None
    feet = _distances(body.feet, targets, _FEET).max(axis=1)
    hands = _distances(body.wrists, targets, _WRISTS).max(axis=1)
    return float((np.maximum(feet, hands) > _LOST).mean())


def _slide_cm_s(corners: np.ndarray, fps: float) -> float:
    """Mean horizontal speed of the corners that touch the ground in two frames."""
    low = corners[..., 2] < _TOUCH
    stands = low[1:] & low[:-1]
    if not stands.any():
        return 0.0
    speed = np.linalg.norm(np.diff(corners[..., :2], axis=0), axis=-1) * fps
    return 100.0 * float(speed[stands].mean())


_SPIKE = 400.0
"""rad/s²; joints that speed up and slow down by more within 60 ms only twitch."""


def _spike_share(acceleration: np.ndarray, frames: int) -> float:
    """Share of frames where a joint's strong acceleration turns round at once.

    Args:
        acceleration: (T - 2, 29), rad/s².
        frames: T.
    """
    strong = np.abs(acceleration) > _SPIKE
    spikes = np.zeros(len(acceleration), dtype=bool)
    for gap in (1, 2, 3):
        turns = strong[gap:] & strong[:-gap]
        turns &= np.sign(acceleration[gap:]) != np.sign(acceleration[:-gap])
        spikes[gap:] |= turns.any(1)
    return float(spikes.sum()) / frames


def _off_ground(body: _Body, fps: float) -> tuple[float, float]:
    """Longest time off the ground, and longest of it without falling, seconds.

    In flight the centre of mass falls with gravity. Retargeting shrinks the path
    but not the time, so half of it is enough.
    """
    lowest = body.corners[..., 2].min(axis=(1, 2))
    air_s = float_s = 0.0
    for start, stop in runs((lowest > _OFF_GROUND) & ~body.touches):
        seconds = (stop - start) / fps
        air_s = max(air_s, seconds)
        height = body.mass_centre[start:stop, 2]
        falls = False
        if stop - start >= 3:
            time = np.arange(stop - start) / fps
            falls = 2.0 * np.polyfit(time, height, 2)[0] < -0.5 * _GRAVITY
        if not falls:
            float_s = max(float_s, seconds)
    return air_s, float_s
