"""The synthetic motions obey physics, measured without the generator's own solver."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import mujoco
import numpy as np
import pytest
from scipy.ndimage import maximum_filter1d
from scipy.spatial import ConvexHull

from openclone.errors import InputError
from openclone.motion.clip import CATEGORIES, Clip, check_clip, clip_hash
from openclone.motion.sources import synthetic, whole_body
from openclone.motion.sources.serial_chain import SerialChain
from openclone.motion.sources.track import Track
from openclone.robot import g1
from openclone.robot.model import SOLE_CORNERS, build_model

FPS = 50.0
GRAVITY = 9.81
TOUCH = 0.003
"""Metres; a sole lower than this counts as standing."""
WALKS = ("forward", "backward", "stepside", "turn", "crouchwalk", "transition")


@dataclass(frozen=True)
class Measured:
    """corners (T, 2, 4, 3); com, head (T, 3); hands (T, 2, 3); spin (T, 3)."""

    clip: Clip
    corners: np.ndarray
    com: np.ndarray
    spin: np.ndarray
    head: np.ndarray
    hands: np.ndarray

    @property
    def lowest(self) -> np.ndarray:
        return self.corners[..., 2].min(axis=2)


@cache
def model() -> mujoco.MjModel:
    return build_model(floor=False)


@cache
def colliding_model() -> mujoco.MjModel:
    return build_model(floor=False, self_collision=True)


def measure(clip: Clip) -> Measured:
    data = mujoco.MjData(model())
    qpos, count = clip.qpos, clip.num_frames
    feet = [model().body(f"{side}_ankle_roll_link").id for side in ("left", "right")]
    corners, com = np.empty((count, 2, 4, 3)), np.empty((count, 3))
    spin, head, hands = (
        np.zeros((count, 3)),
        np.empty((count, 3)),
        np.empty((2, count, 3)),
    )
    speed = np.zeros(model().nv)
    for k in range(count):
        # Central difference of the neighbours: two frames apart.
        before, after = qpos[max(k - 1, 0)], qpos[min(k + 1, count - 1)]
        mujoco.mj_differentiatePos(model(), speed, 2 / FPS, before, after)
        data.qpos[:], data.qvel[:] = qpos[k], speed
        mujoco.mj_fwdPosition(model(), data)
        mujoco.mj_fwdVelocity(model(), data)
        mujoco.mj_subtreeVel(model(), data)
        com[k], spin[k] = data.subtree_com[1], data.subtree_angmom[1]
        head[k] = data.site("head").xpos
        for side, name in enumerate(("left", "right")):
            rotation = data.xmat[feet[side]].reshape(3, 3)
            corners[k, side] = data.xpos[feet[side]] + SOLE_CORNERS @ rotation.T
            hands[side, k] = data.site(f"{name}_hand").xpos
    return Measured(clip, corners, com, spin, head, hands)


@cache
def example(category: str, number: int) -> Measured:
    rng = np.random.default_rng([3, CATEGORIES.index(category), number])
    return measure(synthetic.generate(category, rng))


@pytest.fixture(params=[(name, k) for name in CATEGORIES for k in range(2)], ids=str)
def motion(request: pytest.FixtureRequest) -> Measured:
    return example(*request.param)


def zero_moment_point(motion: Measured) -> tuple[np.ndarray, np.ndarray]:
    """(T, 2) from the change of linear and angular momentum, and (T,) N of load."""
    mass = model().body_subtreemass[1]
    acceleration = np.zeros_like(motion.com)
    acceleration[1:-1] = np.diff(motion.com, 2, axis=0) * FPS**2
    torque = np.gradient(motion.spin, 1 / FPS, axis=0)
    load = mass * (acceleration[:, 2] + GRAVITY)
    height = motion.com[:, 2]
    x = motion.com[:, 0] - (height * mass * acceleration[:, 0] + torque[:, 1]) / load
    y = motion.com[:, 1] - (height * mass * acceleration[:, 1] - torque[:, 0]) / load
    return np.stack((x, y), 1), load


def test_clip_is_well_formed(motion: Measured) -> None:
    check_clip(motion.clip, "here")
    assert motion.clip.info.fps == FPS
    assert 4.0 <= motion.clip.seconds <= 12.1


def swings_nearby(lowest: np.ndarray, seconds: float) -> np.ndarray:
    """(T, 2) whether a foot is in the air within ``seconds`` of each frame."""
    return maximum_filter1d(lowest > TOUCH, 2 * round(seconds * FPS) + 1, axis=0)


def test_feet_do_not_sink_and_stand_flat(motion: Measured) -> None:
    assert motion.lowest.min() > -0.002
    tilt = motion.corners[..., 2].max(axis=2) - motion.lowest
    # A foot rolls onto its toes or off its heel only beside a swing of its own.
    standing = (motion.lowest < TOUCH) & ~swings_nearby(motion.lowest, 0.16)
    assert tilt[standing].max() < 0.002


def test_the_only_foot_on_the_ground_is_flat(motion: Measured) -> None:
    down = motion.lowest < TOUCH
    alone = down & ~down[:, ::-1]
    tilt = motion.corners[..., 2].max(axis=2) - motion.lowest
    assert tilt[alone].max(initial=0.0) < 0.012


def test_what_touches_the_ground_does_not_slide(motion: Measured) -> None:
    touching = motion.corners[..., 2] < TOUCH
    standing = touching[1:] & touching[:-1]
    step = np.linalg.norm(np.diff(motion.corners[..., :2], axis=0), axis=-1)
    assert (step * FPS)[standing].max() < 0.01


def test_starts_and_ends_quietly_on_both_feet(motion: Measured) -> None:
    for window in (slice(0, 10), slice(-10, None)):
        assert motion.lowest[window].max() < 1e-3
        speed = np.diff(motion.com[window], axis=0) * FPS
        assert np.abs(speed).max() < 0.05
        joints = np.diff(motion.clip.joint_angles[window], axis=0) * FPS
        assert np.abs(joints).max() < 0.4


def test_joints_keep_to_their_limits(motion: Measured) -> None:
    angles = motion.clip.joint_angles
    assert (angles - g1.JOINT_LOWER).min() > 0.03
    assert (g1.JOINT_UPPER - angles).min() > 0.03
    speed = np.diff(angles, axis=0) * FPS
    assert (np.abs(speed).max(axis=0) < 0.8 * g1.MAX_SPEED).all()
    assert np.abs(np.diff(speed, axis=0) * FPS).max() < 600.0


def test_zero_moment_point_stays_in_the_support(motion: Measured) -> None:
    points, load = zero_moment_point(motion)
    weight = model().body_subtreemass[1] * GRAVITY
    outside = []
    for k in range(2, motion.clip.num_frames - 2):
        feet = motion.lowest[k] < TOUCH
        if load[k - 1 : k + 2].min() < 0.35 * weight or not feet.any():
            continue
        soles = motion.corners[k]
        hull = ConvexHull(soles[soles[..., 2] < TOUCH][:, :2])
        outside.append((hull.equations[:, :2] @ points[k] + hull.equations[:, 2]).max())
    # The tolerance covers the steps between single and double support.
    assert np.quantile(outside, 0.99) < 0.02
    assert max(outside) < 0.06


def test_no_body_part_passes_through_another(motion: Measured) -> None:
    solid = colliding_model()
    data = mujoco.MjData(solid)
    for row in motion.clip.qpos[::4]:
        data.qpos[:] = row
        mujoco.mj_kinematics(solid, data)
        mujoco.mj_collision(solid, data)
        assert (data.contact.dist > -0.006).all()


@pytest.mark.parametrize("category", WALKS)
def test_swinging_feet_clear_the_ground(category: str) -> None:
    lowest = np.concatenate([example(category, k).lowest for k in range(2)])
    if category == "transition" and lowest.max() < TOUCH:
        pytest.skip("this transition has no step")
    assert 0.045 < lowest.max() < 0.1


@pytest.mark.parametrize("category", [c for c in CATEGORIES if c != "jump"])
def test_one_foot_always_stands(category: str) -> None:
    for k in range(2):
        assert example(category, k).lowest.min(axis=1).max() < TOUCH


def test_jump_is_ballistic() -> None:
    for k in range(2):
        motion = example("jump", k)
        flying = motion.lowest.min(axis=1) > 1e-4
        assert 8 <= flying.sum() <= 30
        # Frames whose neighbours fly as well.
        inside = flying[1:-1] & flying[2:] & flying[:-2]
        acceleration = (np.diff(motion.com, 2, axis=0) * FPS**2)[inside]
        assert np.allclose(acceleration[:, 2], -GRAVITY, atol=0.8)
        assert np.abs(acceleration[:, :2]).max() < 0.8
        apart = np.abs(motion.lowest[:, 0] - motion.lowest[:, 1])
        assert apart.max() < 1e-3


def heading_change(motion: Measured) -> float:
    left = motion.corners[:, 0, 2:, :2].mean(1) - motion.corners[:, 0, :2, :2].mean(1)
    yaw = np.unwrap(np.arctan2(left[:, 1], left[:, 0]))
    return float(yaw[-1] - yaw[0])


def test_motions_go_where_their_names_say() -> None:
    assert example("forward", 0).com[-1, 0] > 0.5
    assert example("backward", 0).com[-1, 0] < -0.3
    assert abs(example("stepside", 0).com[-1, 1]) > 0.12
    assert abs(heading_change(example("turn", 0))) > 0.5
    assert np.ptp(example("squat", 0).head[:, 2]) > 0.15
    walking = example("crouchwalk", 0)
    assert walking.head[:, 2].min() < 1.12
    assert walking.com[-1, 0] > 0.3
    wave = example("wave", 0)
    assert (wave.hands[..., 2].max() > wave.head[:, 2] - 0.1).any()
    assert example("punch", 0).hands[..., 0].max() > 0.3
    assert example("pickup", 0).hands[..., 2].min() < 0.45


def test_both_directions_occur() -> None:
    sides = [np.sign(example("stepside", k).com[-1, 1]) for k in range(4)]
    turns = [np.sign(heading_change(example("turn", k))) for k in range(4)]
    assert set(sides) == {-1.0, 1.0}
    assert set(turns) == {-1.0, 1.0}


def test_arms_swing_against_the_legs() -> None:
    found = []
    for index in range(4):
        motion = example("forward", index)
        ahead = motion.corners[:, 0, :, 0].mean(1) - motion.corners[:, 1, :, 0].mean(1)
        left, right = motion.clip.joint_angles[:, 15], motion.clip.joint_angles[:, 22]
        walking = np.abs(ahead) > 0.02
        # A shoulder that pitches up swings its arm back.
        found.append(np.corrcoef(ahead[walking], (left - right)[walking])[0, 1])
    # A third of the walkers carry something or point at something.
    assert np.median(found) > 0.8


def test_chain_agrees_with_mujoco() -> None:
    data = mujoco.MjData(model())
    rng = np.random.default_rng(0)
    ends = (("left_ankle_roll_link", "pelvis"), ("right_wrist_yaw_link", "torso_link"))
    for end, base in ends:
        chain = SerialChain.of(model(), base, end, (0.0, 0.0, 0.0))
        angles = rng.uniform(chain.lower, chain.upper, (20, len(chain.joints)))
        pose = chain.forward(angles)
        for k in range(20):
            data.qpos[7:] = 0.0
            data.qpos[7 + chain.joints] = angles[k]
            mujoco.mj_kinematics(model(), data)
            root = data.body(base)
            rotation = root.xmat.reshape(3, 3)
            position = rotation.T @ (data.body(end).xpos - root.xpos)
            assert np.allclose(pose.position[k], position, atol=1e-9)
            there = rotation.T @ data.body(end).xmat.reshape(3, 3)
            assert np.allclose(pose.rotation[k], there, atol=1e-9)


def test_inverse_undoes_forward() -> None:
    chain = SerialChain.of(model(), "pelvis", "left_ankle_roll_link", (0.0, 0.0, 0.0))
    rng = np.random.default_rng(1)
    middle = g1.DEFAULT_POSE[:6]
    angles = middle + rng.uniform(-0.2, 0.2, (50, 6))
    pose = chain.forward(angles)
    start = np.tile(middle, (50, 1))
    found, error = chain.reach_pose(pose.position, pose.rotation, start)
    assert error.max() < 1e-4
    assert np.allclose(found, angles, atol=2e-3)


def test_centre_of_mass_follows_newton() -> None:
    """On a step of the zero-moment point: the inverted pendulum's exponential."""
    height, fps = 0.7, 200.0
    time_s = np.arange(0, 4, 1 / fps)
    zmp = np.zeros((len(time_s), 2))
    zmp[time_s >= 2.0, 0] = 0.1
    lift = np.full(len(time_s), GRAVITY)
    com = whole_body.com_from_zmp(zmp, np.full(len(time_s), height), lift, fps)
    rate = np.sqrt(GRAVITY / height)
    expected = 0.05 * np.exp(-rate * np.abs(time_s - 2.0))
    expected = np.where(time_s < 2.0, expected, 0.1 - expected)
    assert np.allclose(com[:, 0], expected, atol=1e-3)
    assert np.allclose(com[:, 1], 0.0)


