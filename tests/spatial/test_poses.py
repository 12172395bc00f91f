import numpy as np
import pytest

from openclone.spatial import rotations
from openclone.spatial.poses import Pose


def random_pose(rng: np.random.Generator) -> Pose:
    quat = rotations.normalize(rng.standard_normal(4))
    return Pose(rng.standard_normal(3), quat)


def test_composition_is_that_of_homogeneous_matrices() -> None:
    rng = np.random.default_rng(0)
    for _ in range(20):
        a, b = random_pose(rng), random_pose(rng)
        np.testing.assert_allclose(
            (a @ b).matrix(), a.matrix() @ b.matrix(), atol=1e-12
        )


def test_inverse_is_the_inverse_matrix() -> None:
    pose = random_pose(np.random.default_rng(1))
    expected = np.linalg.inv(pose.matrix())
    np.testing.assert_allclose(pose.inverse().matrix(), expected, atol=1e-12)


def test_apply_moves_points_like_the_matrix_and_in_batches() -> None:
    rng = np.random.default_rng(2)
    poses = Pose(
        rng.standard_normal((5, 3)), rotations.normalize(rng.standard_normal((5, 4)))
    )
    points = rng.standard_normal((5, 3))
    homogeneous = np.concatenate((points, np.ones((5, 1))), 1)
    expected = np.einsum("nij,nj->ni", poses.matrix(), homogeneous)[:, :3]
    np.testing.assert_allclose(poses.apply(points), expected, atol=1e-12)


def test_a_quarter_turn_by_hand() -> None:
    world_from_head = Pose(
        np.array([1.0, 2, 3]), rotations.from_yaw(np.array(np.pi / 2))
    )
    head_from_point = Pose(np.array([1.0, 0, 0]), np.array(rotations.IDENTITY))
    point = world_from_head @ head_from_point
    np.testing.assert_allclose(point.position, [1, 3, 3], atol=1e-12)


def test_heading_keeps_the_origin_and_drops_the_tilt() -> None:
    tilted = rotations.from_euler(np.array([0.7, 0.3, -0.2]), "ZYX")
    heading = Pose(np.array([1.0, 2, 3]), tilted).heading()
    np.testing.assert_array_equal(heading.position, [1, 2, 3])
    np.testing.assert_allclose(heading.quat, rotations.from_yaw(np.array(0.7)))


def test_identity_changes_nothing() -> None:
    pose = random_pose(np.random.default_rng(3))
    same = Pose.identity() @ pose
    assert same.position == pytest.approx(pose.position)
    assert same.quat == pytest.approx(pose.quat)
