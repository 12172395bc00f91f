"""Linear-quadratic regulators about motions: the gains of `training.feedback`.

Near a motion a robot with PD motors is a linear system whose matrices MuJoCo gives by
finite differences, contacts included. The Riccati recursion says how joint targets must
answer to deviations, and which constants make up for what in the motion does not obey
Newton's laws. Where the robot then still falls, the system is linearized again where it
went (iterative LQR), until it stays up or passes run out.
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import mujoco
import numpy as np

from openclone.motion.workers import worker_pool
from openclone.robot import g1
from openclone.robot.model import CONTROL_PERIOD

VERSION = 1
"""Of the method; gains in the cache that were computed by another are not used."""
DEVIATION_SIZE = 2 * (6 + g1.NUM_JOINTS)
"""Values of a deviation: of the positions, then of the velocities."""
LARGEST = 0.5
"""Radians, bound on what is added to a joint target."""
BOUNDS = np.full(DEVIATION_SIZE, 1e9)
BOUNDS[:3], BOUNDS[3:6], BOUNDS[35:38] = 0.15, 0.4, 0.5
"""Metres, radians and m/s beyond which a deviation of the root counts no more."""
_LEAST_PASSES, _PASSES = 2, 4
_TRIALS = 3
"""Robots that begin a little beside the motion and judge the gains."""
_MUCH = 2000
"""Frames that are worth starting processes for."""
_SINK = 0.003
"""Metres by which the motion is lowered, so that its soles carry load."""
_SETTLING = 2
"""Physics steps from a state to where the system is linearized: by then the contact
forces are those of half a control period, not those of a touch."""
_EPSILON = 1e-5
_IMPLAUSIBLE = 300.0
_SAME = 1e-9
_POSITION_COST = np.r_[20.0, 20.0, 100.0, np.full(3, 20.0), np.full(g1.NUM_JOINTS, 4.0)]
_VELOCITY_COST = np.r_[np.full(6, 0.5), np.full(g1.NUM_JOINTS, 0.1)]
_COST = np.diag(np.concatenate((_POSITION_COST, _VELOCITY_COST)))
_EFFORT = np.diag(30.0 * (g1.KP / g1.MAX_TORQUE) ** 2)
"""An offset that asks for all of a motor's torque costs 30 in the units of `_COST`."""
_HELD = 100
"""Control steps for which the end of a motion is held, as the last gains see it."""
_LOST = np.array([0.25, 0.25, 0.15, 0.6, 0.6, 0.6])
"""Metres and radians of the root's deviation that no linear law corrects."""
_RETREAT = 10
"""Control steps before a fall that are of no use any more."""


@dataclass
class Motion:
    """A motion at 50 Hz, T frames.

    Attributes:
        qpos, qvel: (T, 36) and (T, 35).
        targets: (T, 29), joint targets in frame t that lead to frame t + 1.
    """

    qpos: np.ndarray
    qvel: np.ndarray
    targets: np.ndarray

    def __len__(self) -> int:
        return len(self.qpos)

    def sunk(self) -> Motion:
        """A little lower."""
        qpos = self.qpos.copy()
        qpos[:, 2] -= _SINK
        return Motion(qpos, self.qvel, self.targets)

    def copy(self) -> Motion:
        """One to be changed."""
        return Motion(self.qpos.copy(), self.qvel.copy(), self.targets.copy())


def regulate(model: mujoco.MjModel, motion: Motion) -> np.ndarray:
    """Gains ``(T, 29, 71)``, half precision: on a deviation and, last, constants.

    Args:
        model: the robot on flat ground.
        motion: what it should do.
    """
    data, at = mujoco.MjData(model), motion.sunk()
    best, fewest = np.empty(0), np.inf
    for attempt in range(_PASSES):
        gains = _riccati(*_linearized(model, data, motion, at))
        at, falls = _follow(model, data, motion, gains, None)
        if attempt + 1 < _LEAST_PASSES:
            continue
        for seed in range(_TRIALS):
            rng = np.random.default_rng(seed)
            falls += _follow(model, data, motion, gains, rng)[1]
        if falls < fewest:
            best, fewest = gains, falls
        if not falls:
            break
    return best


