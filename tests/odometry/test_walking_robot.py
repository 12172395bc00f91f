"""Faults in the stream of the simulated robot, whose head its footfalls shake.

The packaged student walks through the furnished room; its stream is recorded and read
back once, and each fault is put into it. A pose is wrong if it is 5 cm off: the bound
that the odometry keeps in sound streams (`max` of `openclone evaluate odometry`). Poses
are on the LiDAR's clock, as nobody can tell which of two clocks is right; the robot
walks 2 cm while they differ by 50 ms.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from openclone.errors import InputError
from openclone.evaluation.sensor_recording import record_walk
from openclone.odometry.fast_lio import FastLio
from openclone.odometry.recording import read_samples
from openclone.odometry.rko import RkoLio, RkoLioConfig
from openclone.odometry.samples import ImuSample, LidarScan, PoseSample, SensorSample
from openclone.odometry.trajectory import Trajectory, sample_at
from openclone.policy.bundle import load_bundle
from openclone.spatial import rotations

SECONDS = 8.5
WALKING_S = 6.2
"""By then the robot walks; at first it is held, and then the operator waits."""
WRONG_M = 0.05
FAULT_NS = round(WALKING_S * 1e9)
LATE_NS = 300_000_000
"""So long a fault may go unnoticed."""

Fault = Callable[[SensorSample], SensorSample | None]


@dataclass(frozen=True)
class Followed:
    """What the odometry said at its scans and at every fourth IMU sample.

    Attributes:
        stamps_ns: (n,).
        tracking: (n,) bool.
        errors: (n,), metres, of the position.
        lio: afterwards.
    """

    stamps_ns: np.ndarray
    tracking: np.ndarray
    errors: np.ndarray
    lio: FastLio

    def first_lost_s(self) -> float:
        """Seconds from the fault until it calls itself lost."""
        lost = self.stamps_ns[~self.tracking & (self.stamps_ns >= FAULT_NS)]
        return float(lost[0] - FAULT_NS) * 1e-9 if len(lost) else np.inf

    def never_sure_and_wrong(self) -> bool:
        """From 0.3 s after the fault on, and before it."""
        due = (self.stamps_ns < FAULT_NS) | (self.stamps_ns > FAULT_NS + LATE_NS)
        return bool((self.errors[self.tracking & due] < WRONG_M).all())


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> list[SensorSample]:
    path: Path = tmp_path_factory.mktemp("walk") / "room.mcap"
    done = record_walk(path, load_bundle(None), world="room", seconds=SECONDS - 1.5)
    assert not done.fell
    samples: list[SensorSample] = []
    for sample in read_samples(path, say=lambda text: None):
        if isinstance(sample, LidarScan):
            # A third of the points is enough and quicker.
            sample = LidarScan(sample.points[::3], sample.stamps_ns[::3])
        samples.append(sample)
    return samples


def follow(
    walk: list[SensorSample],
    fault: Fault = lambda sample: sample,
    delay_ns: Callable[[int], int] = lambda now_ns: 0,
) -> Followed:
    """Run over ``walk`` with a fault; the truth at t is that of ``t - delay_ns(t)``."""
    lio, rows, count = FastLio(), [], 0
    for sample in walk:
        changed = fault(sample)
        if isinstance(sample, PoseSample) or changed is None:
            continue
        try:
            if isinstance(changed, ImuSample):
                lio.add_imu(changed.stamp_ns, changed.gyro, changed.accel)
                count += 1
                if count % 4:
                    continue
                now_ns = changed.stamp_ns
            else:
                assert isinstance(changed, LidarScan)
                lio.add_scan(changed.points, changed.stamps_ns)
                assert isinstance(sample, LidarScan)
                now_ns = int(sample.stamps_ns.max())
        except InputError:
            continue
        health = lio.health(now_ns)
        if health.scans:
            rows.append((now_ns, health.tracking, lio.pose_at(now_ns)))
    # The truth ends with the last scan; some IMU samples follow.
    end_ns = max(s.stamp_ns for s in walk if isinstance(s, PoseSample))
    rows = [row for row in rows if row[0] - delay_ns(row[0]) <= end_ns]
    stamps = np.array([row[0] for row in rows])
    delays = np.array([delay_ns(int(stamp)) for stamp in stamps])
    errors = position_errors(walk, stamps - delays, [row[2] for row in rows])
    return Followed(stamps, np.array([row[1] for row in rows]), errors, lio)


def position_errors(
    walk: list[SensorSample],
    stamps_ns: np.ndarray,
    poses: list[tuple[np.ndarray, np.ndarray]],
) -> np.ndarray:
    """Distances ``(n,)`` from the truth, with the first poses laid onto each other."""
    truths = [sample for sample in walk if isinstance(sample, PoseSample)]
    truth = Trajectory(
        np.array([each.stamp_ns for each in truths]),
        np.array([each.position for each in truths]),
        np.array([each.quat for each in truths]),
    )
    real = sample_at(truth, np.maximum(stamps_ns, truth.stamps_ns[0]))
    turn = rotations.multiply(real.quats[0], rotations.conjugate(poses[0][1]))
    moved = np.array([pose[0] - poses[0][0] for pose in poses])
    moved = rotations.rotate(np.tile(turn, (len(moved), 1)), moved)
    return np.linalg.norm(moved + real.positions[0] - real.positions, axis=1)


def late_lidar(offset_ns: int, from_ns: int) -> Fault:
    """Scans that end after ``from_ns`` are stamped too late by ``offset_ns``."""

    def fault(sample: SensorSample) -> SensorSample:
        if isinstance(sample, LidarScan) and int(sample.stamps_ns.max()) >= from_ns:
            return replace(sample, stamps_ns=sample.stamps_ns + offset_ns)
        return sample

    return fault


def test_the_robot_walks_and_a_sound_stream_is_trusted(walk) -> None:
    run = follow(walk)
    assert run.tracking[run.stamps_ns > 1_300_000_000].all()
    assert run.errors.max() < 0.02
    truths = [s.position[:2] for s in walk if isinstance(s, PoseSample)]
    assert np.linalg.norm(truths[-1] - truths[0]) > 0.5
    rates = [s.gyro for s in walk if isinstance(s, ImuSample) if s.stamp_ns > FAULT_NS]
    assert np.abs(rates).max() > 1.0


@pytest.mark.parametrize("offset_ms", [50, -50])
def test_clock_that_jumps_in_mid_walk(walk, offset_ms: int) -> None:
    offset_ns = offset_ms * 1_000_000
    # Nobody can know of the jump before the first scan after it.
    run = follow(
        walk,
        late_lidar(offset_ns, FAULT_NS),
        lambda now_ns: offset_ns if now_ns > FAULT_NS + 100_000_000 else 0,
    )
    assert run.first_lost_s() <= 0.3
    assert run.never_sure_and_wrong()
    assert run.lio.health().clock_offset_ns * 1e-6 == pytest.approx(-offset_ms, abs=10)
    assert run.tracking[-1]
    assert run.errors[-1] < 0.03


@pytest.mark.parametrize("offset_ms", [50, -50])
def test_clock_that_is_wrong_from_the_start(walk, offset_ms: int) -> None:
    offset_ns = offset_ms * 1_000_000
    run = follow(walk, late_lidar(offset_ns, 0), lambda now_ns: offset_ns)
    # At rest the offset does not show, and does no harm.
    assert (run.errors[run.tracking] < WRONG_M).all()
    assert run.lio.health().clock_offset_ns * 1e-6 == pytest.approx(-offset_ms, abs=10)
    assert run.tracking[-1]
    assert run.errors[-1] < 0.03


def test_rko_between_and_beyond_its_late_scans(walk) -> None:
    """What a loop asks: poses of now, while the newest scan is 40 to 140 ms old."""
    errors = {}
    for follow_imu in (True, False):
        rko, waiting, rows = RkoLio(RkoLioConfig(follow_imu=follow_imu)), [], []
        for sample in walk:
            if isinstance(sample, LidarScan):
                waiting.append(sample)
            elif isinstance(sample, ImuSample):
                now_ns = sample.stamp_ns
                rko.add_imu(now_ns, sample.gyro, sample.accel)
                if waiting and waiting[0].stamps_ns.max() + 40_000_000 <= now_ns:
                    late = waiting.pop(0)
                    rko.add_scan(late.points, late.stamps_ns)
                if now_ns % 20_000_000 == 0 and now_ns > 1_000_000_000:
                    rows.append((now_ns, rko.pose_at(now_ns)))
        end_ns = max(s.stamp_ns for s in walk if isinstance(s, PoseSample))
        rows = [row for row in rows if row[0] <= end_ns]
        stamps = np.array([row[0] for row in rows])
        each = position_errors(walk, stamps, [row[1] for row in rows])
        errors[follow_imu] = np.percentile(each[stamps > FAULT_NS], 95)
    assert errors[True] < 0.03
    assert errors[True] < 0.7 * errors[False]


def test_dropped_scans(walk) -> None:
    rng = np.random.default_rng(3)
    chance = {id(s): rng.random() for s in walk if isinstance(s, LidarScan)}

    def fault(sample: SensorSample) -> SensorSample | None:
        return None if chance.get(id(sample), 1.0) < 0.2 else sample

    run = follow(walk, fault)
    assert (run.errors[run.tracking] < WRONG_M).all()
    assert run.tracking[-1]


def test_gap_of_the_imu(walk) -> None:
    def fault(sample: SensorSample) -> SensorSample | None:
        if not isinstance(sample, ImuSample):
            return sample
        gone = FAULT_NS < sample.stamp_ns < FAULT_NS + 200_000_000
        return None if gone else sample

    run = follow(walk, fault)
    assert run.first_lost_s() <= 0.3
    assert run.never_sure_and_wrong()
    assert run.tracking[-1]
    assert run.errors[-1] < 0.03


def test_a_scan_of_zeros(walk) -> None:
    def fault(sample: SensorSample) -> SensorSample:
        if isinstance(sample, LidarScan):
            end_ns = int(sample.stamps_ns.max())
            if FAULT_NS <= end_ns < FAULT_NS + 100_000_000:
                return replace(sample, points=np.zeros_like(sample.points))
        return sample

    run = follow(walk, fault)
    assert run.lio.health().skipped_scans == 1
    assert (run.errors[run.tracking] < WRONG_M).all()
    assert run.tracking[-1]
