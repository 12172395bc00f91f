"""Reference motions as tables: what every key body should do at every frame."""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
import torch
from scipy.ndimage import gaussian_filter1d

from openclone.motion.clip import Clip
from openclone.robot.model import CONTROL_PERIOD, SensorLayout
from openclone.robot.state import RobotState, read_state

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
        qpos, qvel: (F, 36) and (F, 35), MuJoCo coordinates.
        frames: the robot's state in every frame, arrays (F, ...); torque and foot
            force are zero.
        clip: (F,) index of the clip a frame belongs to.
        last: (F,) index of the last frame of that clip.
        names, categories: one per clip.
    """

    qpos: np.ndarray
    qvel: np.ndarray
    frames: RobotState
    clip: torch.Tensor
    last: torch.Tensor
    names: tuple[str, ...]
    categories: tuple[str, ...]

    @property
    def num_frames(self) -> int:
        """F."""
        return len(self.qpos)

    def summary(self) -> str:
        """How much motion there is, in words."""
        minutes = self.num_frames / _FPS / 60
        return f"{len(self.names)} clips, {minutes:.1f} minutes"

    def at(self, index: torch.Tensor) -> RobotState:
        """Reference states of the frames ``index (n,)``."""
        frames = self.frames
        return RobotState(
            **{
                name: getattr(frames, name).index_select(0, index)
                for name in _STATE_FIELDS
            }
        )


_STATE_FIELDS = tuple(RobotState.__dataclass_fields__)


def build_reference(clips: list[Clip], model: mujoco.MjModel) -> ReferenceMotions:
    """Resample ``clips`` to 50 Hz and compute the motion of the key bodies."""
    layout = SensorLayout.of(model)
    data = mujoco.MjData(model)
    qpos_parts, qvel_parts, sensor_parts, lengths = [], [], [], []
    for clip in clips:
        qpos = clip.resampled(_FPS).qpos
        qvel = generalized_velocities(model, qpos)
        sensors = np.empty((len(qpos), model.nsensordata))
        for index in range(len(qpos)):
            data.qpos[:], data.qvel[:] = qpos[index], qvel[index]
            mujoco.mj_fwdPosition(model, data)
            mujoco.mj_sensorPos(model, data)
            mujoco.mj_fwdVelocity(model, data)
            mujoco.mj_sensorVel(model, data)
            sensors[index] = data.sensordata
        sensors[:, layout.torque] = 0.0
        sensors[:, layout.foot_force] = 0.0
        qpos_parts.append(qpos)
        qvel_parts.append(qvel)
        sensor_parts.append(sensors)
        lengths.append(len(qpos))

    def tensor(parts: list[np.ndarray]) -> torch.Tensor:
        return torch.tensor(np.concatenate(parts), dtype=torch.float32)

    ends = np.cumsum(lengths) - 1
    clip_index = np.repeat(np.arange(len(clips)), lengths)
    return ReferenceMotions(
        qpos=np.concatenate(qpos_parts),
        qvel=np.concatenate(qvel_parts),
        frames=read_state(
            layout, tensor(qpos_parts), tensor(qvel_parts), tensor(sensor_parts)
        ),
        clip=torch.tensor(clip_index),
        last=torch.tensor(ends[clip_index]),
        names=tuple(clip.info.name for clip in clips),
        categories=tuple(clip.info.category for clip in clips),
    )
