"""rko_lio and foreign odometry behind the protocol."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import pytest

from openclone.errors import InputError
from openclone.odometry.external import ExternalOdometry
from openclone.odometry.motion_model import ConstantVelocity
from openclone.odometry.replay import Replay, replay
from openclone.odometry.rko import RkoLio
from openclone.odometry.samples import ImuSample, LidarScan, SensorSample
from openclone.odometry.trajectory import compare
from openclone.spatial import rotations
from room_stream import RoomStreamConfig, room_stream

MS = 1_000_000
UPRIGHT = np.array([1.0, 0.0, 0.0, 0.0])


@pytest.fixture(scope="module")
def walk() -> list[SensorSample]:
    return list(room_stream(RoomStreamConfig(seconds=8.0, points=4_000)))


def run_rko(samples: Iterable[SensorSample]) -> tuple[RkoLio, Replay]:
    odometry, result = RkoLio(), Replay()
    replay(samples, odometry, result)
    return odometry, result


def test_rko_follows_a_walk(walk: list[SensorSample]) -> None:
    odometry, result = run_rko(walk)
    assert result.scans == 80
    assert result.tracked == 79
    error = compare(result.trajectory, result.reference)
    assert error.ate_rmse_m < 0.06
    assert error.heading_max_deg < 2.0
    # The stream's world is level, and rko's has to be: heights agree unaligned.
    height = result.trajectory.positions[:, 2]
    assert np.ptp(height) < 0.15
    newest_ns = int(result.trajectory.stamps_ns[-1])
    assert odometry.health(newest_ns).tracking
    assert not odometry.health(newest_ns + 400 * MS).tracking


def test_rko_goes_on_between_scans(walk: list[SensorSample]) -> None:
    """50 ms after a scan the continued pose is nearer to the next than the old one."""
    odometry, ahead, held = RkoLio(), [], []
    guess = None
    for sample in walk:
        if isinstance(sample, ImuSample):
            odometry.add_imu(sample.stamp_ns, sample.gyro, sample.accel)
        elif isinstance(sample, LidarScan):
            end_ns = int(sample.stamps_ns.max())
            odometry.add_scan(sample.points, sample.stamps_ns)
            position, _ = odometry.pose_at(end_ns)
            if guess is not None:
                ahead.append(np.linalg.norm(position - guess[0]))
                held.append(np.linalg.norm(position - guess[1]))
            guess = (odometry.pose_at(end_ns + 100 * MS)[0], position)
    assert np.mean(ahead[50:]) < 0.6 * np.mean(held[50:])


def test_rko_survives_blind_and_wrong_scans(walk: list[SensorSample]) -> None:
    odometry, _ = run_rko(walk)
    now_ns = int(next(s for s in walk[::-1] if isinstance(s, LidarScan)).stamps_ns[-1])
    stamps = now_ns + np.arange(1, 101) * MS
    before = odometry.pose_at(now_ns)[0]
    assert not odometry.add_scan(np.zeros((100, 3)), stamps).tracking
    assert not odometry.health(now_ns + 100 * MS).tracking
    assert not odometry.add_scan(np.full((100, 3), np.nan), stamps + 100 * MS).tracking
    assert np.isfinite(odometry.pose_at(now_ns + 200 * MS)[0]).all()
    assert np.linalg.norm(odometry.pose_at(now_ns + 200 * MS)[0] - before) < 0.3
    for points, times in (
        (np.zeros((0, 3)), stamps[:0]),
        (np.zeros((100, 2)), stamps),
        (np.zeros((100, 3)), stamps[:50]),
        (np.zeros((100, 3)), stamps - 1000 * MS),
    ):
        with pytest.raises(InputError):
            odometry.add_scan(points, times)


def test_rko_refuses_bad_readings() -> None:
    odometry = RkoLio()
    odometry.add_imu(10, np.zeros(3), np.array([0, 0, 9.81]))
    for stamp_ns, gyro in (
        (10, np.zeros(3)),
        (20, np.zeros(2)),
        (20, np.full(3, np.nan)),
    ):
        with pytest.raises(InputError):
            odometry.add_imu(stamp_ns, gyro, np.array([0, 0, 9.81]))


def test_constant_velocity_continues_a_turn() -> None:
    """On a circle the continued rotation is exact, and the way is right at once."""
    motion = ConstantVelocity(300 * MS)
    for step in range(2):
        yaw = rotations.from_yaw(np.array(0.2 * step))
        motion.update(step * 100 * MS, np.array([0.1 * step, 0, 0]), np.asarray(yaw))
    position, quat = motion.pose_at(150 * MS)
    np.testing.assert_allclose(position, [0.15, 0, 0])
    assert float(rotations.yaw(quat)) == pytest.approx(0.3)
    held = motion.pose_at(10_000 * MS)[0]
    np.testing.assert_allclose(held, [0.1 + 0.3, 0, 0])


def feed(odometry: ExternalOdometry, count: int, delay_ns: int = 20 * MS) -> int:
    """Poses at 1 m/s, 20 Hz; the source's clock is 5 s behind. Returns the time."""
    for n in range(count):
        stamp = n * 50 * MS
        position = np.array([stamp * 1e-9, 0.0, 0.0])
        assert odometry.add_pose(stamp, position, UPRIGHT, stamp + 5000 * MS + delay_ns)
    return 5000 * MS + delay_ns + (count - 1) * 50 * MS


def test_external_poses_are_served_in_our_clock() -> None:
    odometry = ExternalOdometry()
    assert not odometry.health(0).tracking
    now_ns = feed(odometry, 20)
    position, _ = odometry.pose_at(now_ns + 30 * MS)
    np.testing.assert_allclose(position, [0.95 + 0.03, 0, 0], atol=1e-9)
    assert odometry.health(now_ns + 30 * MS).tracking
    assert odometry.health(now_ns + 30 * MS).age_ns == 30 * MS
    assert not odometry.health(now_ns + 301 * MS).tracking


def test_external_poses_that_cannot_be() -> None:
    odometry = ExternalOdometry()
    now_ns = feed(odometry, 20)
    later = 20 * 50 * MS
    good = np.array([1.0, 0.0, 0.0])
    for stamp, position, quat in (
        (later, np.array([np.nan, 0, 0]), UPRIGHT),
        (later, good, np.zeros(4)),
        (later, good, np.array([1.0, 0, 0])),
        (19 * 50 * MS, good, UPRIGHT),
        (0, good, UPRIGHT),
    ):
        assert not odometry.add_pose(stamp, position, quat, now_ns + 50 * MS)
    assert odometry.refused == 5
    np.testing.assert_allclose(odometry.pose_at(now_ns)[0], [0.95, 0, 0])


def test_a_jump_is_unhealthy_until_it_is_believed() -> None:
    odometry = ExternalOdometry()
    now_ns = feed(odometry, 20)
    far = np.array([5.0, 0.0, 0.0])
    answers = []
    for n in range(12):
        stamp = (20 + n) * 50 * MS
        now_ns += 50 * MS
        answers.append(odometry.add_pose(stamp, far, UPRIGHT, now_ns))
        tracking = odometry.health(now_ns).tracking
        assert tracking == answers[-1]
        if not answers[-1]:
            assert odometry.pose_at(now_ns)[0][0] < 2.0
    assert answers.index(True) == 9
    np.testing.assert_allclose(odometry.pose_at(now_ns)[0], far)
