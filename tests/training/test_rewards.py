"""Every row of Table A1 and every own term against a value worked out by hand."""

import math
from dataclasses import replace

import pytest
import torch

from openclone.robot import g1
from openclone.training import rewards
from openclone.training.rewards import TrackingState

LEFT, RIGHT = g1.FEET
# A turn by 30 degrees about x; its tilt is sin 30° = 0.5.
TILT_30 = torch.tensor([math.cos(math.pi / 12), math.sin(math.pi / 12), 0.0, 0.0])
UPRIGHT = torch.tensor([1.0, 0, 0, 0])


# Table A1: penalties -----------------------------------------------------------------


def test_torque(perfect):
    perfect.robot.torque[:] = 0
    perfect.robot.torque[0, [3, 20]] = torch.tensor([30.0, -4.0])
    assert float(rewards.torque(perfect)) == pytest.approx(900 + 16)


def test_torque_limits_count_saturated_motors(perfect):
    perfect.robot.torque[:] = 0
    knee, wrist = 3, 21
    perfect.robot.torque[0, knee] = -139.0  # at its limit
    perfect.robot.torque[0, wrist] = 4.9  # of 5
    assert float(rewards.torque_limits(perfect)) == 1.0
    perfect.robot.torque[0, wrist] = 5.0
    assert float(rewards.torque_limits(perfect)) == 2.0


def test_dof_position_limits_count_joints_outside(perfect):
    angles = perfect.robot.joint_angles
    angles[:] = torch.tensor(g1.DEFAULT_POSE, dtype=torch.float32)
    assert float(rewards.dof_position_limits(perfect)) == 0.0
    angles[0, g1.joint_index("left_knee_joint")] = 2.9  # up to 2.8798
    angles[0, g1.joint_index("waist_roll_joint")] = -0.53  # down to -0.52
    angles[0, g1.joint_index("waist_pitch_joint")] = 0.51  # up to 0.52
    assert float(rewards.dof_position_limits(perfect)) == 2.0


def test_dof_velocity_limits_count_fast_joints(perfect):
    speed = perfect.robot.joint_velocities
    speed[:] = 0
    speed[0, g1.joint_index("right_knee_joint")] = -20.5  # of 20 rad/s
    speed[0, g1.joint_index("right_elbow_joint")] = 36.0  # of 37 rad/s
    assert float(rewards.dof_velocity_limits(perfect)) == 1.0


def test_termination(perfect):
    assert float(rewards.termination(perfect)) == 0.0
    failed = replace(perfect, terminated=torch.ones(1, dtype=torch.bool))
    assert float(rewards.termination(failed)) == 1.0


def test_dof_acceleration(perfect):
    before = perfect.robot.joint_velocities - 0.1
    accelerated = replace(perfect, previous_velocities=before)
    # 29 joints at 0.1 / 0.02 = 5 rad/s².
    assert float(rewards.dof_acceleration(accelerated)) == pytest.approx(
        29 * 25.0, rel=1e-3
    )


def test_dof_velocity(perfect):
    perfect.robot.joint_velocities[:] = 0
    perfect.robot.joint_velocities[0, :2] = torch.tensor([3.0, -4.0])
    assert float(rewards.dof_velocity(perfect)) == pytest.approx(25.0)


def test_action_rates_split_legs_from_the_rest(perfect):
    action = torch.zeros(1, 29)
    action[0, 3], action[0, 12] = 2.0, 3.0
    moved = replace(perfect, action=action)
    assert float(rewards.lower_action_rate(moved)) == pytest.approx(4.0)
    assert float(rewards.upper_action_rate(moved)) == pytest.approx(9.0)


# Table A1: feet and balance ----------------------------------------------------------


def loads(state: TrackingState, left: float, right: float) -> None:
    state.robot.foot_force[:] = 0
    state.robot.foot_force[0, :, 2] = torch.tensor([left, right])


def test_feet_air_time_counts_when_a_foot_lands(perfect):
    flying = replace(perfect, air_time=torch.tensor([[0.5, 0.2]]))
    loads(flying, 0.0, 0.0)
    assert float(rewards.feet_air_time(flying)) == 0.0
    loads(flying, 100.0, 0.0)
    assert float(rewards.feet_air_time(flying)) == pytest.approx(0.2)
    loads(flying, 100.0, 100.0)
    assert float(rewards.feet_air_time(flying)) == pytest.approx(0.2 - 0.1)
    # Feet that stay on the ground do not land.
    loads(perfect, 100.0, 100.0)
    assert float(rewards.feet_air_time(perfect)) == 0.0


