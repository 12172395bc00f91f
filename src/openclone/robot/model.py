"""The MuJoCo model of the G1, assembled from mjlab's MJCF and the table in `g1`.

Everything that training and deployment read from the physics is declared here as a
sensor, so that every backend and the simulated robot deliver the same vector.
"""

from __future__ import annotations

import importlib.util
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import mujoco
import numpy as np

from openclone.errors import OpenCloneError
from openclone.robot import g1
from openclone.spatial import rotations

Feet = Literal["spheres", "capsules"]

TIMESTEP = 0.005
SUBSTEPS = 4
"""Physics steps of 5 ms per control step of 20 ms (50 Hz)."""
CONTROL_PERIOD = TIMESTEP * SUBSTEPS

_SPHERES = ((-0.05, 0.025), (-0.05, -0.025), (0.12, 0.03), (0.12, -0.03))
_SPHERE_RADIUS = 0.005
_SPHERE_Z = -0.03
SOLE_Z = _SPHERE_Z - _SPHERE_RADIUS
"""Metres; height of the sole in the frame of ``*_ankle_roll_link``."""
SOLE_CORNERS = np.array([(x, y, SOLE_Z) for x, y in _SPHERES])
"""(4, 3), metres: lowest points of the sole in the frame of ``*_ankle_roll_link``."""
FOOT_FRICTION = 0.8

_SENSOR_TYPES = {
    "position": mujoco.mjtSensor.mjSENS_FRAMEPOS,
    "quat": mujoco.mjtSensor.mjSENS_FRAMEQUAT,
    "velocity": mujoco.mjtSensor.mjSENS_FRAMELINVEL,
    "angular_velocity": mujoco.mjtSensor.mjSENS_FRAMEANGVEL,
}


def g1_xml() -> Path:
    """Path of mjlab's MJCF of the G1, found without importing mjlab."""
    package = importlib.util.find_spec("mjlab")
    if package is None or not package.submodule_search_locations:
        raise OpenCloneError(
            "the package mjlab, which holds the G1's MJCF, is not installed; "
            "run `make install`"
        )
    root = Path(next(iter(package.submodule_search_locations)))
    return root / "asset_zoo" / "robots" / "unitree_g1" / "xmls" / "g1.xml"


def _add_actuators(spec: mujoco.MjSpec) -> None:
    for joint in g1.JOINTS:
        motor = joint.motor
        element = spec.joint(joint.name)
        element.armature = motor.armature
        actuator = spec.add_actuator(
            name=joint.name.removesuffix("_joint"),
            target=joint.name,
            trntype=mujoco.mjtTrn.mjTRN_JOINT,
            forcelimited=True,
            forcerange=[-motor.max_torque, motor.max_torque],
        )
        actuator.set_to_position(kp=motor.kp, kv=motor.kd)


def _set_collisions(spec: mujoco.MjSpec, feet: Feet, self_collision: bool) -> None:
    for geom in list(spec.geoms):
        if not geom.name.endswith("_collision"):
            continue
        geom.contype, geom.conaffinity = int(self_collision), 1
        geom.condim, geom.priority = 1, 0
        if re.fullmatch(r"(left|right)_foot\d_collision", geom.name):
            if feet == "spheres":
                spec.delete(geom)
                continue
            geom.condim, geom.priority = 3, 1
            geom.friction = [FOOT_FRICTION, 0.005, 0.0001]
    if feet == "spheres":
        for side in ("left", "right"):
            for index, (x, y) in enumerate(_SPHERES):
                spec.body(f"{side}_ankle_roll_link").add_geom(
                    name=f"{side}_foot{index + 1}_collision",
                    type=mujoco.mjtGeom.mjGEOM_SPHERE,
                    size=[_SPHERE_RADIUS, 0, 0],
                    pos=[x, y, _SPHERE_Z],
                    contype=int(self_collision),
                    conaffinity=1,
                    condim=3,
                    priority=1,
                    friction=[FOOT_FRICTION, 0.005, 0.0001],
                    density=0,
                    group=3,
                )


def _add_sites(spec: mujoco.MjSpec) -> None:
    torso = spec.body("torso_link")
    torso.add_site(name="head", pos=list(g1.HEAD_OFFSET))
    roll, pitch, yaw = g1.LIDAR_RPY
    quat = rotations.from_euler(np.array([yaw, pitch, roll]), "ZYX")
    torso.add_site(name="lidar", pos=list(g1.LIDAR_POSITION), quat=quat.tolist())
    for side in ("left", "right"):
        wrist = spec.body(f"{side}_wrist_yaw_link")
        wrist.add_site(name=f"{side}_hand", pos=list(g1.HAND_OFFSET))


