from dataclasses import fields, replace

import pytest
import torch

from openclone.robot import g1
from openclone.robot.state import RobotState
from openclone.training import rewards
from openclone.training.rewards import RewardWeights, TrackingState, total_reward


@pytest.fixture
def perfect(reference) -> TrackingState:
    frame = torch.tensor([10])
    robot = reference.at(frame)
    robot = RobotState(
        **{name: getattr(robot, name).clone() for name in robot.__dataclass_fields__}
    )
    zeros = torch.zeros(1, 29)
    return TrackingState(
        robot=robot,
        reference=reference.at(frame),
        action=zeros,
        previous_action=zeros,
        previous_velocities=robot.joint_velocities,
        period=0.02,
    )


CLOSENESS = (
    rewards.vr_position,
    rewards.body_position,
    rewards.root_position,
    rewards.root_rotation,
    rewards.body_rotation,
    rewards.body_velocity,
    rewards.body_angular_velocity,
)


@pytest.mark.parametrize("term", CLOSENESS)
def test_perfect_tracking_earns_one(perfect, term):
    assert float(term(perfect)) == pytest.approx(1.0, abs=1e-4)


def test_shift_of_the_whole_robot(perfect):
    perfect.robot.body_position[:, :, 0] += 0.3
    # exp(-0.3² / σ²) with σ 0.3 and 0.25; relative positions do not notice.
    assert float(rewards.root_position(perfect)) == pytest.approx(0.3679, abs=1e-3)
    assert float(rewards.vr_position(perfect)) == pytest.approx(0.2369, abs=1e-3)
    assert float(rewards.body_position(perfect)) == pytest.approx(1.0, abs=1e-4)


def test_velocity_error(perfect):
    perfect.robot.body_velocity[:, :, 1] += 0.5
    assert float(rewards.body_velocity(perfect)) == pytest.approx(0.7788, abs=1e-3)


def test_hand_rotation_ignores_the_sign_of_a_quaternion(perfect):
    perfect.robot.body_quat.neg_()
    assert float(rewards.hand_rotation(perfect)) == pytest.approx(0.0, abs=1e-5)


def test_hand_rotation_of_a_right_angle(perfect):
    turn = torch.tensor([0.7071068, 0.7071068, 0, 0])
    for wrist in g1.WRISTS:
        perfect.robot.body_quat[:, wrist] = turn
        perfect.reference.body_quat[:, wrist] = torch.tensor([1.0, 0, 0, 0])
    # 1 - cos²(45°)
    assert float(rewards.hand_rotation(perfect)) == pytest.approx(0.5, abs=1e-5)


def test_action_rates_split_legs_from_the_rest(perfect):
    action = torch.zeros(1, 29)
    action[0, 3], action[0, 12] = 2.0, 3.0
    moved = replace(perfect, action=action)
    assert float(rewards.lower_action_rate(moved)) == pytest.approx(4.0)
    assert float(rewards.upper_action_rate(moved)) == pytest.approx(9.0)


def test_acceleration(perfect):
    before = perfect.robot.joint_velocities - 0.1
    accelerated = replace(perfect, previous_velocities=before)
    assert float(rewards.dof_acceleration(accelerated)) == pytest.approx(
        725.0, rel=1e-3
    )


def test_joint_limits_count_radians_beyond_the_margin(perfect):
    knee = g1.joint_index("left_knee_joint")
    perfect.robot.joint_angles[:] = torch.tensor(g1.DEFAULT_POSE, dtype=torch.float32)
    width = g1.JOINT_UPPER[knee] - g1.JOINT_LOWER[knee]
    assert float(rewards.dof_position_limits(perfect)) == pytest.approx(0.0, abs=1e-6)
    perfect.robot.joint_angles[:, knee] = float(g1.JOINT_UPPER[knee])
    assert float(rewards.dof_position_limits(perfect)) == pytest.approx(
        0.025 * width, rel=1e-3
    )


def test_slippage_counts_loaded_feet_only(perfect):
    left, right = g1.FEET
    perfect.robot.body_velocity[:, left, 0] = 0.5
    perfect.robot.body_velocity[:, right, 0] = 0.7
    perfect.robot.foot_force[:] = 0
    perfect.robot.foot_force[:, 0, 2] = 200.0
    assert float(rewards.slippage(perfect)) == pytest.approx(0.25, abs=1e-4)


def test_every_weight_has_a_term(perfect):
    ones = RewardWeights(**{field.name: 1.0 for field in fields(RewardWeights)})
    _, terms = total_reward(perfect, ones)
    assert set(terms) == {field.name for field in fields(RewardWeights)}


def test_total_is_the_weighted_sum(perfect):
    perfect.robot.body_position[:, :, 0] += 0.3
    weights = RewardWeights(root_position=2.0, body_position=0.5)
    total, terms = total_reward(perfect, weights)
    assert set(terms) == {"root_position", "body_position"}
    assert float(total) == pytest.approx(2 * 0.36788 + 0.5, abs=1e-3)