def test_stumble_is_a_push_five_times_more_sideways_than_up(perfect):
    loads(perfect, 10.0, 10.0)
    perfect.robot.foot_force[0, 0, 0] = 49.0
    assert float(rewards.stumble(perfect)) == 0.0
    perfect.robot.foot_force[0, 0, :2] = torch.tensor([40.0, 31.0])  # 50.6 N
    assert float(rewards.stumble(perfect)) == 1.0


def test_slippage_counts_loaded_feet_only(perfect):
    perfect.robot.body_velocity[:, LEFT] = torch.tensor([0.3, 0.4, 9.0])
    perfect.robot.body_velocity[:, RIGHT, 0] = 0.7
    loads(perfect, 200.0, 0.0)
    assert float(rewards.slippage(perfect)) == pytest.approx(0.25, abs=1e-4)


def test_feet_orientation(perfect):
    perfect.robot.body_quat[:, [LEFT, RIGHT]] = UPRIGHT
    assert float(rewards.feet_orientation(perfect)) == pytest.approx(0.0, abs=1e-6)
    perfect.robot.body_quat[:, LEFT] = TILT_30
    assert float(rewards.feet_orientation(perfect)) == pytest.approx(0.5, abs=1e-6)
    perfect.robot.body_quat[:, RIGHT] = TILT_30
    assert float(rewards.feet_orientation(perfect)) == pytest.approx(1.0, abs=1e-6)


def test_in_the_air_needs_both_feet_off(perfect):
    loads(perfect, 0.5, 0.9)
    assert float(rewards.in_the_air(perfect)) == 1.0
    loads(perfect, 0.5, 1.1)
    assert float(rewards.in_the_air(perfect)) == 0.0


def test_orientation(perfect):
    perfect.robot.body_quat[:, g1.ROOT] = TILT_30
    assert float(rewards.orientation(perfect)) == pytest.approx(0.5, abs=1e-6)
    # Heading does not count.
    perfect.robot.body_quat[:, g1.ROOT] = torch.tensor([0.6, 0, 0, 0.8])
    assert float(rewards.orientation(perfect)) == pytest.approx(0.0, abs=1e-6)


# Table A1: tracking ------------------------------------------------------------------

CLOSENESS = (
    rewards.dof_position_tracking,
    rewards.dof_velocity_tracking,
    rewards.extend_body_position,
    rewards.vr_position,
    rewards.body_rotation,
    rewards.body_velocity,
    rewards.body_angular_velocity,
    rewards.body_position,
    rewards.hand_position,
    rewards.root_position,
    rewards.root_rotation,
)


@pytest.mark.parametrize("term", CLOSENESS)
def test_perfect_tracking_earns_one(perfect, term):
    assert float(term(perfect, 0.1)) == pytest.approx(1.0, abs=1e-4)


def test_dof_position_tracking(perfect):
    perfect.robot.joint_angles[0, 5] += 1.0
    # exp(-(1/29) / 0.25)
    got = float(rewards.dof_position_tracking(perfect, 0.25))
    assert got == pytest.approx(math.exp(-4 / 29), abs=1e-5)


def test_dof_velocity_tracking(perfect):
    perfect.robot.joint_velocities[:] += 0.5
    got = float(rewards.dof_velocity_tracking(perfect, 0.25))
    assert got == pytest.approx(math.exp(-1), abs=1e-5)


def test_positions_of_a_robot_that_stands_beside_its_reference(perfect):
    perfect.robot.body_position[:, :, 0] += 0.3
    # All errors are 0.3 m, so every mean squared error is 0.09 m².
    expected = math.exp(-0.09 / 0.5)
    for term in (rewards.extend_body_position, rewards.vr_position):
        assert float(term(perfect, 0.5)) == pytest.approx(expected, abs=1e-5)
    got = float(rewards.root_position(perfect, 0.3**2))
    assert got == pytest.approx(math.exp(-1), abs=1e-5)
    # Relative positions do not notice.
    assert float(rewards.body_position(perfect, 0.01)) == pytest.approx(1.0, abs=1e-4)


def test_positions_of_one_moved_wrist(perfect):
    perfect.robot.body_position[0, g1.WRISTS[0], 1] += 0.6
    # 0.36 m² at the wrist and at its hand: of 14 bodies and 3 points, and of 3 points.
    got = float(rewards.extend_body_position(perfect, 0.5))
    assert got == pytest.approx(math.exp(-2 * 0.36 / 17 / 0.5), abs=1e-5)
    got = float(rewards.vr_position(perfect, 0.5))
    assert got == pytest.approx(math.exp(-0.12 / 0.5), abs=1e-5)


