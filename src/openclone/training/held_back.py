"""Recordings as a governor passes them on: slower over the ground, all else as it was.

Live, an operator who is faster than the robot is held back (`policy.governor`), so the
head bobs and the hands swing at a pace that does not belong to the way. No recording
shows that. Here a recording's whole body is carried along the governed way; the feet
then slide, so the result is a command, as gliding laps are.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from openclone.motion.clip import Clip, clip_from_qpos
from openclone.motion.commands import COMMAND
from openclone.policy.command import KeyPoints
from openclone.policy.governor import Governor, GovernorConfig
from openclone.robot.model import CONTROL_PERIOD
from openclone.training.data import is_recorded, top_speed

_HELD_BACK = "~held-back"
_SLOW = GovernorConfig(travel_speed=0.6, travel_acceleration=0.7)
_GOVERNORS = (_SLOW, _SLOW, GovernorConfig(travel_speed=0.9, travel_acceleration=1.2))
"""In turn: slower than the policy's own, which an operator may set."""
_BEFORE_S, _AFTER_S, _LONGEST_S = 0.5, 1.0, 4.0


def held_back_clips(clips: Iterable[Clip]) -> list[Clip]:
    """The recordings among ``clips`` that a governor slows, as it passes them on."""
    fast = [
        clip
        for clip in clips
        if is_recorded(clip) and top_speed(clip) > _SLOW.travel_speed
    ]
    return [
        held_back(clip, _GOVERNORS[index % len(_GOVERNORS)])
        for index, clip in enumerate(fast)
    ]


def held_back(clip: Clip, config: GovernorConfig) -> Clip:
    """``clip`` at 50 Hz, carried along behind itself by a governor.

    The pelvis takes the place of the head, which needs no kinematics. The body waits
    for half a second before, and afterwards until it has arrived, at most 4 s.
    """
    qpos = clip.resampled(1.0 / CONTROL_PERIOD).qpos
    way = float(np.linalg.norm(qpos[-1, :2] - qpos[0, :2]))
    late_s = max(0.0, way / config.travel_speed - len(qpos) * CONTROL_PERIOD)
    after_s = min(_LONGEST_S, late_s + _AFTER_S)
    before, after = (round(s / CONTROL_PERIOD) for s in (_BEFORE_S, after_s))
    qpos = np.concatenate(
        (
            np.repeat(qpos[:1], before, axis=0),
            qpos,
            np.repeat(qpos[-1:], after, axis=0),
        )
    )
    governor = Governor(config)
    for row in qpos:
        wanted = KeyPoints(row[None, :3], row[None, 3:7])
        passed = governor.follow(wanted, CONTROL_PERIOD)
        row[:3], row[3:7] = passed.position[0], passed.quat[0]
    info = replace(
        clip.info,
        name=f"{clip.info.name}{_HELD_BACK}",
        source=f"{COMMAND}held back",
        fps=1.0 / CONTROL_PERIOD,
    )
    return clip_from_qpos(info, qpos)
