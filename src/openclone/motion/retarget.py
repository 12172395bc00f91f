"""From a recorded human to the G1: scaled targets, locked feet, inverse kinematics."""

from __future__ import annotations

from dataclasses import dataclass

import mink
import mujoco
import numpy as np

from openclone.errors import InputError
from openclone.motion.clip import Clip, ClipInfo, clip_from_qpos
from openclone.motion.contacts import foot_contacts, ground_level, runs, smooth
from openclone.motion.skeleton import SIDES, HumanMotion, operator_points
from openclone.motion.skeleton import start_at_origin as motion_at_origin
from openclone.robot import g1
from openclone.robot.model import SOLE_CORNERS, SOLE_Z, build_model
from openclone.spatial import rotations

VERSION = 2
"""Raise when the output changes: cached clips of older versions are made again."""
FPS = 50.0
THIGH, SHANK, UPPER_ARM, FOREARM = 0.306, 0.318, 0.185, 0.184
"""Metres; limb lengths of the G1, hip to knee to ankle, shoulder to elbow to wrist."""
HIP_HEIGHT = -0.133
HIP_HALF_WIDTH = 0.1165
"""Metres; hip centres in the pelvis frame."""
SHOULDER = np.array([0.004, 0.1468, 0.245])
"""Metres; left shoulder centre in the frame of ``torso_link``."""
TORSO = np.array([-0.004, 0.0, 0.044])
"""Metres; origin of ``torso_link`` in the pelvis frame, waist straight."""
ANKLE_HEIGHT = -SOLE_Z

_ARM = ("elbow_yaw", "wrist", "hand")
_TRUNK = ("torso", "head", "pelvis")
_LEG = ("hip", "thigh", "shin")


@dataclass(frozen=True)
class RetargetConfig:
    """Weights and limits of the retargeting.

    Attributes:
        crouch: share of the straight leg used at the human's full height; keeps the
            knees off their singular straight pose.
        min_knee: radians, smallest bend of a knee.
        lowest_pelvis: metres; the ankles allow no deeper squat on flat feet.
        smooth_s: seconds, width of the Gaussian over the targets.
        max_joint_speed: radians per second.
        clearance: metres that links keep from each other.
        solves: IK steps per frame, at most.
        first_solves: IK steps for the first frame.
        converged: radians; smaller steps end a frame early.
    """

    crouch: float = 0.97
    min_knee: float = 0.08
    lowest_pelvis: float = 0.38
    smooth_s: float = 0.03
    max_joint_speed: float = 15.0
    clearance: float = 0.005
    solves: int = 4
    first_solves: int = 120
    converged: float = 0.002


@dataclass(frozen=True)
class Targets:
    """Where the robot's links should be, T frames, world.

    Attributes:
        position: link -> (T, 3), metres.
        quat: link -> (T, 4), wxyz.
        contact: (T, 2), the left and right foot stand.
    """

    position: dict[str, np.ndarray]
    quat: dict[str, np.ndarray]
    contact: np.ndarray


@dataclass(frozen=True)
class RetargetQuality:
    """How good a retargeted clip is.

    Attributes:
        ankle_mm, wrist_mm: mean distance of ankles and wrists from their targets.
        slide_cm_s: mean horizontal speed of standing feet.
        ground_share: share of frames with a sole more than 5 mm below the ground.
        self_share: share of frames with links more than 5 mm inside each other.
        limit_share: share of frames with a joint at its limit (within 0.01 rad).
        peak_speed: highest joint speed, rad/s.
    """

    ankle_mm: float
    wrist_mm: float
    slide_cm_s: float
    ground_share: float
    self_share: float
    limit_share: float
    peak_speed: float

    def summary(self) -> str:
        """One line for people."""
        return (
            f"ankles {self.ankle_mm:.0f} mm, wrists {self.wrist_mm:.0f} mm, "
            f"slide {self.slide_cm_s:.1f} cm/s, ground {self.ground_share:.1%}, "
            f"self {self.self_share:.1%}, limits {self.limit_share:.0%}, "
            f"peak {self.peak_speed:.1f} rad/s"
        )


def _smooth_quat(quat: np.ndarray, sigma: float) -> np.ndarray:
    """Gaussian over sign-continuous quaternions, good for small widths."""
    return rotations.normalize(smooth(rotations.make_continuous(quat), sigma))