def test_rotations_of_a_robot_turned_by_a_known_angle(perfect):
    turn = torch.tensor([math.cos(0.1), 0.0, 0.0, math.sin(0.1)])  # 0.2 rad
    perfect.robot.body_quat[:] = turn
    perfect.reference.body_quat[:] = UPRIGHT
    expected = math.exp(-0.04 / 0.1)
    for term in (rewards.body_rotation, rewards.root_rotation):
        assert float(term(perfect, 0.1)) == pytest.approx(expected, abs=1e-4)
    assert float(rewards.body_hand_rotation(perfect)) == pytest.approx(0.04, abs=1e-5)


def test_hands_are_seen_from_the_head(perfect):
    perfect.robot.body_position[:, :, 0] += 0.3  # all together: no error
    perfect.robot.body_position[0, g1.WRISTS[0], 1] += 0.2
    # A mean over two hands: 0.04 / 2 m².
    got = float(rewards.hand_position(perfect, 0.01))
    assert got == pytest.approx(math.exp(-2.0), abs=1e-4)


def test_velocities(perfect):
    perfect.robot.body_velocity[:, :, 1] += 0.5
    got = float(rewards.body_velocity(perfect, 1.0))
    assert got == pytest.approx(math.exp(-0.25), abs=1e-5)
    perfect.robot.body_angular_velocity[:, :, 2] += 2.0
    got = float(rewards.body_angular_velocity(perfect, 10.0))
    assert got == pytest.approx(math.exp(-0.4), abs=1e-5)


def test_amp_is_the_discriminators_reward(perfect):
    styled = replace(perfect, style=torch.tensor([0.7]))
    assert float(rewards.amp(styled)) == pytest.approx(0.7)


# Our own terms -----------------------------------------------------------------------


def test_hand_rotation_ignores_the_sign_of_a_quaternion(perfect):
    perfect.robot.body_quat.neg_()
    assert float(rewards.hand_rotation(perfect)) == pytest.approx(0.0, abs=1e-5)


def test_hand_rotation_of_a_right_angle(perfect):
    turn = torch.tensor([0.7071068, 0.7071068, 0, 0])
    for wrist in g1.WRISTS:
        perfect.robot.body_quat[:, wrist] = turn
        perfect.reference.body_quat[:, wrist] = UPRIGHT
    # 1 - cos²(45°), and (pi / 2)².
    assert float(rewards.hand_rotation(perfect)) == pytest.approx(0.5, abs=1e-5)
    got = float(rewards.body_hand_rotation(perfect))
    assert got == pytest.approx(math.pi**2 / 4, abs=1e-4)


def test_margin_counts_radians_beyond_the_inner_range(perfect):
    knee = g1.joint_index("left_knee_joint")
    perfect.robot.joint_angles[:] = torch.tensor(g1.DEFAULT_POSE, dtype=torch.float32)
    width = g1.JOINT_UPPER[knee] - g1.JOINT_LOWER[knee]
    assert float(rewards.dof_margin(perfect)) == pytest.approx(0.0, abs=1e-6)
    perfect.robot.joint_angles[:, knee] = float(g1.JOINT_UPPER[knee])
    assert float(rewards.dof_margin(perfect)) == pytest.approx(0.025 * width, rel=1e-3)


def test_feet_still_asks_for_rest_only_when_the_command_rests(perfect):
    loads(perfect, 100.0, 0.0)
    perfect.robot.body_velocity[:] = 0
    perfect.robot.body_velocity[0, LEFT, 0] = 0.2
    perfect.reference.body_velocity[:] = 0
    # 0.2² for the moving foot and one half for the lifted one.
    assert float(rewards.feet_still(perfect)) == pytest.approx(0.54, abs=1e-5)
    perfect.reference.body_velocity[:] = 1.0
    assert float(rewards.feet_still(perfect)) == pytest.approx(0.0, abs=1e-6)


# A state remembers what it has computed: `replace` makes one that has not.


def test_a_foot_must_stand_when_the_references_foot_stands(perfect):
    perfect.reference.body_velocity[:] = 0
    perfect.reference.body_position[:, [LEFT, RIGHT], 2] = 0.035
    loads(perfect, 100.0, 0.0)
    assert float(rewards.contact_mismatch(perfect)) == 1.0
    perfect = replace(perfect)
    perfect.reference.body_position[:, RIGHT, 2] = 0.1
    assert float(rewards.contact_mismatch(perfect)) == 0.0
    loads(perfect, 100.0, 100.0)
    assert float(rewards.contact_mismatch(perfect)) == 1.0
    # Between standing and swinging nothing is asked.
    perfect = replace(perfect)
    perfect.reference.body_position[:, RIGHT, 2] = 0.06
    assert float(rewards.contact_mismatch(perfect)) == 0.0


