import numpy as np
import pytest

from openclone.errors import InputError
from openclone.policy.command import KeyPoints
from openclone.robot import g1
from openclone.robot.kinematics import Kinematics
from openclone.robot.model import standing_qpos
from openclone.spatial import rotations
from openclone.teleop.calibration import (
    BodyProportions,
    Calibration,
    CalibrationConfig,
    RobotBody,
    calibrate,
    measure_operator,
)

HEIGHT = 1.6
IDENTITY = np.array(rotations.IDENTITY)


@pytest.fixture(scope="module")
def kinematics() -> Kinematics:
    return Kinematics()


@pytest.fixture(scope="module")
def body(kinematics: Kinematics) -> RobotBody:
    return RobotBody.of(kinematics)


def human(
    xy: tuple[float, float] = (0.0, 0.0), yaw: float = 0.0, squat: float = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Head and wrists of a person with arms stretched forward."""
    part = BodyProportions()
    shoulder = np.array([0.0, part.shoulder_side, -part.shoulder_down]) * HEIGHT
    wrist = shoulder + np.array([part.arm * HEIGHT, 0, 0])
    local = np.stack((np.zeros(3), wrist, wrist * np.array([1, -1, 1])))
    quat = rotations.from_yaw(np.full(3, yaw))
    positions = rotations.rotate(quat, local) + np.array([*xy, HEIGHT - squat])
    return positions, quat


def robot_points(xy: tuple[float, float], height: float) -> KeyPoints:
    positions = np.tile([*xy, height], (3, 1))
    return KeyPoints(positions, np.tile(IDENTITY, (3, 1)))


def make(
    body: RobotBody,
    *,
    xy: tuple[float, float] = (0.0, 0.0),
    yaw: float = 0.0,
    robot_yaw: float = 0.0,
    config: CalibrationConfig | None = None,
) -> Calibration:
    return calibrate(
        *human(xy, yaw),
        robot_points((5.0, -1.0), body.head_height),
        rotations.from_yaw(np.array(robot_yaw)),
        body,
        config or CalibrationConfig(),
    )


def test_robot_measures_agree_with_its_link_lengths(body: RobotBody) -> None:
    # Upper arm 0.185 m and forearm 0.184 m (limb lengths of the G1's MJCF).
    assert body.arm == pytest.approx(0.185 + 0.184, abs=0.004)
    assert body.head_height == pytest.approx(g1.STANDING_HEIGHT + 0.444, abs=0.001)
    np.testing.assert_allclose(body.shoulder[0, 1], -body.shoulder[1, 1])


def test_the_standing_operator_lands_on_the_standing_robot(body: RobotBody) -> None:
    calibration = make(body, xy=(2.0, 3.0), yaw=1.2, robot_yaw=-0.4)
    target = calibration.apply(*human((2.0, 3.0), 1.2))
    np.testing.assert_allclose(
        target.position[0], [5.0, -1.0, body.head_height], atol=1e-12
    )
    assert rotations.yaw(target.quat[0]) == pytest.approx(-0.4)


def test_a_step_ahead_is_a_scaled_step_along_the_robots_heading(
    body: RobotBody,
) -> None:
    calibration = make(body, xy=(2.0, 3.0), yaw=np.pi / 2, robot_yaw=np.pi)
    # The operator looks along +Y and walks one metre that way; the robot looks along
    # -X and so must go along -X.
    target = calibration.apply(*human((2.0, 4.0), np.pi / 2))
    scale = body.head_height / HEIGHT
    np.testing.assert_allclose(target.position[0, :2], [5.0 - scale, -1.0], atol=1e-9)


def test_metre_for_metre_travel(body: RobotBody) -> None:
    calibration = make(body, config=CalibrationConfig(travel_scale=1.0))
    target = calibration.apply(*human((8.9, 0.0)))
    assert target.position[0, 0] == pytest.approx(5.0 + 8.9)


def test_half_the_height_is_half_the_height(body: RobotBody) -> None:
    target = make(body).apply(*human(squat=HEIGHT / 2))
    assert target.position[0, 2] == pytest.approx(body.head_height / 2)


def test_a_stretched_arm_is_a_stretched_arm(
    body: RobotBody, kinematics: Kinematics
) -> None:
    target = make(body, robot_yaw=0.0).apply(*human())
    # The robot with both arms stretched forward, by MuJoCo's kinematics.
    qpos = standing_qpos()
    for side in ("left", "right"):
        for joint, angle in (("shoulder_pitch", -np.pi / 2), ("elbow", np.pi / 2)):
            qpos[7 + g1.joint_index(f"{side}_{joint}_joint")] = angle
        qpos[7 + g1.joint_index(f"{side}_shoulder_roll_joint")] = 0.0
    points, _ = kinematics.key_points(qpos)
    found = target.position - target.position[:1]
    expected = points - points[:1]
    # The G1's tilted shoulder axis swings the arm inward; forward and up must agree.
    assert np.abs(found - expected)[1:, [0, 2]].max() < 0.02


def test_hands_stay_within_reach(body: RobotBody) -> None:
    positions, quats = human()
    positions[1] += [1.0, 0.3, 0.4]
    target = make(body).apply(positions, quats)
    shoulder = target.position[0] + body.shoulder[0]
    assert np.linalg.norm(target.position[1] - shoulder) == pytest.approx(0.42)


def test_hand_orientation_turns_with_the_heading(body: RobotBody) -> None:
    positions, quats = human(yaw=0.5)
    quats[1] = rotations.multiply(
        quats[1], rotations.from_axis_angle(np.array([1.0, 0, 0]), 0.3)
    )
    target = make(body, yaw=0.5, robot_yaw=0.0).apply(positions, quats)
    expected = rotations.from_axis_angle(np.array([1.0, 0, 0]), 0.3)
    assert rotations.angle_between(target.quat[1], expected) < 1e-6


def test_a_given_heading_overrides_the_look_of_the_head(body: RobotBody) -> None:
    config = CalibrationConfig(heading_deg=0.0)
    calibration = make(body, yaw=0.3, robot_yaw=0.0, config=config)
    target = calibration.apply(*human((1.0, 0.0), 0.3))
    scale = body.head_height / HEIGHT
    np.testing.assert_allclose(target.position[0, :2], [5.0 + scale, -1.0], atol=1e-9)


def test_batches_equal_single_frames(body: RobotBody) -> None:
    calibration = make(body, yaw=0.2)
    frames = [human((0.1 * k, 0.05 * k), 0.1 * k, 0.02 * k) for k in range(6)]
    positions = np.stack([frame[0] for frame in frames])
    quats = np.stack([frame[1] for frame in frames])
    batch = calibration.apply(positions, quats)
    for index, frame in enumerate(frames):
        single = calibration.apply(*frame)
        np.testing.assert_allclose(batch.position[index], single.position, atol=1e-12)
        np.testing.assert_allclose(batch.quat[index], single.quat, atol=1e-12)


def test_an_inhuman_height_is_refused(body: RobotBody) -> None:
    positions, quats = human()
    with pytest.raises(InputError, match=r"160\.00 m above the floor"):
        calibrate(
            positions * 100,
            quats,
            robot_points((0, 0), 1.2),
            IDENTITY,
            body,
            CalibrationConfig(),
        )


def test_measures_of_an_operator_who_begins_in_a_squat() -> None:
    frames = [human(squat=0.6 - 0.01 * min(k, 60)) for k in range(200)]
    positions = np.stack([frame[0] for frame in frames])
    quats = np.stack([frame[1] for frame in frames])
    operator = measure_operator(positions, quats, BodyProportions())
    assert operator.head_height == pytest.approx(HEIGHT, abs=0.01)
    assert operator.arm == pytest.approx(0.357 * HEIGHT, rel=0.02)