def _direction(motion: HumanMotion, start: str, end: str, sigma: float) -> np.ndarray:
    """(T, 3) unit vector from one joint to another, smoothed."""
    bone = smooth(motion.joint(end) - motion.joint(start), sigma)
    return bone / np.maximum(np.linalg.norm(bone, axis=1, keepdims=True), 1e-9)


def _foot_angles(motion: HumanMotion, side: str) -> tuple[np.ndarray, np.ndarray]:
    """Yaw and pitch (T,) of the foot, radians, pitch up positive.

    The yaw is the twist of the foot's rotation about the vertical, which stays defined
    when the foot points straight down; the pitch that of the line from ankle to ball.
    """
    quat = motion.orientation(f"{side}_ankle")
    yaw = np.unwrap(2.0 * np.arctan2(quat[:, 3], quat[:, 0]))
    bone = motion.joint(f"{side}_toe") - motion.joint(f"{side}_ankle")
    ahead = bone[:, 0] * np.cos(yaw) + bone[:, 1] * np.sin(yaw)
    return yaw, np.arctan2(bone[:, 2], ahead)


def _lock(values: np.ndarray, contact: np.ndarray) -> np.ndarray:
    """Hold ``values (T, n)`` at their median in each stance, shift swings to fit."""
    spans = runs(contact)
    if not spans:
        return values
    frames, shifts = [], []
    for start, stop in spans:
        held = np.median(values[start:stop], axis=0)
        frames += range(start, stop)
        shifts += list(held - values[start:stop])
    at = np.arange(len(values))
    table = np.array(shifts)
    shift = [np.interp(at, frames, table[:, k]) for k in range(values.shape[1])]
    return values + np.stack(shift, 1)


def _foot_targets(
    motion: HumanMotion, contact: np.ndarray, side: str, scale: float, sigma: float
) -> tuple[np.ndarray, np.ndarray]:
    """Pose of ``*_ankle_roll_link``: stance flat, still and on the ground."""
    stands = contact[:, SIDES.index(side)]
    sign = 1.0 if side == "left" else -1.0
    ankle = motion.joint(f"{side}_ankle")
    human_half = 0.5 * motion.bone_length("left_hip", "right_hip")
    heading = rotations.heading(_smooth_quat(motion.orientation("hips"), 0.2 * FPS))
    widen = np.array([0.0, sign * (HIP_HALF_WIDTH - scale * human_half), 0.0])
    position = ankle * scale + rotations.rotate(heading, widen)
    level = ground_level(motion, "ankle")
    position[:, 2] = np.maximum(scale * (ankle[:, 2] - level), 0.0)
    yaw, pitch = _foot_angles(motion, side)
    rest = np.median(pitch[stands]) if stands.any() else np.percentile(pitch, 60)
    pitch = np.clip(pitch - rest, -0.9, 0.5)
    pose = np.concatenate((position, yaw[:, None], pitch[:, None]), axis=1)
    pose[stands, 2] = 0.0
    pose[stands, 4] = 0.0
    pose = _lock(pose, stands)
    moving = smooth(pose, sigma)
    pose = np.where(stands[:, None], pose, moving)
    tilt = rotations.from_axis_angle(np.array([0.0, 1, 0]), -pose[:, 4])
    quat = rotations.multiply(rotations.from_yaw(pose[:, 3]), tilt)
    corners = rotations.rotate(quat[:, None], SOLE_CORNERS[None])
    lowest = -corners[..., 2].min(1)
    position = pose[:, :3].copy()
    position[:, 2] = np.maximum(pose[:, 2] + ANKLE_HEIGHT, lowest)
    return position, quat