def test_a_foot_on_its_toes_stands_although_its_ankle_is_high(perfect):
    perfect.reference.body_position[:, [LEFT, RIGHT], 2] = 0.035
    loads(perfect, 100.0, 100.0)
    pitch = math.radians(25.0)
    half = torch.tensor([math.cos(pitch / 2), 0.0, math.sin(pitch / 2), 0.0])
    perfect.reference.body_quat[:, RIGHT] = half
    # The toes are 12 cm ahead of the ankle and 3.5 cm below it: they touch.
    height = 0.12 * math.sin(pitch) + 0.035 * math.cos(pitch)
    assert height > 0.07
    perfect.reference.body_position[:, RIGHT, 2] = height
    assert float(rewards.contact_mismatch(perfect)) == 0.0
    perfect = replace(perfect)
    perfect.reference.body_position[:, RIGHT, 2] = height + 0.04
    assert float(rewards.contact_mismatch(perfect)) == 1.0


def test_only_a_flight_that_the_reference_does_not_make_is_airborne(perfect):
    perfect.reference.body_position[:, LEFT, 2] = 0.035
    perfect.reference.body_position[:, RIGHT, 2] = 0.1
    loads(perfect, 0.0, 0.0)
    assert float(rewards.airborne(perfect)) == 1.0
    loads(perfect, 0.0, 30.0)
    assert float(rewards.airborne(perfect)) == 0.0
    loads(perfect, 0.0, 0.0)
    perfect = replace(perfect)
    perfect.reference.body_position[:, LEFT, 2] = 0.1
    assert float(rewards.airborne(perfect)) == 0.0


def test_leg_distance_is_seen_from_the_pelvis(perfect):
    perfect.robot.body_position[:] += torch.tensor([1.0, -2.0, 0.5])
    assert float(rewards.leg_distance(perfect)) == pytest.approx(0.0, abs=1e-5)
    perfect.robot.body_position[:, LEFT, 0] += 0.15
    off = (0.15**2 + 0.02**2) ** 0.5 - 0.02
    assert float(rewards.leg_distance(perfect)) == pytest.approx(off / 2, abs=1e-5)
    perfect.robot.body_position[:, RIGHT - 1, 1] += 9.0
    wanted = off / 2 + 0.5 * 0.6 / 2
    assert float(rewards.leg_distance(perfect)) == pytest.approx(wanted, abs=1e-5)


def test_correction_rate_leaves_out_what_the_reference_asks_for(perfect):
    previous, knee, elbow = torch.zeros(1, 29), 3, g1.joint_index("left_elbow_joint")
    moved = replace(perfect, action=previous.clone(), previous_action=previous)
    perfect.reference.joint_velocities[:] = 0
    assert float(rewards.correction_rate(moved)) == 0.0
    perfect.reference.joint_velocities[0, [knee, elbow]] = 5.0
    step = 5.0 * perfect.period / g1.ACTION_SCALE[knee]  # the elbow's is in its base
    assert float(rewards.correction_rate(moved)) == pytest.approx(step**2)
    moved.action[0, knee], moved.action[0, elbow] = step + 0.5, 2.0
    assert float(rewards.correction_rate(moved)) == pytest.approx(0.25 + 4.0)


def test_velocity_distance(perfect):
    perfect.robot.body_velocity[:] = perfect.reference.body_velocity
    assert float(rewards.velocity_distance(perfect)) == pytest.approx(0.0, abs=1e-6)
    perfect.robot.body_velocity[:, LEFT] += torch.tensor([3.0, 0.0, -4.0])
    wanted = ((25.0 + 0.05**2) ** 0.5 - 0.05) / 14
    assert float(rewards.velocity_distance(perfect)) == pytest.approx(wanted, abs=1e-5)


def test_body_distance_goes_on_far_away(perfect):
    assert float(rewards.body_distance(perfect)) == pytest.approx(0.0, abs=1e-5)
    perfect.robot.body_position[:, LEFT, 2] += 0.3
    wanted = ((0.3**2 + 0.02**2) ** 0.5 - 0.02) / 14
    assert float(rewards.body_distance(perfect)) == pytest.approx(wanted, abs=1e-5)
    perfect.robot.body_position[:, RIGHT, 2] += 9.0
    wanted += 0.6 / 14
    assert float(rewards.body_distance(perfect)) == pytest.approx(wanted, abs=1e-5)
