"""G1 motions as mjlab and BeyondMimic keep them for training (``.npz``).

Both hold ``fps``, ``joint_pos``, ``joint_vel`` (T, 29) and, of all 30 bodies in the
world, ``body_pos_w``, ``body_quat_w`` (wxyz), ``body_lin_vel_w``, ``body_ang_vel_w``.
Neither names its joints: mjlab has MuJoCo's order (depth first, the motors' order),
BeyondMimic that of Isaac Lab (breadth first). The reader finds out by comparing the
bodies with the forward kinematics of the joints.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

import mujoco
import numpy as np

from openclone.errors import InputError
from openclone.motion.clip import Clip
from openclone.motion.npz import read_numbers, read_scalar
from openclone.motion.sources.g1_clip import clip_from_arrays, npz_bytes, write_whole
from openclone.robot import g1
from openclone.robot.model import build_model
from openclone.spatial import rotations

ARRAYS = (
    "fps", "joint_pos", "joint_vel",
    "body_pos_w", "body_quat_w", "body_lin_vel_w", "body_ang_vel_w",
)  # fmt: skip
NUM_BODIES = 30
MAX_MISMATCH = 0.05
"""Metres, median distance of a body from where the joints put it."""
_CHECKED_FRAMES = 20


@cache
def _model() -> mujoco.MjModel:
    return build_model(floor=False)


@cache
def breadth_first() -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Isaac Lab's order as indices into MuJoCo's: of the joints and of the bodies."""
    model = _model()
    depth = [0] * model.nbody
    for body in range(1, model.nbody):
        depth[body] = depth[model.body_parentid[body]] + 1
    bodies = sorted(range(1, model.nbody), key=lambda body: (depth[body], body))
    joints = [int(model.body_jntadr[body]) - 1 for body in bodies[1:]]
    return tuple(joints), tuple(body - 1 for body in bodies)


def is_mjlab(names: frozenset[str]) -> bool:
    """Whether an npz file with these arrays is of this kind."""
    return {"joint_pos", "body_pos_w", "body_quat_w"} <= names


def body_motion(qpos: np.ndarray, fps: float) -> dict[str, np.ndarray]:
    """Poses and velocities of all bodies and joints along a motion.

    Args:
        qpos: (T, 36) MuJoCo positions.
        fps: frames per second.

    Returns:
        The arrays of the format without ``fps``, in mjlab's order. Velocities are
        central differences, as in mjlab's converter; one-sided at the ends.
    """
    model = _model()
    data = mujoco.MjData(model)
    count = len(qpos)
    arrays = {
        "joint_pos": qpos[:, 7:].copy(),
        "joint_vel": np.gradient(qpos[:, 7:], 1.0 / fps, axis=0),
        **{
            name: np.empty((count, NUM_BODIES, 4 if "quat" in name else 3))
            for name in ARRAYS[3:]
        },
    }
    linear = np.gradient(qpos[:, :3], 1.0 / fps, axis=0)
    angular = _angular_velocity(qpos[:, 3:7], fps)
    velocity = np.empty(6)
    for frame in range(count):
        data.qpos[:] = qpos[frame]
        # The free joint's angular velocity is in the body's frame.
        spin = rotations.rotate_inverse(qpos[frame, 3:7], angular[frame])
        data.qvel[:] = np.concatenate((linear[frame], spin, arrays["joint_vel"][frame]))
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        arrays["body_pos_w"][frame] = data.xpos[1:]
        arrays["body_quat_w"][frame] = data.xquat[1:]
        for body in range(NUM_BODIES):
            mujoco.mj_objectVelocity(
                model, data, mujoco.mjtObj.mjOBJ_XBODY, body + 1, velocity, 0
            )
            arrays["body_ang_vel_w"][frame, body] = velocity[:3]
            arrays["body_lin_vel_w"][frame, body] = velocity[3:]
    return arrays


def _angular_velocity(quat: np.ndarray, fps: float) -> np.ndarray:
    """(T, 3) radians per second, world, of ``quat (T, 4)``; central differences."""

    def turn(before: np.ndarray, after: np.ndarray) -> np.ndarray:
        difference = rotations.multiply(after, rotations.conjugate(before))
        return rotations.to_rotation_vector(difference)

    middle = 0.5 * turn(quat[:-2], quat[2:])
    first, last = turn(quat[:1], quat[1:2]), turn(quat[-2:-1], quat[-1:])
    return np.concatenate((first, middle, last)) * fps


def write(clip: Clip, path: Path, *, isaac_order: bool = False) -> None:
    """Write ``clip`` at its own frame rate (mjlab trains at 50 Hz).

    Args:
        clip: the motion.
        path: the file.
        isaac_order: joints and bodies in BeyondMimic's order instead of mjlab's.
    """
    arrays = body_motion(clip.qpos, clip.info.fps)
    if isaac_order:
        joints, bodies = map(list, breadth_first())
        for name, values in arrays.items():
            order = joints if name.startswith("joint") else bodies
            arrays[name] = values[:, order]
    # mjlab's converter stores the rate as a list of one whole number.
    fps = clip.info.fps
    arrays["fps"] = np.array([int(fps) if fps == int(fps) else fps])
    write_whole(path, npz_bytes(arrays))


def _mismatch(qpos: np.ndarray, positions: np.ndarray) -> float:
    """Metres; median distance of bodies ``(n, 30, 3)`` from the kinematics' ones."""
    model = _model()
    data = mujoco.MjData(model)
    distances = []
    for row, seen in zip(qpos, positions, strict=True):
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        distances.append(np.linalg.norm(data.xpos[1:] - seen, axis=1))
    return float(np.median(np.array(distances).max(1)))


def read(path: Path) -> Clip:
    """Read a motion of mjlab or BeyondMimic, whichever order its joints have.

    Raises:
        InputError: the file is missing, damaged, or bodies and joints do not agree.
    """
    joints = read_numbers(path, "joint_pos", (None, g1.NUM_JOINTS))
    count = len(joints)
    positions = read_numbers(path, "body_pos_w", (count, NUM_BODIES, 3))
    quats = read_numbers(path, "body_quat_w", (count, NUM_BODIES, 4))
    fps = read_scalar(path, "fps")
    clip = clip_from_arrays(path, fps, positions[:, 0], quats[:, 0], joints)
    some = np.unique(np.linspace(0, count - 1, _CHECKED_FRAMES).astype(int))
    isaac_joints, isaac_bodies = map(np.array, breadth_first())
    qpos = clip.qpos[some]
    depth_first = _mismatch(qpos, positions[some])
    other = qpos.copy()
    other[:, 7 + isaac_joints] = qpos[:, 7:]
    seen = np.empty_like(positions[some])
    seen[:, isaac_bodies] = positions[some]
    breadth = _mismatch(other, seen)
    if min(depth_first, breadth) > MAX_MISMATCH:
        raise InputError(
            f"bodies are {min(depth_first, breadth):.3f} m from where joint_pos puts "
            "them, in mjlab's and in BeyondMimic's order",
            where=str(path),
            remedy="use a motion of the G1 with 29 joints, metres and radians",
        )
    if breadth < depth_first:
        ordered = np.empty_like(joints)
        ordered[:, isaac_joints] = joints
        clip = clip_from_arrays(path, fps, positions[:, 0], quats[:, 0], ordered)
    return clip
