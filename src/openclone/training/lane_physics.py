"""Physics of sixteen robots at a time, each in a lane of the processor's registers.

MuJoCo steps one robot after another; a register that holds sixteen numbers then works
on one or two. `lanes.c` solves MuJoCo's equations for this robot on flat ground in
single precision, all sixteen lanes at once, and is eight times as fast. Places,
velocities and sensors agree with MuJoCo's up to rounding, but for two simplifications:
joints at their limits are pushed back before the ground pushes, not by one solution of
both, and each part other than a foot that touches the ground is pushed back alone.
"""

from __future__ import annotations

import copy
import ctypes
import itertools
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import mujoco
import numpy as np
import torch

from openclone.errors import InputError
from openclone.robot import g1
from openclone.training.native import load
from openclone.training.physics import RobotParameters, apply_parameters, foot_geoms

_LANES = 16
_BODIES, _JOINTS, _DOFS = g1.NUM_JOINTS + 1, g1.NUM_JOINTS, g1.NUM_JOINTS + 6
_CORNERS, _SPHERES = 8, 40
_SWEEPS = 100
"""Most passes over the contacts; some ten are usual, as forces begin with the last."""
_ENOUGH = 0.05
"""N; contacts are solved when no force changes by more in a pass."""

_MODEL = np.dtype(
    [
        ("parent", "i4", _BODIES),
        ("axis", "i4", _BODIES),
        ("turned", "i4", _BODIES),
        ("foot", "i4", 2),
        ("seen", "i4", len(g1.KEY_BODIES)),
        ("num_spheres", "i4"),
        ("sphere_body", "i4", _SPHERES),
        ("position", "f4", (_BODIES, 3)),
        ("quat", "f4", (_BODIES, 4)),
        ("armature", "f4", _JOINTS),
        ("lower", "f4", _JOINTS),
        ("upper", "f4", _JOINTS),
        ("max_torque", "f4", _JOINTS),
        ("corner", "f4", (_CORNERS, 3)),
        ("corner_radius", "f4"),
        ("sphere", "f4", (_SPHERES, 3)),
        ("sphere_radius", "f4", _SPHERES),
        ("imu", "f4", 3),
        ("timestep", "f4"),
        ("gravity", "f4"),
        ("stiffness", "f4"),
        ("damping", "f4"),
        ("imp_start", "f4"),
        ("imp_end", "f4"),
        ("imp_width", "f4"),
        ("enough", "f4"),
        ("sweeps", "i4"),
    ]
)
"""``Model`` of lanes.c."""

_SIZES = {
    "mass": _BODIES,
    "com": 3 * _BODIES,
    "inertia": 6 * _BODIES,
    "kp": _JOINTS,
    "kd": _JOINTS,
    "friction": 1,
    "foot_weight": 2,
    "sphere_weight": _SPHERES,
    "joint_weight": _JOINTS,
    "qpos": 7 + _JOINTS,
    "qvel": _DOFS,
    "edge": 4 * _CORNERS,
}
"""``Robots`` of lanes.c: what distinguishes a robot, then its state."""
_ENDS = np.cumsum(tuple(_SIZES.values()))
_TOTAL = int(_ENDS[-1])
_PART = {
    name: slice(int(end) - size, int(end))
    for (name, size), end in zip(_SIZES.items(), _ENDS, strict=True)
}
_STATE = _PART["qpos"].start


