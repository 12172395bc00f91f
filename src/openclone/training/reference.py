"""Reference motions as tables: what every key body should do at every frame."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property

import mujoco
import numpy as np
import torch
from scipy.ndimage import gaussian_filter1d

from openclone.motion.clip import Clip
from openclone.motion.commands import is_command
from openclone.motion.edit import MIRRORED
from openclone.motion.library import default_cache
from openclone.policy.teacher import landmarks
from openclone.robot import g1
from openclone.robot.model import CONTROL_PERIOD, SensorLayout
from openclone.robot.state import RobotState, read_state
from openclone.training.feedback import mirrored_feedback
from openclone.training.feedforward import feedforward
from openclone.training.regulator import DEVIATION_SIZE, Motion, regulate_all

_FPS = 1.0 / CONTROL_PERIOD
_SMOOTHING_FRAMES = 1.5


def generalized_velocities(model: mujoco.MjModel, qpos: np.ndarray) -> np.ndarray:
    """Smoothed finite differences of ``qpos (T, 36)`` at 50 Hz: ``(T, 35)``."""
    qvel = np.zeros((len(qpos), model.nv))
    for index in range(len(qpos) - 1):
        mujoco.mj_differentiatePos(
            model, qvel[index], CONTROL_PERIOD, qpos[index], qpos[index + 1]
        )
    qvel[-1] = qvel[-2]
    return gaussian_filter1d(qvel, _SMOOTHING_FRAMES, axis=0, mode="nearest")


@dataclass(frozen=True)
class ReferenceMotions:
    """All clips behind one another at 50 Hz; F frames in total, C clips.

    Attributes:
        qpos, qvel: (F, 36) and (F, 35), MuJoCo coordinates, on the host.
        feedforward: (F, 29), radians, of `training.feedforward`.
        grounded: the legs' part of it knows of the ground.
        feedback: (F, 29, 71), half precision, of `training.feedback`; on request.
        frames: the robot's state in every frame, tensors (F, ...), views of ``table``;
            torque and foot force are zero.
        table: (F, d), all of it in one row per frame.
        clip: (F,) index of the clip a frame belongs to.
        last: (F,) index of the last frame of that clip.
        category: (F,) index of the clip's category in ``category_names``.
        names, categories: one per clip.
        recorded: one per clip, whether it was made from a recording.
    """

    qpos: np.ndarray
    qvel: np.ndarray
    feedforward: torch.Tensor
    grounded: bool
    frames: RobotState
    table: torch.Tensor
    clip: torch.Tensor
    last: torch.Tensor
    category: torch.Tensor
    names: tuple[str, ...]
    categories: tuple[str, ...]
    recorded: tuple[bool, ...]
    feedback: torch.Tensor | None = None

    @property
    def num_frames(self) -> int:
        """F."""
        return len(self.qpos)

    @property
    def device(self) -> torch.device:
        """Where the tensors live."""
        return self.table.device

    @property
    def category_names(self) -> tuple[str, ...]:
        """The motion categories, each once."""
        return _distinct(self.categories)

    def to(self, device: torch.device) -> ReferenceMotions:
        """The same motions with their tensors on ``device``."""
        if device == self.device:
            return self
        table = self.table.to(device)
        return replace(
            self,
            frames=_as_state(table),
            table=table,
            feedforward=self.feedforward.to(device),
            feedback=None if self.feedback is None else self.feedback.to(device),
            clip=self.clip.to(device),
            last=self.last.to(device),
            category=self.category.to(device),
        )

    @cached_property
    def landmarks(self) -> torch.Tensor:
        """(F, 5, 3): what a preview shows of every frame, see `policy.teacher`."""
        return landmarks(self.frames)

    def summary(self) -> str:
        """How much motion there is, in words."""
        minutes = self.num_frames / _FPS / 60
        return f"{len(self.names)} clips, {minutes:.1f} minutes"

    def at(self, index: torch.Tensor) -> RobotState:
        """Reference states of the frames ``index (n,)``."""
        return _as_state(self.table.index_select(0, index))


_BODIES = len(g1.KEY_BODIES)
_SHAPES: dict[str, tuple[int, ...]] = {
    "joint_angles": (g1.NUM_JOINTS,),
    "joint_velocities": (g1.NUM_JOINTS,),
    "body_position": (_BODIES, 3),
    "body_quat": (_BODIES, 4),
    "body_velocity": (_BODIES, 3),
    "body_angular_velocity": (_BODIES, 3),
    "torque": (g1.NUM_JOINTS,),
    "foot_force": (2, 3),
}
_WIDTHS = tuple(math.prod(shape) for shape in _SHAPES.values())


def _as_table(frames: RobotState) -> torch.Tensor:
    """States ``(F, ...)`` as one row each, ``(F, d)``."""
    return torch.cat([getattr(frames, name).flatten(1) for name in _SHAPES], 1)


def _as_state(table: torch.Tensor) -> RobotState:
    """Rows ``(n, d)`` as states, without copying."""
    parts = zip(_SHAPES.items(), table.split(_WIDTHS, 1), strict=True)
    return RobotState(**{k: part.unflatten(1, shape) for (k, shape), part in parts})


def _distinct(names: tuple[str, ...]) -> tuple[str, ...]:
    return tuple(sorted(set(names)))


def build_reference(
    clips: list[Clip],
    model: mujoco.MjModel,
    feedback: bool = False,
    ground: bool = True,
) -> ReferenceMotions:
    """Resample ``clips`` to 50 Hz and compute the motion of the key bodies.

    Args:
        clips: the motions.
        model: the robot on flat ground.
        feedback: also compute gains, about four milliseconds per frame on two cores,
            kept in the user's cache.
        ground: with the legs' part of `feedforward`, which takes most of the time;
            gains need it too.
    """
    layout, ground = SensorLayout.of(model), ground or feedback
    qpos_parts, qvel_parts, sensor_parts, lengths = [], [], [], []
    offset_parts = []
    for clip in clips:
        qpos = clip.resampled(_FPS).qpos
        qvel = generalized_velocities(model, qpos)
        sensors = sensed(model, qpos, qvel)
        sensors[:, layout.torque] = 0.0
        sensors[:, layout.foot_force] = 0.0
        qpos_parts.append(qpos)
        qvel_parts.append(qvel)
        offset_parts.append(feedforward(model, qpos, qvel, ground))
        sensor_parts.append(sensors)
        lengths.append(len(qpos))

    def tensor(parts: list[np.ndarray]) -> torch.Tensor:
        return torch.tensor(np.concatenate(parts), dtype=torch.float32)

    ends = np.cumsum(lengths) - 1
    clip_index = np.repeat(np.arange(len(clips)), lengths)
    table = _as_table(
        read_state(layout, tensor(qpos_parts), tensor(qvel_parts), tensor(sensor_parts))
    )
    categories = tuple(clip.info.category for clip in clips)
    known = _distinct(categories)
    category_index = np.array([known.index(name) for name in categories])[clip_index]
    return ReferenceMotions(
        qpos=np.concatenate(qpos_parts),
        qvel=np.concatenate(qvel_parts),
        feedforward=tensor(offset_parts),
        grounded=ground,
        frames=_as_state(table),
        table=table,
        clip=torch.tensor(clip_index),
        last=torch.tensor(ends[clip_index]),
        category=torch.tensor(category_index),
        names=tuple(clip.info.name for clip in clips),
        categories=categories,
        recorded=tuple(clip.info.recorded for clip in clips),
        feedback=_feedback(clips, model, qpos_parts, qvel_parts, offset_parts)
        if feedback
        else None,
    )


def sensed(model: mujoco.MjModel, qpos: np.ndarray, qvel: np.ndarray) -> np.ndarray:
    """Sensor data of states, one row each; those of forces mean nothing."""
    data = mujoco.MjData(model)
    sensors = np.empty((len(qpos), model.nsensordata))
    for index in range(len(qpos)):
        data.qpos[:], data.qvel[:] = qpos[index], qvel[index]
        mujoco.mj_fwdPosition(model, data)
        mujoco.mj_sensorPos(model, data)
        mujoco.mj_fwdVelocity(model, data)
        mujoco.mj_sensorVel(model, data)
        sensors[index] = data.sensordata
    return sensors


def _feedback(
    clips: list[Clip],
    model: mujoco.MjModel,
    qpos: list[np.ndarray],
    qvel: list[np.ndarray],
    offsets: list[np.ndarray],
) -> torch.Tensor:
    """Gains of all frames; those of a mirrored clip are mirrored.

    What is a command and no motion has none: nobody can stay near it.
    """
    ends = np.cumsum([len(part) for part in qpos])
    table = np.zeros((ends[-1], g1.NUM_JOINTS, DEVIATION_SIZE + 1), np.float16)
    places = [slice(end - len(part), end) for end, part in zip(ends, qpos, strict=True)]
    known = {
        (clip.info.name, len(part)): place
        for clip, part, place in zip(clips, qpos, places, strict=True)
    }
    originals = [
        known.get((clip.info.name.removesuffix(MIRRORED), len(part)))
        if clip.info.name.endswith(MIRRORED)
        else None
        for clip, part in zip(clips, qpos, strict=True)
    ]
    own = [
        index
        for index, original in enumerate(originals)
        if original is None and not is_command(clips[index].info)
    ]
    cache = default_cache().parent / "feedback"
    motions = [
        Motion(qpos[i], qvel[i], _following(qpos[i][:, 7:] + offsets[i])) for i in own
    ]
    for index, gains in zip(own, regulate_all(model, motions, cache), strict=True):
        table[places[index]] = gains
    for place, original in zip(places, originals, strict=True):
        if original is not None:
            table[place] = mirrored_feedback(table[original])
    return torch.from_numpy(table)


def _following(rows: np.ndarray) -> np.ndarray:
    """Every row's successor; the last one stays."""
    return np.concatenate((rows[1:], rows[-1:]))
