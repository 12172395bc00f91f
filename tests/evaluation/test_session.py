"""Programmes, their operators, and what a session is measured against."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from openclone.errors import InputError
from openclone.evaluation.operator import (
    HEAD_HEIGHT,
    calibration_of_operator,
    operator_of,
)
from openclone.evaluation.programme import make_programme, place_head
from openclone.evaluation.session import reference_at, session_results
from openclone.motion.clip import Clip, ClipInfo, clip_from_qpos
from openclone.policy.command import KeyPoints
from openclone.robot import g1
from openclone.robot.kinematics import Kinematics
from openclone.robot.model import standing_qpos
from openclone.spatial import rotations
from openclone.teleop.calibration import RobotBody, calibrate
from openclone.teleop.messages import Phase


@pytest.fixture(scope="module")
def kinematics() -> Kinematics:
    return Kinematics()


def walk(name: str, yaw: float = 0.0, frames: int = 51) -> Clip:
    """A clip that glides 1 m along its own heading, which starts at ``yaw``."""
    qpos = np.tile(standing_qpos(), (frames, 1))
    way = np.linspace(0, 1, frames)
    qpos[:, 0], qpos[:, 1] = way * np.cos(yaw), way * np.sin(yaw)
    qpos[:, 3:7] = rotations.from_yaw(np.array(yaw))
    return clip_from_qpos(ClipInfo(name, "forward", "test", "", 50.0), qpos)


def turn_left(name: str) -> Clip:
    qpos = np.tile(standing_qpos(), (51, 1))
    qpos[:, 3:7] = rotations.from_yaw(np.linspace(0, np.pi / 2, 51))
    return clip_from_qpos(ClipInfo(name, "turn", "test", "", 50.0), qpos)


def test_programme_continues_where_the_last_clip_ended():
    clips = [walk("a", yaw=1.0), turn_left("b"), walk("c", yaw=-2.0)]
    programme = make_programme(clips, "all")
    clip = programme.clip
    assert [part.name for part in programme.parts] == ["a", "b", "c"]
    assert programme.parts[-1].last == clip.num_frames
    # 1 m along heading 1 rad, a left turn, then 1 m along heading 1 + pi/2.
    corner = np.array([np.cos(1.0), np.sin(1.0)])
    end = corner + np.array([-np.sin(1.0), np.cos(1.0)])
    assert clip.root_position[-1, :2] == pytest.approx(end, abs=1e-6)
    assert np.abs(np.diff(clip.root_position, axis=0)).max() < 0.05


def test_a_programme_of_nothing_is_refused():
    with pytest.raises(InputError, match="one clip"):
        make_programme([], "empty")


def test_calibration_of_the_operator_gives_back_the_key_points(kinematics):
    rng = np.random.default_rng(0)
    qpos = np.tile(standing_qpos(), (5, 1))
    qpos[:, :2] += rng.uniform(-1, 1, (5, 2))
    qpos[:, 3:7] = rotations.from_yaw(rng.uniform(-3, 3, 5))
    qpos[:, 2] -= np.linspace(0, 0.2, 5)
    elbow = 7 + g1.joint_index("left_elbow_joint")
    qpos[:, elbow] += rng.uniform(0.0, 0.5, 5)  # bent arms stay within reach
    clip = clip_from_qpos(ClipInfo("x", "wave", "test", "", 50.0), qpos)
    recording = operator_of(clip, kinematics)
    home = standing_qpos()
    measured = KeyPoints(*kinematics.key_points(home))
    calibration = calibrate(
        recording.positions[0],
        recording.quats[0],
        measured,
        home[3:7],
        RobotBody.of(kinematics),
        calibration_of_operator(),
    )
    placed = place_head(qpos, kinematics.bodies(qpos[0]), measured.position[0, :2])
    for index, row in enumerate(placed):
        target = calibration.apply(recording.positions[index], recording.quats[index])
        points, quats = kinematics.key_points(row)
        assert target.position == pytest.approx(points, abs=1e-6)
        assert rotations.angle_between(target.quat, quats) == pytest.approx(0, abs=1e-6)
    standing = kinematics.key_points(home)[0][0, 2]
    human = HEAD_HEIGHT * kinematics.key_points(qpos[0])[0][0, 2] / standing
    assert recording.positions[0, 0, 2] == pytest.approx(human)


def test_reference_between_frames():
    qpos = walk("a").qpos
    middle = reference_at(qpos, np.array([0.01, 0.5, 99.0]))
    assert middle[:, 0] == pytest.approx([0.01, 0.5, 1.0])


def session(qpos: np.ndarray, shown_s: np.ndarray, fallen_at: int | None = None):
    """A finished session with only what the measurement looks at."""
    fallen = np.zeros(len(qpos), dtype=bool)
    if fallen_at is not None:
        fallen[fallen_at:] = True
    log = SimpleNamespace(
        qpos=qpos,
        fallen=fallen,
        phase=np.full(len(qpos), int(Phase.ACTIVE)),
        num_ticks=len(qpos),
    )
    return SimpleNamespace(log=log, recording_time_s=shown_s)


def test_parts_of_a_session_are_measured_apart(kinematics):
    programme = make_programme([walk("a"), turn_left("b")], "all")
    reference = programme.clip.qpos
    shown_s = np.concatenate(([-1.0, 0.0, 0.0], np.arange(len(reference)) * 0.02))
    qpos = reference_at(reference, shown_s)
    qpos[:, 1] += 0.1
    results = session_results(
        session(qpos, shown_s), reference, programme.parts, kinematics
    )
    assert list(results) == ["a", "b"]
    for result in results.values():
        assert result.metrics.sr == 1.0
        assert result.metrics.mpkpe_mm == pytest.approx(100.0, abs=1e-3)
        assert result.metrics.r_mpkpe_mm == pytest.approx(0.0, abs=1e-3)
    assert results["a"].metrics.seconds == pytest.approx(1.0)  # without its frame 0


def test_the_part_with_the_fall_fails_and_later_ones_are_not_reached(kinematics):
    programme = make_programme([walk("a"), turn_left("b")], "all")
    reference = programme.clip.qpos
    shown_s = np.arange(30) * 0.02
    ended = session(reference_at(reference, shown_s), shown_s, fallen_at=29)
    results = session_results(ended, reference, programme.parts, kinematics)
    assert list(results) == ["a"]
    assert results["a"].metrics.sr == 0.0


def test_a_fall_before_the_operator_moves_counts_for_the_first_part(kinematics):
    programme = make_programme([walk("a"), turn_left("b")], "all")
    reference = programme.clip.qpos
    shown_s = np.zeros(40)
    ended = session(reference_at(reference, shown_s), shown_s, fallen_at=39)
    results = session_results(ended, reference, programme.parts, kinematics)
    assert list(results) == ["a"]
    assert results["a"].metrics.sr == 0.0


def test_a_fall_in_the_tail_counts_for_the_last_part(kinematics):
    programme = make_programme([walk("a"), turn_left("b")], "all")
    reference = programme.clip.qpos
    shown_s = np.minimum(np.arange(len(reference) + 30) * 0.02, programme.clip.seconds)
    qpos = reference_at(reference, shown_s)
    ended = session(qpos, shown_s, fallen_at=len(qpos) - 1)
    results = session_results(ended, reference, programme.parts, kinematics)
    assert results["a"].metrics.sr == 1.0
    assert results["b"].metrics.sr == 0.0