def make_targets(motion: HumanMotion, config: RetargetConfig) -> Targets:
    """Scale ``motion`` (at `FPS`) to the G1 and lock its standing feet."""
    sigma = config.smooth_s * FPS
    contact = foot_contacts(motion)
    scale = (THIGH + SHANK) / motion.leg_length
    pelvis_quat = _smooth_quat(motion.orientation("hips"), sigma)
    torso_quat = _smooth_quat(motion.orientation("chest"), sigma)
    hip = smooth(motion.hip_center, sigma) * scale
    level = ground_level(motion, "ankle")
    hip[:, 2] = config.crouch * (hip[:, 2] - scale * level) + ANKLE_HEIGHT
    pelvis = hip - rotations.rotate(pelvis_quat, np.array([0.0, 0.0, HIP_HEIGHT]))
    pelvis[:, 2] = _soft_floor(pelvis[:, 2], config.lowest_pelvis)
    feet = [_foot_targets(motion, contact, side, scale, sigma) for side in SIDES]
    pelvis[:, 2] -= _reach_drop(pelvis, pelvis_quat, [foot[0] for foot in feet], config)
    torso = pelvis + rotations.rotate(pelvis_quat, TORSO)
    position = {"pelvis": pelvis}
    quat = {"pelvis": pelvis_quat, "torso_link": torso_quat}
    hands = _smooth_quat_columns(operator_points(motion)[1][:, 1:], sigma)
    for index, side in enumerate(SIDES):
        ankle = f"{side}_ankle_roll_link"
        position[ankle], quat[ankle] = feet[index]
        mirrored = SHOULDER * np.array([1.0, 1.0 - 2.0 * index, 1.0])
        shoulder = torso + rotations.rotate(torso_quat, mirrored)
        upper = _direction(motion, f"{side}_shoulder", f"{side}_elbow", sigma)
        fore = _direction(motion, f"{side}_elbow", f"{side}_wrist", sigma)
        elbow = shoulder + UPPER_ARM * upper
        position[f"{side}_elbow_link"] = elbow
        position[f"{side}_wrist_yaw_link"] = elbow + FOREARM * fore
        quat[f"{side}_wrist_yaw_link"] = hands[:, index]
    return Targets(position, quat, contact)


def _soft_floor(height: np.ndarray, lowest: float, bend: float = 0.1) -> np.ndarray:
    """``height``, bent from ``lowest + bend`` on so that it never passes ``lowest``."""
    depth = np.maximum(lowest + bend - height, 0.0)
    return np.where(depth > 0, lowest + bend * np.exp(-depth / bend), height)


def _reach_drop(
    pelvis: np.ndarray, quat: np.ndarray, feet: list[np.ndarray], config: RetargetConfig
) -> np.ndarray:
    """Metres (T,) to lower the pelvis so that both legs reach their feet."""
    longest = np.sqrt(
        THIGH**2 + SHANK**2 + 2 * THIGH * SHANK * np.cos(config.min_knee + 0.1)
    )
    drops = [np.zeros(len(pelvis))]
    for sign, foot in zip((1.0, -1.0), feet, strict=True):
        offset = np.array([0.0, sign * HIP_HALF_WIDTH, HIP_HEIGHT])
        leg = pelvis + rotations.rotate(quat, offset) - foot
        flat = np.linalg.norm(leg[:, :2], axis=1)
        height = np.sqrt(np.maximum(longest**2 - flat**2, 0.2**2))
        drops.append(leg[:, 2] - height)
    need = np.max(drops, axis=0)
    reach = round(0.06 * FPS)
    widened = [
        np.roll(np.pad(need, reach, mode="edge"), k) for k in range(-reach, reach + 1)
    ]
    return smooth(np.max(widened, axis=0)[reach:-reach], reach / 2)


def _smooth_quat_columns(quats: np.ndarray, sigma: float) -> np.ndarray:
    return np.stack([_smooth_quat(quats[:, k], sigma) for k in range(2)], 1)


_COSTS: dict[str, tuple[float, float]] = {
    "pelvis": (40.0, 1.5),
    "torso_link": (0.0, 5.0),
    **{f"{side}_ankle_roll_link": (200.0, 40.0) for side in SIDES},
    **{f"{side}_elbow_link": (4.0, 0.0) for side in SIDES},
    **{f"{side}_wrist_yaw_link": (8.0, 0.6) for side in SIDES},
}
"""Link -> weights of its position (1/m) and orientation (1/rad)."""


def collision_pairs() -> list[tuple[list[str], list[str]]]:
    """Groups of collision geoms of the G1 that are kept apart."""

    def named(side: str, parts: tuple[str, ...]) -> list[str]:
        return [f"{side}_{part}_collision" for part in parts]

    trunk = [f"{part}_collision" for part in _TRUNK]
    left, right = named("left", _ARM), named("right", _ARM)
    legs = named("left", _LEG) + named("right", _LEG)
    inner = (*_LEG, "linkage_brace")
    return [
        (left, right),
        (left + right, trunk + legs),
        (named("left", ("thigh", "shin", "linkage_brace")), named("right", inner[1:])),
    ]


