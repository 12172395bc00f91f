"""TUM files as evo reads them, and errors against worked values."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from evo.core import metrics, sync
from evo.tools import file_interface

from openclone.errors import InputError
from openclone.odometry.trajectory import (
    Trajectory,
    compare,
    read_tum,
    rigid_alignment,
    sample_at,
    write_tum,
)
from openclone.spatial import rotations

START_NS = 1_700_000_000_000_000_001


def helix(count: int = 80) -> Trajectory:
    t = np.linspace(0, 8, count)
    positions = np.stack([2 * np.cos(t), 2 * np.sin(t), 0.2 * t], axis=1)
    stamps = START_NS + (t * 1e9).astype(np.int64)
    return Trajectory(stamps, positions, np.asarray(rotations.from_yaw(t)))


def moved(path: Trajectory, noise: float, seed: int) -> Trajectory:
    """The same path in another world, with noise."""
    rng = np.random.default_rng(seed)
    turn = np.asarray(rotations.from_rotation_vector(rng.standard_normal(3)))
    shift = np.array([3.0, -1.0, 7.0]) + noise * rng.standard_normal((len(path), 3))
    positions = np.asarray(rotations.rotate(turn, path.positions)) + shift
    quats = np.asarray(rotations.multiply(turn, path.quats))
    return Trajectory(path.stamps_ns, positions, quats)


def test_round_trip_keeps_nanoseconds(tmp_path: Path) -> None:
    path = helix()
    write_tum(path, tmp_path / "a.tum")
    back = read_tum(tmp_path / "a.tum")
    np.testing.assert_array_equal(back.stamps_ns, path.stamps_ns)
    np.testing.assert_allclose(back.positions, path.positions, atol=1e-9)
    np.testing.assert_allclose(back.quats, path.quats, atol=1e-8)


def test_evo_reads_it_and_finds_the_same_error(tmp_path: Path) -> None:
    truth = helix()
    estimate = moved(truth, 0.03, 0)
    write_tum(truth, tmp_path / "truth.tum")
    write_tum(estimate, tmp_path / "estimate.tum")
    reference = file_interface.read_tum_trajectory_file(tmp_path / "truth.tum")
    other = file_interface.read_tum_trajectory_file(tmp_path / "estimate.tum")
    assert reference.check()[0]
    np.testing.assert_allclose(reference.orientations_quat_wxyz, truth.quats, atol=1e-8)
    reference, other = sync.associate_trajectories(reference, other)
    other.align(reference)
    judge = metrics.APE(metrics.PoseRelation.translation_part)
    judge.process_data((reference, other))
    ours = compare(estimate, truth)
    assert ours.poses == 80
    assert ours.ate_rmse_m == pytest.approx(
        judge.get_statistic(metrics.StatisticsType.rmse), rel=1e-5
    )
    assert ours.ate_max_m == pytest.approx(
        judge.get_statistic(metrics.StatisticsType.max), rel=1e-5
    )


def test_another_world_is_no_error() -> None:
    error = compare(moved(helix(), 0.0, 3), helix())
    assert error.ate_max_m < 1e-9
    assert error.heading_max_deg < 1e-6


def test_a_heading_error_shows() -> None:
    truth = helix()
    wrong = rotations.from_yaw(np.where(np.arange(80) == 40, np.radians(5.0), 0.0))
    quats = np.asarray(rotations.multiply(wrong, truth.quats))
    error = compare(Trajectory(truth.stamps_ns, truth.positions, quats), truth)
    # One of 80 poses is off, which moves the mean rotation by a 80th.
    assert error.heading_max_deg == pytest.approx(5.0 * 79 / 80, abs=0.01)


def test_alignment_never_mirrors() -> None:
    points = np.random.default_rng(0).standard_normal((20, 3))
    turn, _ = rigid_alignment(points, points * [1.0, 1.0, -1.0])
    assert np.linalg.det(turn) == pytest.approx(1.0)


def test_interpolation_between_poses() -> None:
    quats = np.asarray(rotations.from_yaw(np.array([0.0, 1.0])))
    path = Trajectory(np.array([0, 100]), np.array([[0.0, 0, 0], [1, 2, 3]]), quats)
    middle = sample_at(path, np.array([-1, 25, 100, 101]))
    np.testing.assert_array_equal(middle.stamps_ns, [25, 100])
    np.testing.assert_allclose(middle.positions[0], [0.25, 0.5, 0.75])
    np.testing.assert_allclose(rotations.yaw(middle.quats), [0.25, 1.0])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "without poses"),
        ("1 2 3\n", "line 1: '1 2 3' is no pose"),
        ("# x\n1 0 0 nan 0 0 0 1\n", "line 2"),
        ("1 0 0 0 0 0 0 2\n", "line 1: the quaternion"),
        ("2 0 0 0 0 0 0 1\n2 0 0 0 0 0 0 1\n", "line 2: stamps do not rise"),
    ],
)
def test_unusable_files(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "a.tum"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_tum(path)


def test_too_little_overlap() -> None:
    late = Trajectory(helix().stamps_ns + 10**12, helix().positions, helix().quats)
    with pytest.raises(InputError, match="only 0 poses"):
        compare(late, helix())
