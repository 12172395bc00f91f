"""Closed-loop runs with stand-ins for the student."""

from __future__ import annotations

import json

import numpy as np
import pytest

from openclone.errors import InputError
from openclone.evaluation.episode import has_fallen, make_reference
from openclone.evaluation.standing import evaluate_standing
from openclone.evaluation.tracking import TrackingReport, evaluate_tracking
from openclone.motion.clip import Clip, ClipInfo, clip_from_qpos
from openclone.policy import observation
from openclone.policy.bundle import Bundle, g1_info
from openclone.policy.command import command_of
from openclone.robot import g1
from openclone.robot.kinematics import Kinematics
from openclone.robot.model import build_model, standing_qpos
from openclone.spatial import rotations
from openclone.training.reference import build_reference


class FakeBundle(Bundle):
    """Always the same joint targets; remembers what it saw."""

    def __init__(self, joint_targets: np.ndarray) -> None:
        super().__init__(g1_info("fake", "", ""), None)
        self.action = (joint_targets - g1.DEFAULT_POSE) / g1.ACTION_SCALE
        self.seen: list[np.ndarray] = []

    def act(self, observations: np.ndarray) -> np.ndarray:
        self.seen.append(observations[0].copy())
        return np.tile(self.action, (len(observations), 1))


def still_clip(seconds: float, name: str = "still", fps: float = 50.0) -> Clip:
    frames = round(seconds * fps) + 1
    info = ClipInfo(name, "stand", "test", "", fps)
    return clip_from_qpos(info, np.tile(standing_qpos(), (frames, 1)))


@pytest.fixture(scope="module")
def short() -> tuple[TrackingReport, FakeBundle]:
    bundle = FakeBundle(g1.DEFAULT_POSE)
    clips = [still_clip(0.4, "a"), still_clip(0.2, "b", fps=100.0)]
    return evaluate_tracking(clips, bundle, noise=None), bundle


def test_motors_that_hold_the_pose_track_a_still_clip_for_a_moment(short):
    report, _ = short
    assert report.overall.sr == 1.0
    assert report.overall.mpkpe_mm < 20.0
    assert report.overall.e_hand_x100 < 1.0  # soft wrists sag a little
    assert report.clips["a"].qpos.shape == (20, 36)
    assert report.clips["b"].metrics.seconds == pytest.approx(0.2)


def test_json_carries_the_promised_keys(short):
    report, _ = short
    data = json.loads(json.dumps(report.to_json(), allow_nan=False))
    keys = {"sr", "mpkpe_mm", "r_mpkpe_mm", "e_vel_mm_s", "e_hand_x100"}
    assert keys <= data.keys()
    assert keys <= data["categories"]["stand"].keys()
    assert keys <= data["clips"]["a"].keys()
    assert data["num_clips"] == 2


def test_first_observation_has_no_position_error(short):
    _, bundle = short
    difference = bundle.seen[0][:9]
    # The robot starts on the reference and the reference stands still.
    assert difference == pytest.approx(np.zeros(9), abs=1e-6)
    assert bundle.seen[0][18:27] == pytest.approx(np.zeros(9), abs=1e-6)  # velocity
    assert bundle.seen[0].shape == (observation.student_size(),)


def test_a_folding_robot_falls_and_the_clip_ends_there():
    limp = g1.DEFAULT_POSE.copy()
    limp[[g1.joint_index(f"{s}_hip_pitch_joint") for s in ("left", "right")]] = 1.5
    report = evaluate_tracking([still_clip(4.0)], FakeBundle(limp), noise=None)
    result = report.clips["still"]
    assert result.metrics.sr == 0.0
    assert result.metrics.seconds < 3.0
    assert len(result.error_mm) == len(result.qpos) < 150


def test_odometry_noise_reaches_the_student_and_depends_on_seed_and_name_only():
    def differences(names: list[str], seed: int) -> np.ndarray:
        bundle = FakeBundle(g1.DEFAULT_POSE)
        evaluate_tracking([still_clip(0.2, n) for n in names], bundle, seed=seed)
        return np.array(bundle.seen)[-10:, :9]

    alone, after_another = differences(["x"], 1), differences(["y", "x"], 1)
    assert np.array_equal(alone, after_another)
    assert not np.array_equal(alone, differences(["x"], 2))
    # One offset for all three points: at rest it is the same for head and hands.
    first = alone[0].reshape(3, 3)
    assert np.abs(first).max() > 1e-5
    assert first == pytest.approx(np.tile(first[0], (3, 1)), abs=1e-6)


def test_reference_velocities_are_those_of_a_sliding_clip():
    qpos = np.tile(standing_qpos(), (31, 1))
    qpos[:, 0] = 0.8 * np.arange(31) / 30.0  # 0.8 m/s at 30 frames/s
    clip = clip_from_qpos(ClipInfo("slide", "forward", "test", "", 30.0), qpos)
    reference = make_reference(clip, build_model())
    assert reference.qpos.shape == (51, 36)
    expected = np.tile([0.8, 0.0, 0.0], (51, 3, 1))
    assert reference.point_velocities == pytest.approx(expected, abs=1e-6)
    assert reference.start_velocity[:3] == pytest.approx([0.8, 0, 0], abs=1e-6)


def test_commands_are_those_of_training():
    qpos = np.tile(standing_qpos(), (40, 1))
    qpos[:, 7:] += 0.1 * np.random.default_rng(0).standard_normal((40, 29))
    clip = clip_from_qpos(ClipInfo("shaky", "wave", "test", "", 50.0), qpos)
    model = build_model()
    told = command_of(build_reference([clip], model).frames)
    reference = make_reference(clip, model)
    np.testing.assert_allclose(reference.points, told.target.position, atol=1e-5)
    np.testing.assert_allclose(reference.point_velocities, told.velocity, atol=1e-4)


def test_a_clip_shorter_than_a_control_step_is_refused():
    with pytest.raises(InputError, match="control step"):
        make_reference(still_clip(0.01, fps=100.0), build_model())


def test_fall_is_low_pelvis_or_tilted_trunk():
    position, quat = (x.copy() for x in Kinematics().bodies(standing_qpos()))
    assert not has_fallen(position, quat, quat)
    low = position - np.array([0.0, 0.0, 0.6])
    assert has_fallen(low, quat, quat)
    axis = np.array([1.0, 0.0, 0.0])
    for tilt_deg, fallen in ((59.0, False), (61.0, True)):
        turn = rotations.from_axis_angle(axis, np.radians(tilt_deg)) * np.ones((14, 1))
        tilted = rotations.multiply(turn, quat)
        assert has_fallen(position, tilted, quat) == fallen
        assert not has_fallen(position, tilted, tilted)  # bowing with the reference


def test_standing_report_of_a_robot_that_only_holds_its_pose():
    report = evaluate_standing(FakeBundle(g1.DEFAULT_POSE), seconds=0.6, noise=None)
    assert not report.fell
    assert report.seconds == pytest.approx(0.6)
    assert report.steps == 0
    assert report.sway_mm < 10.0


@pytest.mark.parametrize(
    ("names", "message"), [([], "no clips"), (["a", "a"], "twice")]
)
def test_clips_must_be_there_and_be_told_apart(names, message):
    with pytest.raises(InputError, match=message):
        evaluate_tracking([still_clip(0.1, n) for n in names], FakeBundle(np.zeros(29)))
