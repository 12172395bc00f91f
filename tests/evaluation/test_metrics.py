"""Metrics against values worked out by hand."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from openclone.evaluation import metrics
from openclone.robot import g1
from openclone.robot.kinematics import Kinematics
from openclone.robot.model import standing_qpos
from openclone.spatial import rotations

FRAMES = 40
PERIOD = 0.02


@pytest.fixture(scope="module")
def standing() -> metrics.Trace:
    """A robot that stands exactly where it should."""
    position, quat = Kinematics().trajectory(np.tile(standing_qpos(), (FRAMES, 1)))
    contact = np.ones((FRAMES, 2), dtype=bool)
    return metrics.Trace(PERIOD, position, quat, position, quat, contact, False)


def turned(trace: metrics.Trace, angle: float) -> metrics.Trace:
    """The robot turned as a whole about the world's Z axis."""
    turn = rotations.from_yaw(np.array(angle)) * np.ones((*trace.quat.shape[:2], 1))
    return replace(
        trace,
        position=rotations.rotate(turn, trace.position),
        quat=rotations.multiply(turn, trace.quat),
    )


def test_perfect_tracking_has_no_error(standing):
    result = metrics.measure(standing)
    assert result.sr == 1.0
    errors = (result.mpkpe_mm, result.r_mpkpe_mm, result.e_vel_mm_s, result.drift_mm)
    assert errors == pytest.approx((0, 0, 0, 0), abs=1e-9)
    assert result.e_hand_x100 == pytest.approx(0, abs=1e-9)
    assert result.seconds == pytest.approx(0.8)


def test_constant_offset_is_global_but_not_root_relative(standing):
    offset = np.array([0.03, 0.04, 0.12])  # length 13 cm, 5 cm of it horizontal
    result = metrics.measure(replace(standing, position=standing.position + offset))
    assert result.mpkpe_mm == pytest.approx(130.0)
    assert result.r_mpkpe_mm == pytest.approx(0.0, abs=1e-9)
    assert result.e_vel_mm_s == pytest.approx(0.0, abs=1e-6)
    assert result.drift_mm == pytest.approx(50.0)
    assert result.sr == 1.0


def test_turn_of_the_whole_robot(standing):
    angle = math.radians(40)
    result = metrics.measure(turned(standing, angle))
    radius = np.linalg.norm(standing.position[0, :, :2], axis=1)
    chord = 2 * radius * math.sin(angle / 2)
    assert result.mpkpe_mm == pytest.approx(1000 * chord.mean())
    assert result.r_mpkpe_mm == pytest.approx(0.0, abs=1e-6)
    # <q, q_hat> = cos(angle / 2) for a turn by angle.
    assert result.e_hand_x100 == pytest.approx(100 * math.sin(angle / 2) ** 2)


def test_pitch_of_the_root_counts_as_root_relative_error(standing):
    pitch = rotations.from_axis_angle(np.array([0.0, 1.0, 0.0]), 0.2)
    turn = pitch * np.ones((FRAMES, len(g1.KEY_BODIES), 1))
    pelvis = standing.position[:, g1.ROOT, None]
    position = pelvis + rotations.rotate(turn, standing.position - pelvis)
    quat = rotations.multiply(turn, standing.quat)
    result = metrics.measure(replace(standing, position=position, quat=quat))
    arm = np.linalg.norm((standing.position - pelvis)[0][:, [0, 2]], axis=1)
    assert result.r_mpkpe_mm == pytest.approx(1000 * (2 * arm * math.sin(0.1)).mean())