def check_supported(model: mujoco.MjModel) -> None:
    """Refuse a model with anything that lanes.c does not know.

    Raises:
        InputError: it names what.
    """
    hinges = model.jnt_axis[1:]
    known = {
        "a root and one hinge per body": model.njnt == model.nbody - 1 == _BODIES
        and list(model.jnt_bodyid) == list(range(1, model.nbody)),
        "hinges about x, y or z of their bodies": bool(
            np.all(hinges.max(1) == 1.0) and np.all(np.abs(hinges).sum(1) == 1.0)
        )
        and not model.jnt_pos.any(),
        "neither damping nor dry friction": not model.dof_damping.any()
        and not model.dof_frictionloss.any(),
        "flat ground": mujoco.mjtGeom.mjGEOM_HFIELD not in model.geom_type
        and not model.geom_contype[model.geom_bodyid > 0].any(),
        "spheres and capsules, four spheres a foot": len(foot_geoms(model)) == _CORNERS
        and {int(model.geom_type[geom]) for geom in _touching(model)}
        <= {mujoco.mjtGeom.mjGEOM_SPHERE, mujoco.mjtGeom.mjGEOM_CAPSULE}
        and len(_spheres(model)[0]) <= _SPHERES,
        "pyramidal friction": model.opt.cone == mujoco.mjtCone.mjCONE_PYRAMIDAL,
        "MuJoCo's integrator implicitfast": model.opt.integrator
        == mujoco.mjtIntegrator.mjINT_IMPLICITFAST,
        "limits of all joints and motors": bool(
            model.jnt_limited[1:].all() and model.actuator_forcelimited.all()
        ),
        "one softness of all contacts": bool(
            np.all(model.geom_solref == model.geom_solref[0])
            and np.all(model.geom_solimp == model.geom_solimp[0])
            and np.all(model.jnt_solref == model.geom_solref[0])
        ),
    }
    for what, holds in known.items():
        if not holds:
            raise InputError(
                f"robots in lanes need {what}", remedy="use --physics threaded"
            )


def _touching(model: mujoco.MjModel) -> list[int]:
    """Geoms of the robot that touch the ground."""
    chosen = (model.geom_conaffinity > 0) & (model.geom_bodyid > 0)
    return np.flatnonzero(chosen).tolist()


def _axes(quat: np.ndarray) -> np.ndarray:
    """Rotation matrix of ``quat (4,)``, ``(3, 3)``."""
    flat = np.zeros(9)
    mujoco.mju_quat2Mat(flat, quat)
    return flat.reshape(3, 3)


def _spheres(model: mujoco.MjModel) -> tuple[list[int], list[np.ndarray], list[float]]:
    """Body, place and radius of all spheres and ends of capsules but the feet's."""
    bodies, places, radii = [], [], []
    feet = foot_geoms(model)
    for geom in _touching(model):
        if geom in feet:
            continue
        capsule = model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_CAPSULE
        half = model.geom_size[geom, 1] * _axes(model.geom_quat[geom])[:, 2]
        for end in (half, -half) if capsule else (0.0 * half,):
            bodies.append(int(model.geom_bodyid[geom]) - 1)
            places.append(model.geom_pos[geom] + end)
            radii.append(float(model.geom_size[geom, 0]))
    return bodies, places, radii


def _shared(model: mujoco.MjModel) -> np.ndarray:
    """What all robots share, a `_MODEL`."""
    shared = np.zeros((), _MODEL)
    shared["parent"] = np.maximum(model.body_parentid[1:] - 1, 0)
    shared["axis"][1:] = model.jnt_axis[1:].argmax(1)
    shared["turned"] = model.body_quat[1:, 0] != 1.0
    names = [g1.KEY_BODIES[foot] for foot in g1.FEET]
    shared["foot"] = [model.body(name).id - 1 for name in names]
    shared["seen"] = [model.body(name).id - 1 for name in g1.KEY_BODIES]
    shared["position"], shared["quat"] = model.body_pos[1:], model.body_quat[1:]
    shared["armature"] = model.dof_armature[6:]
    shared["lower"], shared["upper"] = model.jnt_range[1:].T
    shared["max_torque"] = model.actuator_forcerange[:, 1]
    feet = foot_geoms(model)
    shared["corner"] = model.geom_pos[feet]
    shared["corner_radius"] = model.geom_size[feet[0], 0]
    bodies, places, radii = _spheres(model)
    count = shared["num_spheres"] = len(bodies)
    shared["sphere_body"][:count], shared["sphere"][:count] = bodies, places
    shared["sphere_radius"][:count] = radii
    shared["imu"] = model.site("imu_in_pelvis").pos
    shared["timestep"], shared["gravity"] = model.opt.timestep, -model.opt.gravity[2]
    time, ratio = model.geom_solref[0]
    start, end, width = model.geom_solimp[0][:3]
    shared["stiffness"] = 1.0 / (end * time * ratio) ** 2
    shared["damping"] = 2.0 / (end * time)
    shared["imp_start"], shared["imp_end"], shared["imp_width"] = start, end, width
    shared["enough"], shared["sweeps"] = _ENOUGH, _SWEEPS
    return shared


