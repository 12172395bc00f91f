import numpy as np
import torch

from openclone.robot import g1
from openclone.robot.kinematics import Kinematics


def test_body_poses_are_those_of_the_kinematics(model, reference):
    positions, _ = Kinematics(model).trajectory(reference.qpos[[0, 30, 200]])
    got = reference.frames.body_position[[0, 30, 200]].numpy()
    np.testing.assert_allclose(got, positions, atol=1e-6)


def test_body_velocities_are_the_derivative_of_the_positions(reference):
    position = reference.frames.body_position[:150].numpy()
    numeric = (position[2:] - position[:-2]) * 25
    got = reference.frames.body_velocity[1:149].numpy()
    # Joint velocities are smoothed over 1.5 frames and differ by half a frame.
    assert np.abs(numeric - got)[10:-10].max() < 0.08
    assert np.abs(numeric)[:, g1.WRISTS[0]].max() > 0.3


def test_clips_are_told_apart(reference):
    assert reference.names == ("a", "b")
    assert reference.num_frames == 151 + 101
    assert torch.equal(
        reference.last[[0, 150, 151, 251]], torch.tensor([150, 150, 251, 251])
    )
    assert reference.clip[150] == 0
    assert reference.clip[151] == 1