class _FrameLimit(mink.Limit):
    """Joint ranges, and how far a joint may move between two frames.

    mink's own velocity limit bounds one solver step; with several steps a frame the
    solver would either lag or exceed the speed.
    """

    def __init__(self, lower: np.ndarray, upper: np.ndarray, reach: float) -> None:
        self._range = lower, upper
        self._reach = reach
        rows = np.concatenate((np.zeros((g1.NUM_JOINTS, 6)), np.eye(g1.NUM_JOINTS)), 1)
        self._rows = np.concatenate((rows, -rows))
        self.start(None)

    def start(self, joints: np.ndarray | None) -> None:
        """Begin a frame after ``joints (29,)``; None lifts the speed limit."""
        self._lower, self._upper = self._range
        if joints is not None:
            self._lower = np.maximum(self._lower, joints - self._reach)
            self._upper = np.minimum(self._upper, joints + self._reach)

    def compute_qp_inequalities(
        self, configuration: mink.Configuration, dt: float
    ) -> mink.Constraint:
        """``rows @ step <= room``."""
        joints = configuration.q[7:]
        room = np.concatenate((self._upper - joints, joints - self._lower))
        return mink.Constraint(G=self._rows, h=np.maximum(room, 0.0))


class Solver:
    """The inverse kinematics of one robot; build once, use for many clips."""

    def __init__(self, config: RetargetConfig | None = None) -> None:
        self.config = config or RetargetConfig()
        self.model = build_model(floor=False, self_collision=True)
        self._configuration = mink.Configuration(self.model)
        self._tasks = {
            link: mink.FrameTask(link, "body", *costs, lm_damping=0.01)
            for link, costs in _COSTS.items()
        }
        self._posture = mink.PostureTask(self.model, cost=0.02)
        self._damping = mink.DampingTask(self.model, cost=0.05)
        lower, upper = _joint_ranges(self.config)
        self._limit = _FrameLimit(lower, upper, self.config.max_joint_speed / FPS)
        # mink divides the allowed approach by the time step; ours is 1, so that the
        # gain is the share of the free distance used in one step.
        self._apart = mink.CollisionAvoidanceLimit(
            self.model,
            collision_pairs(),
            gain=0.5,
            minimum_distance_from_collisions=self.config.clearance,
            collision_detection_distance=0.08,
            # Negative: links that did get inside each other are driven apart.
            bound_relaxation=-0.001,
        )
        self.unsolved = 0

    def _step(self) -> float:
        """One solver step; returns the largest joint move, radians."""
        tasks = [*self._tasks.values(), self._posture, self._damping]
        for limits in ([self._limit, self._apart], [self._limit]):
            try:
                step = mink.solve_ik(
                    self._configuration, tasks, 1.0, "daqp", limits=limits
                )
            except mink.NoSolutionFound:
                self.unsolved += 1
                continue
            self._configuration.integrate_inplace(step, 1.0)
            return float(np.abs(step[6:]).max())
        return 0.0

    def _aim(self, targets: Targets, frame: int) -> None:
        for link, task in self._tasks.items():
            place, turn = targets.position.get(link), targets.quat.get(link)
            pose = np.concatenate(
                (
                    rotations.IDENTITY if turn is None else turn[frame],
                    np.zeros(3) if place is None else place[frame],
                )
            )
            task.set_target(mink.SE3(pose))

    def track(self, targets: Targets) -> np.ndarray:
        """Joint and root positions ``(T, 36)`` that follow ``targets``."""
        pelvis = targets.position["pelvis"][0], targets.quat["pelvis"][0]
        start = np.concatenate((*pelvis, g1.DEFAULT_POSE))
        self._configuration.update(start)
        self._posture.set_target(start)
        qpos = np.empty((len(targets.contact), self.model.nq))
        for frame in range(len(qpos)):
            self._limit.start(qpos[frame - 1, 7:] if frame else None)
            self._aim(targets, frame)
            for _ in range(self.config.solves if frame else self.config.first_solves):
                if self._step() < self.config.converged:
                    break
            qpos[frame] = self._configuration.q
        return qpos


