"""What the simulated robot's sensors deliver, as a file."""

from __future__ import annotations

from pathlib import Path

import mujoco
import numpy as np
import pytest

from openclone.evaluation.sensor_recording import STILL_S, record_walk
from openclone.odometry.recording import read_samples
from openclone.odometry.samples import ImuSample, LidarScan, PoseSample, stamp_of
from openclone.policy.bundle import load_bundle
from openclone.robot.model import standing_qpos
from openclone.simulation.sensors import imu_pose
from openclone.simulation.worlds import build_world


def test_a_recorded_walk(tmp_path: Path) -> None:
    path = tmp_path / "walk.mcap"
    walk = record_walk(path, load_bundle(None), world="room", seconds=0.5)
    samples = list(read_samples(path, say=pytest.fail))
    scans = [s for s in samples if isinstance(s, LidarScan)]
    readings = [s for s in samples if isinstance(s, ImuSample)]
    truth = [s for s in samples if isinstance(s, PoseSample)]
    assert walk.scans == len(scans)
    assert abs(walk.scans - 10 * (STILL_S + 0.5)) <= 1
    assert walk.readings == len(readings)
    assert abs(walk.readings - 200 * (STILL_S + 0.5)) <= 4
    assert all(len(s.points) == 20_000 for s in scans)
    # Streams whose stamps rise, and no scan before the readings that it needs.
    for stream in (scans, readings, truth):
        assert (np.diff([stamp_of(s) for s in stream]) > 0).all()
    newest_ns = 0
    for sample in samples:
        if isinstance(sample, ImuSample):
            newest_ns = sample.stamp_ns
        elif isinstance(sample, LidarScan) and sample is not scans[-1]:
            assert stamp_of(sample) - newest_ns < 10_000_000
    # The robot stands at first: gravity on the IMU, which hangs upside down, and the
    # truth is where the model has it.
    rest = np.mean([s.accel for s in readings[20:250]], axis=0)
    assert np.linalg.norm(rest) == pytest.approx(9.81, abs=0.3)
    assert rest[2] < -9.0
    world = build_world("room")
    data = mujoco.MjData(world.model)
    data.qpos[:] = standing_qpos()
    mujoco.mj_kinematics(world.model, data)
    np.testing.assert_allclose(truth[0].position, imu_pose(data).position, atol=1e-9)