def _own(model: mujoco.MjModel, shared: np.ndarray) -> np.ndarray:
    """``(k,)``: what distinguishes the robot ``model``; its state is left out."""
    inertia = []
    for quat, diagonal in zip(
        model.body_iquat[1:], model.body_inertia[1:], strict=True
    ):
        axes = _axes(quat)
        full = axes * diagonal @ axes.T
        inertia.append(full[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]])
    weight = np.ones(_SPHERES)
    touching = shared["sphere_body"][: int(shared["num_spheres"])] + 1
    weight[: len(touching)] = model.body_invweight0[touching, 0]
    parts = (
        model.body_mass[1:],
        model.body_ipos[1:].ravel(),
        np.concatenate(inertia),
        model.actuator_gainprm[:, 0],
        -model.actuator_biasprm[:, 2],
        model.geom_friction[foot_geoms(model)[:1], 0],
        model.body_invweight0[shared["foot"] + 1, 0],
        weight,
        model.dof_invweight0[6:],
    )
    return np.concatenate(parts).astype(np.float32)


def _aligned(*shape: int) -> np.ndarray:
    """Zeros, float32, that begin where a register's load may begin."""
    room = np.zeros(4 * int(np.prod(shape)) + 64, np.uint8)
    start = -room.ctypes.data % 64
    return room[start : start + 4 * int(np.prod(shape))].view(np.float32).reshape(shape)