def regulate_all(
    model: mujoco.MjModel, motions: list[Motion], cache: Path
) -> Iterator[np.ndarray]:
    """`regulate` of each motion, in parallel; what is in the folder ``cache`` is read.

    Gains take 4 kilobytes a frame there, and some milliseconds each to compute.
    """
    cache.mkdir(parents=True, exist_ok=True)
    files = [cache / f"{_digest(model, motion)}.npy" for motion in motions]
    wanted = {
        file: motion
        for file, motion in zip(files, motions, strict=True)
        if _cached(file, len(motion)) is None
    }
    frames = sum(len(motion) for motion in wanted.values())
    cores = min(os.cpu_count() or 1, len(wanted))
    work = partial(regulate, model)
    if frames >= _MUCH:
        print(f"feedback gains of {len(wanted)} motions, {frames} frames ...")
    with worker_pool(cores) if frames >= _MUCH else nullcontext() as pool:
        results = (
            pool.map(work, wanted.values()) if pool else map(work, wanted.values())
        )
        for file, gains in zip(wanted, results, strict=True):
            partial_file = file.with_suffix(f".{os.getpid()}.partial")
            with partial_file.open("wb") as stream:
                np.save(stream, gains)
            partial_file.replace(file)
    for file, motion in zip(files, motions, strict=True):
        gains = _cached(file, len(motion))
        yield regulate(model, motion) if gains is None else gains


def _digest(model: mujoco.MjModel, motion: Motion) -> str:
    """Changes with the robot, the motion and the method."""
    robot = np.empty(mujoco.mj_sizeModel(model), np.uint8)
    mujoco.mj_saveModel(model, None, robot)
    digest = hashlib.sha256(f"regulator {VERSION}".encode())
    for part in (robot, motion.qpos, motion.qvel, motion.targets):
        digest.update(np.ascontiguousarray(part).tobytes())
    return digest.hexdigest()[:32]


def _cached(file: Path, frames: int) -> np.ndarray | None:
    """Gains from the cache; None if they are not there, or damaged."""
    try:
        gains = np.load(file, allow_pickle=False)
    except (OSError, ValueError, EOFError):
        return None
    shape = (frames, g1.NUM_JOINTS, DEVIATION_SIZE + 1)
    sound = gains.shape == shape and gains.dtype == np.float16
    return gains if sound and np.isfinite(gains).all() else None


