"""`openclone odometry run`: from a file to a trajectory that evo reads."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from evo.tools import file_interface

from openclone import cli
from openclone.errors import InputError
from openclone.odometry.recording import SensorRecorder
from room_stream import RoomStreamConfig, imu_pose, room_stream

SECONDS = 7.0
START_NS = 1_700_000_000_000_000_000


@pytest.fixture(scope="module")
def recording(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("rec") / "room.mcap"
    config = RoomStreamConfig(seconds=SECONDS, points=5_000, start_ns=START_NS)
    with SensorRecorder(path) as recorder:
        for sample in room_stream(config):
            recorder.write(sample)
    return path


@pytest.mark.parametrize(("kind", "ate_cm"), [("lio", 0.6), ("rko", 6.0)])
def test_a_walk_in_a_room(
    recording: Path, tmp_path: Path, kind: str, ate_cm: float
) -> None:
    out, figures = tmp_path / "out", tmp_path / "f.json"
    options = f"--odometry {kind} --out {out} --json {figures}"
    cli.run(f"odometry run {recording} {options}".split())
    numbers = json.loads(figures.read_text())
    assert numbers["scans"] == 10 * SECONDS
    assert numbers["ate_cm"] < ate_cm
    assert (out / "trajectory.png").read_bytes().startswith(b"\x89PNG")
    path = file_interface.read_tum_trajectory_file(out / "trajectory.tum")
    assert path.check()[0]
    assert path.num_poses == numbers["tracked"] > 50
    # The distance walked from the first to the last pose, from the stream's formula.
    truth, _ = imu_pose(path.timestamps[[0, -1]] - START_NS * 1e-9)
    walked = np.linalg.norm(path.positions_xyz[-1] - path.positions_xyz[0])
    assert walked == pytest.approx(np.linalg.norm(truth[1] - truth[0]), abs=0.1)


def test_what_came_before_the_damage_is_kept(recording: Path, tmp_path: Path) -> None:
    cut = tmp_path / "cut.mcap"
    whole = recording.read_bytes()
    cut.write_bytes(whole[: len(whole) * 4 // 5])
    with pytest.raises(InputError, match=r"byte \d+: .*truncated.*came before"):
        cli.run(
            ["odometry", "run", str(cut), "--out", str(tmp_path), "--odometry", "rko"]
        )
    path = file_interface.read_tum_trajectory_file(tmp_path / "trajectory.tum")
    assert 20 < path.num_poses < 69


def test_errors_are_one_line(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(b"no recording at all")
    command = str(Path(sys.executable).with_name("openclone"))
    done = subprocess.run(
        [command, "odometry", "run", str(path), "--out", str(tmp_path / "o")],
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 2
    assert done.stderr.startswith(f"error: {path}: not an MCAP file")
    assert done.stderr.count("\n") == 1
    assert not (tmp_path / "o").exists()