def _add_sensors(spec: mujoco.MjSpec) -> None:
    for sensor in list(spec.sensors):
        spec.delete(sensor)
    for kind, sensor_type in _SENSOR_TYPES.items():
        for body in g1.KEY_BODIES:
            spec.add_sensor(
                name=f"{kind}/{body}",
                type=sensor_type,
                objtype=mujoco.mjtObj.mjOBJ_XBODY,
                objname=body,
            )
    for joint in g1.JOINTS:
        spec.add_sensor(
            name=f"torque/{joint.name}",
            type=mujoco.mjtSensor.mjSENS_ACTUATORFRC,
            objtype=mujoco.mjtObj.mjOBJ_ACTUATOR,
            objname=joint.name.removesuffix("_joint"),
        )
    for side in ("left", "right"):
        # Data: force alone; reduction 3: the net force, in world axes; one slot.
        spec.add_sensor(
            name=f"foot_force/{side}",
            type=mujoco.mjtSensor.mjSENS_CONTACT,
            objtype=mujoco.mjtObj.mjOBJ_BODY,
            objname=f"{side}_ankle_roll_link",
            intprm=[1 << int(mujoco.mjtConDataField.mjCONDATA_FORCE), 3, 1],
        )
    for name, sensor_type in (
        ("gyro", mujoco.mjtSensor.mjSENS_GYRO),
        ("accelerometer", mujoco.mjtSensor.mjSENS_ACCELEROMETER),
    ):
        spec.add_sensor(
            name=f"imu/{name}",
            type=sensor_type,
            objtype=mujoco.mjtObj.mjOBJ_SITE,
            objname="imu_in_pelvis",
        )


def build_spec(
    *, feet: Feet = "spheres", self_collision: bool = False
) -> mujoco.MjSpec:
    """The G1 alone, with actuators, sites and sensors; no floor.

    Args:
        feet: four 5 mm spheres a foot (fast) or mjlab's seven capsules.
        self_collision: whether links collide with each other.
    """
    spec = mujoco.MjSpec.from_file(str(g1_xml()))
    _set_collisions(spec, feet, self_collision)
    _add_actuators(spec)
    _add_sites(spec)
    _add_sensors(spec)
    spec.option.timestep = TIMESTEP
    spec.option.iterations = 5
    spec.option.ls_iterations = 10
    spec.option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    return spec


def add_floor(spec: mujoco.MjSpec) -> None:
    """Add a checkered ground plane at z = 0 and light."""
    spec.add_texture(
        name="ground",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        rgb1=[0.86, 0.88, 0.9],
        rgb2=[0.78, 0.81, 0.84],
        width=256,
        height=256,
    )
    material = spec.add_material(name="ground", texrepeat=[1, 1], texuniform=True)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "ground"
    spec.worldbody.add_geom(
        name="floor",
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[0, 0, 0.05],
        material="ground",
        contype=1,
        conaffinity=1,
        condim=3,
    )
    spec.worldbody.add_light(
        pos=[0, 0, 6], dir=[0.2, 0.1, -1], type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    )


def build_model(
    *, feet: Feet = "spheres", self_collision: bool = False, floor: bool = True
) -> mujoco.MjModel:
    """The compiled model that training and the simulated robot use."""
    spec = build_spec(feet=feet, self_collision=self_collision)
    if floor:
        add_floor(spec)
    return spec.compile()


def standing_qpos() -> np.ndarray:
    """(36,) positions of the robot standing at the origin in its default pose."""
    return np.concatenate(
        ([0, 0, g1.STANDING_HEIGHT], rotations.IDENTITY, g1.DEFAULT_POSE)
    )


@dataclass(frozen=True)
class SensorLayout:
    """Where each group of sensors lies in ``sensordata``.

    Attributes:
        position, quat, velocity, angular_velocity: key bodies, world frame.
        torque: the 29 actuators, N m.
        foot_force: (2, 3), N, world, on the left and right foot.
        gyro, accelerometer: pelvis IMU.
    """

    position: slice
    quat: slice
    velocity: slice
    angular_velocity: slice
    torque: slice
    foot_force: slice
    gyro: slice
    accelerometer: slice

    @staticmethod
    def of(model: mujoco.MjModel) -> SensorLayout:
        """Read the layout from the sensors' names."""
        spans: dict[str, list[int]] = {}
        for index in range(model.nsensor):
            group, _, item = model.sensor(index).name.partition("/")
            key = item if group == "imu" else group
            start = int(model.sensor_adr[index])
            span = spans.setdefault(key, [start, start])
            span[1] = start + int(model.sensor_dim[index])
        return SensorLayout(**{key: slice(*span) for key, span in spans.items()})