def _linearized(
    model: mujoco.MjModel, data: mujoco.MjData, motion: Motion, at: Motion
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """A (T, 70, 70), B (T, 70, 29) and what the motion lacks, (T, 70).

    Deviations are from ``motion``; the states and joint targets about which the system
    is linearized are those of ``at``.
    """
    count, size = len(motion), DEVIATION_SIZE
    a, b = np.empty((count, size, size)), np.empty((count, size, g1.NUM_JOINTS))
    defect = np.empty((count, size))
    for frame in range(count):
        following = min(frame + 1, count - 1)
        if _repeats(at, frame) and _repeats(motion, following):
            for part in (a, b, defect):
                part[frame] = part[frame - 1]
            continue
        _put(model, data, at, frame)
        mujoco.mj_step(model, data, _SETTLING)
        a[frame], b[frame] = _transition(model, data)
        mujoco.mj_step(model, data, _substeps(model) - _SETTLING)
        defect[frame] = _difference(model, data, motion, following)
    sound = _nearest_sound(a)
    a, b = a[sound], b[sound]
    for frame in range(count):
        data.qpos[:], data.qvel[:] = at.qpos[frame], at.qvel[frame]
        away = _difference(model, data, motion, frame)
        added = at.targets[frame] - motion.targets[frame]
        defect[frame] -= a[frame] @ away + b[frame] @ added
    return a, b, defect


def _put(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    motion: Motion,
    frame: int,
    rng: np.random.Generator | None = None,
) -> None:
    """Put the robot into a frame, or a little beside it."""
    mujoco.mj_resetData(model, data)
    data.qpos[:], data.qvel[:] = motion.qpos[frame], motion.qvel[frame]
    data.ctrl[:] = motion.targets[frame]
    if rng is not None:
        data.qpos[7:] += 0.05 * rng.standard_normal(g1.NUM_JOINTS)
        data.qvel[:6] += 0.1 * rng.standard_normal(6)


def _difference(
    model: mujoco.MjModel, data: mujoco.MjData, motion: Motion, frame: int
) -> np.ndarray:
    """(70,): deviation of the robot from a frame."""
    away = np.empty(DEVIATION_SIZE)
    nv = model.nv
    mujoco.mj_differentiatePos(model, away[:nv], 1.0, motion.qpos[frame], data.qpos)
    away[nv:] = data.qvel - motion.qvel[frame]
    return away


def _repeats(motion: Motion, frame: int) -> bool:
    """Whether a frame repeats the one before it."""
    return frame > 0 and all(
        np.abs(part[frame] - part[frame - 1]).max() < _SAME
        for part in (motion.qpos, motion.qvel, motion.targets)
    )


def _transition(
    model: mujoco.MjModel, data: mujoco.MjData
) -> tuple[np.ndarray, np.ndarray]:
    """A (70, 70) and B (70, 29) of one control period around the state of ``data``."""
    size = DEVIATION_SIZE
    a, b = np.empty((size, size)), np.empty((size, model.nu))
    mujoco.mjd_transitionFD(model, data, _EPSILON, False, a, b, None, None)
    whole, summed = a, b
    for _ in range(_substeps(model) - 1):
        summed = a @ summed + b
        whole = a @ whole
    return whole, summed


def _substeps(model: mujoco.MjModel) -> int:
    return round(CONTROL_PERIOD / model.opt.timestep)


def _nearest_sound(a: np.ndarray) -> np.ndarray:
    """(T,): for every frame the nearest one whose matrix ``a (T, 70, 70)`` is sound.

    A contact that begins within `_EPSILON` of a state makes the differences there huge.
    """
    places = np.arange(len(a))
    sound = places[np.abs(a).max((1, 2)) < _IMPLAUSIBLE]
    if not len(sound):
        return places
    return sound[np.abs(places[:, None] - sound).argmin(1)]


def _riccati(a: np.ndarray, b: np.ndarray, defect: np.ndarray) -> np.ndarray:
    """Backward recursion over a motion that holds its end, ``(T, 29, 71)``."""
    gains = np.empty((len(a), g1.NUM_JOINTS, DEVIATION_SIZE + 1), np.float16)
    value, slope = _COST, np.zeros(DEVIATION_SIZE)
    for frame in [len(a) - 1] * _HELD + list(range(len(a) - 1, -1, -1)):
        weighted = b[frame].T @ value
        slope = slope + value @ defect[frame]
        effort = _EFFORT + weighted @ b[frame]
        demand = np.column_stack((weighted @ a[frame], b[frame].T @ slope))
        law = -np.linalg.solve(effort, demand)
        gains[frame] = law
        slope = a[frame].T @ slope + demand[:, :-1].T @ law[:, -1]
        value = a[frame].T @ value @ a[frame] + demand[:, :-1].T @ law[:, :-1]
        value = _COST + 0.5 * (value + value.T)
    return gains


def _follow(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    motion: Motion,
    gains: np.ndarray,
    rng: np.random.Generator | None,
) -> tuple[Motion, int]:
    """States and joint targets of a robot under the law, and how often it fell.

    After a fall it begins anew on the motion, a little before; with ``rng`` it begins
    a little beside it.
    """
    start, visited = motion.sunk(), motion.sunk().copy()
    frame = falls = restarted = 0
    _put(model, data, start, 0, rng)
    while frame < len(motion):
        away = _difference(model, data, motion, frame)
        if (np.abs(away[:6]) > _LOST).any():
            falls += 1
            restarted = frame = max(frame - _RETREAT, restarted + 1)
            _put(model, data, start, frame, rng)
            continue
        known = np.append(np.clip(away, -BOUNDS, BOUNDS), 1.0)
        added = np.clip(gains[frame].astype(float) @ known, -LARGEST, LARGEST)
        data.ctrl[:] = motion.targets[frame] + added
        visited.qpos[frame], visited.qvel[frame] = data.qpos, data.qvel
        visited.targets[frame] = data.ctrl
        mujoco.mj_step(model, data, _substeps(model))
        frame += 1
    return visited, falls