def _joint_ranges(config: RetargetConfig) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper joint limits (29,) that the retargeting keeps, radians."""
    lower, upper = g1.JOINT_LOWER.copy(), g1.JOINT_UPPER.copy()
    for side in SIDES:
        # A straight knee is singular: its speed explodes at the stretched leg.
        lower[g1.joint_index(f"{side}_knee_joint")] = config.min_knee
        # No human turns the legs out as far as the G1 can.
        for name, most in (("hip_roll", 1.3), ("hip_yaw", 1.4)):
            index = g1.joint_index(f"{side}_{name}_joint")
            lower[index] = max(lower[index], -most)
            upper[index] = min(upper[index], most)
    return lower, upper


def start_at_origin(qpos: np.ndarray) -> np.ndarray:
    """Move the first frame's pelvis to xy = (0, 0) and turn its heading to +X."""
    turn = rotations.conjugate(rotations.heading(qpos[0, 3:7]))
    out = qpos.copy()
    out[:, :3] = rotations.rotate(turn, qpos[:, :3] - np.append(qpos[0, :2], 0.0))
    out[:, 3:7] = rotations.multiply(np.tile(turn, (len(qpos), 1)), qpos[:, 3:7])
    return out


def measure(
    model: mujoco.MjModel, qpos: np.ndarray, targets: Targets
) -> RetargetQuality:
    """Quality of ``qpos (T, 36)`` against ``targets``, in their common world."""
    data = mujoco.MjData(model)
    feet = [model.body(f"{side}_ankle_roll_link").id for side in SIDES]
    wrists = [model.body(f"{side}_wrist_yaw_link").id for side in SIDES]
    frames = len(qpos)
    foot, wrist = np.empty((frames, 2, 3)), np.empty((frames, 2, 3))
    sole, inside = np.empty(frames), np.zeros(frames, dtype=bool)
    for frame in range(frames):
        data.qpos[:] = qpos[frame]
        mujoco.mj_kinematics(model, data)
        mujoco.mj_collision(model, data)
        foot[frame], wrist[frame] = data.xpos[feet], data.xpos[wrists]
        corners = [data.xmat[f].reshape(3, 3)[2] @ SOLE_CORNERS.T for f in feet]
        sole[frame] = (np.array(corners) + data.xpos[feet, 2][:, None]).min()
        inside[frame] = data.ncon > 0 and data.contact.dist.min() < -0.005
    stands = targets.contact[1:] & targets.contact[:-1]
    speed = np.linalg.norm(np.diff(foot[..., :2], axis=0), axis=-1) * FPS
    joints = qpos[:, 7:]
    at_limit = (joints < g1.JOINT_LOWER + 0.01) | (joints > g1.JOINT_UPPER - 0.01)

    def residual(found: np.ndarray, link: str) -> float:
        wanted = [targets.position[f"{side}_{link}"] for side in SIDES]
        return 1e3 * float(np.linalg.norm(found - np.stack(wanted, 1), axis=-1).mean())

    return RetargetQuality(
        ankle_mm=residual(foot, "ankle_roll_link"),
        wrist_mm=residual(wrist, "wrist_yaw_link"),
        slide_cm_s=100 * float(speed[stands].mean()) if stands.any() else 0.0,
        ground_share=float((sole < -0.005).mean()),
        self_share=float(inside.mean()),
        limit_share=float(at_limit.any(1).mean()),
        peak_speed=float(np.abs(np.diff(joints, axis=0)).max() * FPS),
    )


def retarget(
    motion: HumanMotion, info: ClipInfo, solver: Solver | None = None
) -> tuple[Clip, RetargetQuality]:
    """Make a G1 clip at 50 frames per second of a recording.

    The clip starts above the origin, heading along +X.

    Raises:
        InputError: the robot cannot follow this recording.
    """
    solver = solver or Solver()
    targets = make_targets(motion_at_origin(motion.resampled(FPS)), solver.config)
    qpos = solver.track(targets)
    quality = measure(solver.model, qpos, targets)
    if quality.ankle_mm > 80 or quality.wrist_mm > 200:
        raise InputError(
            f"the robot cannot follow it ({quality.summary()})",
            where=motion.name,
            remedy="leave this recording out",
        )
    return clip_from_qpos(info, start_at_origin(qpos)), quality