def test_centre_of_mass_flies_straight() -> None:
    lift = np.full(200, GRAVITY)
    lift[90:110] = 0.0
    zmp = np.zeros((200, 2))
    zmp[100:, 0] = 0.3
    com = whole_body.com_from_zmp(zmp, np.full(200, 0.7), lift, FPS)
    speed = np.diff(com[:, 0])[90:109]
    assert np.ptp(speed) < 1e-9
    assert speed[0] > 0


def test_track_moves_add_up() -> None:
    track = Track([1.0])
    track.move(0.0, 1.0, 2.0)
    track.move(0.5, 1.5, 5.0)
    track.bump(2.0, 3.0, 7.0)
    values = track.at(np.array([-1.0, 0.0, 1.5, 2.5, 3.0]))[:, 0]
    assert np.allclose(values, [1.0, 1.0, 5.0, 12.0, 5.0])


def test_same_seed_same_clips_whatever_the_workers(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # Spawned processes import the module afresh: they know all the categories.
    monkeypatch.setattr(synthetic, "CATEGORIES", ("stand", "forward"))
    first = synthetic.default_set(5, minutes=0.3)
    again = synthetic.default_set(5, minutes=0.3, workers=2)
    other = synthetic.default_set(6, minutes=0.3)
    assert {clip.info.category for clip in first} == {"stand", "forward"}
    assert len({clip.info.name for clip in first}) == len(first)
    assert clip_hash(first) == clip_hash(again) != clip_hash(other)
    assert sum(clip.seconds for clip in first) >= 18.0
    shapes = {clip.joint_angles[100].tobytes() for clip in first}
    assert len(shapes) == len(first)


def test_a_lower_pace_walks_slower() -> None:
    def reach(pace: float) -> float:
        rng = np.random.default_rng(2)
        clip = synthetic.generate("forward", rng, pace=pace)
        speed = np.linalg.norm(np.diff(clip.root_position[:, :2], axis=0), axis=1)
        return float(np.convolve(speed * FPS, np.ones(50) / 50, "valid").max())

    # The sway of the pelvis adds a little to both.
    assert reach(0.4) < 0.7 * reach(1.0)


def test_unknown_category_is_refused() -> None:
    with pytest.raises(InputError, match=r"moonwalk.*use one of"):
        synthetic.generate("moonwalk", np.random.default_rng(0))