def test_tremor_of_a_robot_that_shakes_as_it_walks(standing):
    walk = 0.8 * PERIOD * np.arange(FRAMES)[:, None, None] * np.array([1.0, 0, 0])
    walking = standing.position + walk
    assert metrics.tremor(walking, PERIOD) == pytest.approx(0.0, abs=1e-9)
    # 12.5 Hz: of five velocities v, -v, -v, v, v four cancel, and the mean about the
    # one in the middle is -1/5 of it.
    shake = 0.002 * np.tile([0.0, 1.0, 0.0, -1.0], FRAMES // 4)
    position = walking + shake[:, None, None] * np.array([0, 0, 1.0])
    result = metrics.measure(replace(standing, position=position))
    assert result.tremor_mm_s == pytest.approx(1.2 * 2 / PERIOD)
    assert result.reference_tremor_mm_s == pytest.approx(0.0, abs=1e-9)
    assert math.isnan(metrics.tremor(walking[:5], PERIOD))


def test_velocity_error_of_a_robot_that_slips_away(standing):
    slip = np.arange(FRAMES)[:, None, None] * PERIOD * np.array([0.3, 0.0, 0.4])
    result = metrics.measure(replace(standing, position=standing.position + slip))
    assert result.e_vel_mm_s == pytest.approx(500.0)
    assert result.drift_mm == pytest.approx(300.0 * PERIOD * (FRAMES - 1))


def test_hand_error_ignores_the_quaternions_sign(standing):
    assert metrics.measure(replace(standing, quat=-standing.quat)).e_hand_x100 < 1e-9


def test_only_hands_enter_the_hand_error(standing):
    quat = standing.quat.copy()
    half_turn = np.array([0.0, 1.0, 0.0, 0.0])
    quat[:, g1.WRISTS[0]] = rotations.multiply(
        quat[:, g1.WRISTS[0]], half_turn * np.ones((FRAMES, 4))
    )
    quat[:, g1.FEET[0]] = np.array([0.0, 0.0, 1.0, 0.0])
    result = metrics.measure(replace(standing, quat=quat))
    assert result.e_hand_x100 == pytest.approx(50.0)  # one of two hands, fully off


def test_a_fall_is_no_success(standing):
    assert metrics.measure(replace(standing, fell=True)).sr == 0.0


@pytest.mark.parametrize(("distance", "success"), [(1.49, 1.0), (1.51, 0.0)])
def test_success_needs_the_points_within_a_metre_and_a_half(
    standing, distance, success
):
    position = standing.position.copy()
    position[FRAMES // 2, :, 0] += distance  # one frame is enough
    assert metrics.measure(replace(standing, position=position)).sr == success


def test_one_stray_hand_is_averaged_over_three_points(standing):
    position = standing.position.copy()
    position[:, g1.WRISTS[0], 0] += 4.4  # 4.4 / 3 < 1.5
    assert metrics.measure(replace(standing, position=position)).sr == 1.0
    position[:, g1.WRISTS[0], 0] += 0.2  # 4.6 / 3 > 1.5
    assert metrics.measure(replace(standing, position=position)).sr == 0.0


def test_average_counts_every_run_once(standing):
    good = metrics.measure(standing)
    short = replace(good, sr=0.0, mpkpe_mm=100.0, e_vel_mm_s=float("nan"), seconds=0.2)
    mean = metrics.average([good, short])
    assert mean.sr == 0.5
    assert mean.mpkpe_mm == pytest.approx(50.0)
    assert mean.e_vel_mm_s == pytest.approx(0.0, abs=1e-9)
    assert mean.seconds == pytest.approx(1.0)
    assert short.to_json()["e_vel_mm_s"] is None


def test_sway_of_a_circle_is_its_radius():
    angle = np.linspace(0, 2 * np.pi, 200, endpoint=False)
    circle = np.stack((np.cos(angle), np.sin(angle), 9 * np.cos(angle)), -1)
    points = np.stack((0.02 * circle + 1.0, 0.01 * circle), axis=1)
    assert metrics.sway(points) == pytest.approx(20.0)


def test_steps_are_contact_breaks_longer_than_chatter():
    contact = np.ones((30, 2), dtype=bool)
    assert metrics.count_steps(contact) == 0
    contact[5, 0] = False  # one frame: chatter
    assert metrics.count_steps(contact) == 0
    contact[10:14, 0] = False
    contact[20:22, 1] = False
    contact[27:, 1] = False  # still in the air at the end
    assert metrics.count_steps(contact) == 3
