"""Gliding laps: commands, not motions. The standing body glides along laps with stops.

They show the head and hands of an operator who walks about and now and then waits,
which is all that a three-point policy is told. The legs do not step: the feet glide
over the ground on purpose. So the clips are exempt from the gate's limit on sliding
feet and from every test of physical plausibility. A teacher that is rewarded for the
body's way learns to step under it. They are for training only: how far a policy's legs
are from these says nothing.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from openclone.motion.clip import Clip, ClipInfo, clip_from_qpos
from openclone.motion.commands import GLIDING
from openclone.motion.planted import feet_of, replanted
from openclone.motion.sources.choreography import FPS
from openclone.robot.model import standing_qpos
from openclone.spatial import rotations

_SECONDS = 45.0
_LICENCE = "Apache-2.0, made by OpenClone"
_STRAIGHT_EVERY, _BACKWARD_EVERY = 5, 7


@dataclass(frozen=True)
class Laps:
    """A way with stops: wait, start gently, go on, stop gently, and again.

    Attributes:
        speed: metres per second between starting and stopping.
        radius: metres, of laps to the left; infinite: straight ahead.
        leg: metres between two stops.
        ease_s: seconds of starting, and of stopping.
        pause_s: seconds of each stop.
        sink: metres by which the body is lower at speed: walkers stand lower.
        backward: go backward, and to the right.
    """

    speed: float
    radius: float
    leg: float
    ease_s: float
    pause_s: float
    sink: float
    backward: bool = False


def carried_body(seconds: float, laps: Laps, fps: float = FPS) -> np.ndarray:
    """``(T, 36)`` positions of the standing robot, carried along ``laps`` from x = 0.

    It is rigid: where the body sinks, so do the soles.
    """
    count = round(seconds * fps) + 1
    leg_s = laps.leg / laps.speed + laps.ease_s
    phase = np.arange(count) / fps % (leg_s + laps.pause_s) - laps.pause_s
    # Speed rises and falls evenly at both ends of a leg.
    share = np.clip(np.minimum(phase, leg_s - phase) / laps.ease_s, 0.0, 1.0)
    share = share * share * (3.0 - 2.0 * share)
    way = np.cumsum(laps.speed * share) / fps * (-1.0 if laps.backward else 1.0)
    angle = way / laps.radius
    qpos = np.tile(standing_qpos(), (count, 1))
    if math.isinf(laps.radius):
        qpos[:, 0] = way
    else:
        qpos[:, 0] = laps.radius * np.sin(angle)
        qpos[:, 1] = laps.radius * (1.0 - np.cos(angle))
    qpos[:, 2] -= laps.sink * share
    qpos[:, 3:7] = rotations.from_yaw(angle)
    return qpos


def gliding_laps(name: str, laps: Laps, seconds: float = _SECONDS) -> Clip:
    """The standing body along ``laps``, its knees bent so that the soles stay level."""
    qpos = carried_body(seconds, laps)
    upright = qpos.copy()
    upright[:, 2] = standing_qpos()[2]
    qpos = replanted(qpos, feet_of(upright), what=name)
    category = "backward" if laps.backward else "forward"
    return clip_from_qpos(ClipInfo(name, category, GLIDING, _LICENCE, FPS), qpos)


def gliding_set(seed: int, count: int) -> list[Clip]:
    """``count`` different gliding laps; equal seeds give equal ones.

    Every fifth goes straight ahead, every seventh backward.
    """
    clips = []
    for number in range(count):
        rng = np.random.default_rng([seed, number])
        straight = number % _STRAIGHT_EVERY == 0
        laps = Laps(
            speed=rng.uniform(0.2, 0.6),
            radius=math.inf if straight else rng.uniform(1.6, 5.0),
            leg=rng.uniform(1.5, 4.5),
            ease_s=rng.uniform(0.5, 1.3),
            pause_s=rng.uniform(1.5, 5.0),
            sink=rng.uniform(0.0, 0.04),
            backward=number % _BACKWARD_EVERY == _BACKWARD_EVERY - 1,
        )
        clips.append(gliding_laps(f"synthetic/gliding_{number:02d}", laps))
    return clips