class LanePhysics:
    """A `Physics` on the CPU: robots in blocks of sixteen, blocks shared by threads."""

    def __init__(
        self,
        model: mujoco.MjModel,
        num_envs: int,
        threads: int = 1,
        device: torch.device | None = None,
    ) -> None:
        """Create ``num_envs`` robots of ``model``.

        Args:
            model: the robot on its ground.
            num_envs: number of robots.
            threads: that share the robots.
            device: where states are wanted; only the CPU will do.

        Raises:
            InputError: the model has something that lanes.c does not know, there is no
                C compiler, or states are wanted elsewhere.
        """
        if device is not None and device.type != "cpu":
            raise InputError(
                f"lanes are the processor's, and states are wanted on {device}",
                remedy="use --device cpu, or --physics warp",
            )
        check_supported(model)
        self._library = _load()
        self.num_envs, self.links = num_envs, model.nbody - 1
        self.device = torch.device("cpu")
        self._nominal, self._robot = model, copy.copy(model)
        self._scratch = mujoco.MjData(model)
        self._shared = _shared(model)
        blocks = -(-num_envs // _LANES)
        self._robots = _aligned(blocks, _TOTAL, _LANES)
        self._robots[:, :_STATE] = _own(model, self._shared)[:, None]
        at = _PART["qpos"].start
        self._robots[:, at + 2], self._robots[:, at + 3] = g1.STANDING_HEIGHT, 1.0
        self._sensors = np.zeros((blocks * _LANES, model.nsensordata), np.float32)
        ends = np.linspace(0, blocks, min(threads, blocks) + 1).astype(int).tolist()
        self._shares = list(itertools.pairwise(ends))
        self._pool = ThreadPoolExecutor(len(self._shares))

    def _advance(
        self, robots: np.ndarray, ctrl: np.ndarray | None, sensors: np.ndarray
    ) -> None:
        """Blocks ``robots`` by ``ctrl (n, substeps, 29)``; None: look at them alone."""
        self._library.advance(
            self._shared.ctypes.data_as(ctypes.c_void_p),
            robots.ctypes.data_as(ctypes.c_void_p),
            len(robots),
            None if ctrl is None else ctrl.ctypes.data_as(ctypes.c_void_p),
            0 if ctrl is None else ctrl.shape[1],
            sensors.ctypes.data_as(ctypes.c_void_p),
            sensors.shape[1],
        )

    def _put(self, part: str, ids: np.ndarray, values: np.ndarray) -> None:
        self._robots[ids // _LANES, _PART[part], ids % _LANES] = values

    def _get(self, part: str) -> np.ndarray:
        rows = self._robots[:, _PART[part]].transpose(0, 2, 1)
        return rows.reshape(-1, _SIZES[part])[: self.num_envs]

    def place(self, ids: np.ndarray, qpos: np.ndarray, qvel: np.ndarray) -> None:
        """As `reset`, but sensors stay as they are."""
        self._put("qpos", ids, qpos)
        self._put("qvel", ids, qvel)
        self._put("edge", ids, np.zeros((len(ids), _SIZES["edge"])))

    def reset(self, ids: np.ndarray, qpos: np.ndarray, qvel: np.ndarray) -> None:
        """Put the robots ``ids`` into the given states and refresh their sensors."""
        self.place(ids, qpos, qvel)
        blocks, place = np.unique(ids // _LANES, return_inverse=True)
        chosen = _aligned(len(blocks), _TOTAL, _LANES)
        chosen[:] = self._robots[blocks]
        seen = np.zeros((len(blocks) * _LANES, self._sensors.shape[1]), np.float32)
        self._advance(chosen, None, seen)
        self._sensors[ids] = seen[place * _LANES + ids % _LANES]

    def push(self, ids: np.ndarray, velocity: np.ndarray) -> None:
        """Add ``velocity (len(ids), 3)``, m/s, world, to the roots (Table A2)."""
        start = _PART["qvel"].start
        self._robots[ids // _LANES, start : start + 3, ids % _LANES] += velocity

    def randomize(self, ids: np.ndarray, parameters: RobotParameters) -> None:
        """Give the robots ``ids`` the parameters in rows 0 to len(ids) - 1."""
        for row, robot in enumerate(ids):
            apply_parameters(self._robot, self._nominal, self._scratch, parameters, row)
            own = _own(self._robot, self._shared)
            self._robots[robot // _LANES, :_STATE, robot % _LANES] = own

    def copy(self, sources: np.ndarray) -> None:
        """Give every robot parameters, state and sensors of ``sources[robot]``."""
        rows = self._robots[sources // _LANES, :, sources % _LANES]
        robots = np.arange(self.num_envs)
        self._robots[robots // _LANES, :, robots % _LANES] = rows
        self._sensors[robots] = self._sensors[sources]

    def step(self, ctrl: torch.Tensor) -> None:
        """Advance all robots by ``ctrl (n, substeps, nu)``, joint targets."""
        if len(ctrl) != self.num_envs or ctrl.shape[2] != _JOINTS:
            raise ValueError(f"controls for {self.num_envs} robots, not {ctrl.shape}")
        targets = np.ascontiguousarray(ctrl.numpy(), np.float32)
        missing = len(self._sensors) - len(targets)
        if missing:
            empty = np.zeros((missing, *targets.shape[1:]), np.float32)
            targets = np.concatenate((targets, empty))

        def work(share: tuple[int, int]) -> None:
            first, last = share
            rows = slice(first * _LANES, last * _LANES)
            self._advance(self._robots[first:last], targets[rows], self._sensors[rows])

        list(self._pool.map(work, self._shares))

    def read(self) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor]:
        """Copies of qpos, qvel, sensordata: (n, 36), (n, 35), (n, s), float32."""
        arrays = (self._get("qpos"), self._get("qvel"), self._sensors[: self.num_envs])
        qpos, qvel, sensors = (torch.from_numpy(array.copy()) for array in arrays)
        return qpos, qvel, sensors


def _load() -> ctypes.CDLL:
    library = load(Path(__file__).with_name("lanes.c"))
    sizes = (library.model_bytes, library.robots_bytes)
    for size in sizes:
        size.restype = ctypes.c_int64
    if [size() for size in sizes] != [_MODEL.itemsize, 4 * _LANES * _TOTAL]:
        raise RuntimeError("lanes.c and lane_physics.py disagree on their tables")
    return library
