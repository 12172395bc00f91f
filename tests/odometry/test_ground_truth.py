import numpy as np

from openclone.odometry.ground_truth import GroundTruthOdometry
from openclone.odometry.noise import OdometryNoiseConfig
from openclone.spatial import rotations

STEP = 20_000_000
UPRIGHT = np.array(rotations.IDENTITY)


def test_without_noise_the_pose_is_exact() -> None:
    odometry = GroundTruthOdometry(None, np.random.default_rng(0))
    turned = rotations.from_yaw(np.array(0.4))
    odometry.observe(0, np.array([1.0, 2, 3]), turned, np.zeros(3))
    position, quat = odometry.pose_at(0)
    np.testing.assert_array_equal(position, [1, 2, 3])
    np.testing.assert_array_equal(quat, turned)


def test_health_before_and_after_the_first_pose() -> None:
    odometry = GroundTruthOdometry(None, np.random.default_rng(0))
    assert not odometry.health(0).tracking
    odometry.observe(5, np.zeros(3), UPRIGHT, np.zeros(3))
    health = odometry.health(5 + 3 * STEP)
    assert health.tracking
    assert health.age_ns == 3 * STEP
    odometry.reset()
    assert not odometry.health(0).tracking


def test_a_slow_odometry_repeats_its_pose() -> None:
    odometry = GroundTruthOdometry(None, np.random.default_rng(0), rate_hz=10.0)
    seen = []
    for tick in range(11):
        odometry.observe(tick * STEP, np.full(3, float(tick)), UPRIGHT, np.zeros(3))
        seen.append(odometry.pose_at(tick * STEP)[0][0])
    assert seen == [0, 0, 0, 0, 0, 5, 5, 5, 5, 5, 10]


def test_the_error_spreads_as_equation_2_says() -> None:
    # Variance per axis after time t at constant speed: (|v| / c_vel + c_min)^2 t.
    config = OdometryNoiseConfig(
        c_vel=20.0, c_min=0.01, max_error=10.0, reset_period=1e9
    )
    seconds, speed = 2.0, 0.8
    ends = []
    for seed in range(120):
        odometry = GroundTruthOdometry(config, np.random.default_rng(seed))
        for tick in range(int(seconds * 50) + 1):
            stamp = 7_000 + tick * STEP
            odometry.observe(stamp, np.zeros(3), UPRIGHT, np.array([speed, 0, 0]))
        ends.append(odometry.pose_at(stamp)[0])
    expected = (speed / 20.0 + 0.01) * np.sqrt(seconds)
    assert abs(np.std(ends) / expected - 1) < 0.12
    assert abs(np.mean(ends)) < 0.02


def test_the_same_seed_gives_the_same_error() -> None:
    def run(seed: int) -> np.ndarray:
        config = OdometryNoiseConfig()
        odometry = GroundTruthOdometry(config, np.random.default_rng(seed))
        for tick in range(20):
            odometry.observe(tick * STEP, np.zeros(3), UPRIGHT, np.ones(3))
        return odometry.pose_at(0)[0]

    np.testing.assert_array_equal(run(3), run(3))
    assert (run(3) != run(4)).all()
