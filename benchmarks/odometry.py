"""FAST-LIO2 beside rko_lio and kiss-icp, on one recorded stream in one run.

The stream (`room_stream.py`, or any recording with ground truth) is written as MCAP
once. Then each system reads that file in a process of its own, with one thread. The
peers run twice, with their own settings and with settings for rooms, and are judged by
the better run. All see the same points: no returns are taken out for the peers, which
would take them for walls. All poses are those of the IMU, and errors are those after
the best rigid alignment over the poses that a system calls tracked, without the first
two seconds, in which some systems still start and the sensor stands still.

Times are processor times of one scan (20 000 points), without reading the file, so
that other work on the machine disturbs them little. Memory is the resident size of
the process; libraries that are loaded before the first scan are counted as well.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterable
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path

_LIBRARIES = ("OMP", "NUMBA", "OPENBLAS", "MKL", "TBB")
# Before NumPy is imported, here and in each process.
os.environ.update({f"{name}_NUM_THREADS": "1" for name in _LIBRARIES})

import numpy as np  # noqa: E402

from openclone.odometry.protocol import OdometryHealth, SensorOdometry  # noqa: E402
from openclone.odometry.recording import SensorRecorder, read_samples  # noqa: E402
from openclone.odometry.replay import Replay, replay  # noqa: E402
from openclone.odometry.samples import SensorSample  # noqa: E402
from openclone.odometry.trajectory import Trajectory, compare  # noqa: E402
from openclone.spatial import rotations  # noqa: E402
from room_stream import LIDAR_IN_IMU, RoomStreamConfig, room_stream  # noqa: E402

START_NS = 2_000_000_000
TARGET_ATE_RATIO, TARGET_MEAN_MS, TARGET_P99_MS, TARGET_MB = 3.0, 25.0, 45.0, 400.0


@dataclass(frozen=True)
class Outcome:
    """What one system did with the stream.

    Attributes:
        ate_cm: root mean square position error after alignment.
        max_cm: largest position error.
        heading_deg: largest heading error.
        scans: read.
        tracked: of them, by the system's own judgement.
        mean_ms: processor time per scan.
        p99_ms: 99th percentile of it.
        imu_us: processor time per IMU reading.
        start_mb: resident memory after 10 s of the stream.
        end_mb: resident memory at its end.
    """

    ate_cm: float
    max_cm: float
    heading_deg: float
    scans: int
    tracked: int
    mean_ms: float
    p99_ms: float
    imu_us: float
    start_mb: float
    end_mb: float


class KissIcp:
    """kiss-icp behind the same interface: LiDAR only, its pose moved to the IMU."""

    def __init__(self, voxel_size: float, max_range: float, min_range: float) -> None:
        """Start at the origin."""
        from kiss_icp.config import KISSConfig
        from kiss_icp.kiss_icp import KissICP

        config = KISSConfig()
        config.mapping.voxel_size = voxel_size
        config.data.max_range, config.data.min_range = max_range, min_range
        config.registration.max_num_threads = 1
        self._icp = KissICP(config)
        self._position, self._quat = np.zeros(3), np.array(rotations.IDENTITY)
        self._min_range = min_range

    def add_imu(self, stamp_ns: int, gyro: np.ndarray, accel: np.ndarray) -> None:
        """It has no use for the IMU."""

    def add_scan(self, points: np.ndarray, stamps_ns: np.ndarray) -> None:
        """Register one frame; its pose is that at the end of the frame."""
        sizes = np.linalg.norm(points, axis=1)
        seen = np.isfinite(sizes) & (sizes > max(self._min_range, 0.05))
        start_ns, end_ns = stamps_ns.min(), stamps_ns.max()
        shares = (stamps_ns[seen] - start_ns) / max(end_ns - start_ns, 1)
        self._icp.register_frame(points[seen].astype(np.float64), shares)
        turn = self._icp.last_pose[:3, :3]
        self._position = self._icp.last_pose[:3, 3] - turn @ LIDAR_IN_IMU
        self._quat = rotations.from_matrix(turn)

    def pose_at(self, stamp_ns: int) -> tuple[np.ndarray, np.ndarray]:
        """The newest pose."""
        return self._position, self._quat

    def health(self, stamp_ns: int) -> OdometryHealth:
        """It has no notion of it."""
        return OdometryHealth(tracking=True, age_ns=0)


def _fast_lio() -> SensorOdometry:
    from openclone.odometry.fast_lio import FastLio
    from openclone.odometry.warmup import warm_up

    warm_up()
    return FastLio()


def _rko(voxel_size: float, min_range: float, max_range: float) -> SensorOdometry:
    from openclone.odometry.rko import RkoLio, RkoLioConfig

    return RkoLio(
        RkoLioConfig(voxel_size=voxel_size, min_range=min_range, max_range=max_range)
    )


SYSTEMS: dict[str, Callable[[], SensorOdometry]] = {
    "openclone": _fast_lio,
    "rko_lio": lambda: _rko(1.0, 1.0, 100.0),
    "rko_lio (room)": lambda: _rko(0.25, 0.3, 60.0),
    "kiss-icp": lambda: KissIcp(1.0, 100.0, 0.0),
    "kiss-icp (room)": lambda: KissIcp(0.25, 30.0, 0.3),
}
"""Each peer with its authors' settings (voxels of 1 m) and with voxels for rooms."""


def _without_start(path: Trajectory) -> Trajectory:
    later = path.stamps_ns >= path.stamps_ns[0] + START_NS
    return Trajectory(path.stamps_ns[later], path.positions[later], path.quats[later])


def resident_mb() -> float:
    """Resident memory of this process (Linux)."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def run_one(system: str, samples: Iterable[SensorSample]) -> Outcome:
    """Run ``system`` over the stream, in this process."""
    engine, result = SYSTEMS[system](), Replay()
    memory: list[float] = []

    def progress(replayed: Replay, stamp_ns: int) -> None:
        if replayed.scans % 10 == 0:
            memory.append(resident_mb())

    replay(samples, engine, result, progress)
    error = compare(_without_start(result.trajectory), result.reference)
    scan_ms = 1e3 * np.array(result.scan_cpu_s)
    return Outcome(
        ate_cm=100 * error.ate_rmse_m,
        max_cm=100 * error.ate_max_m,
        heading_deg=error.heading_max_deg,
        scans=result.scans,
        tracked=result.tracked,
        mean_ms=float(scan_ms.mean()),
        p99_ms=float(np.percentile(scan_ms, 99)),
        imu_us=1e6 * result.imu_cpu_s / max(result.samples - result.scans, 1),
        start_mb=memory[min(9, len(memory) - 1)],
        end_mb=memory[-1],
    )


def run_apart(system: str, source: list[str], folder: Path) -> Outcome:
    """Run ``system`` in a process of its own, so that memory is its own."""
    answer = folder / "outcome.json"
    command = [sys.executable, __file__, "--one", system]
    command += [*source, "--json", str(answer)]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    if done.returncode:
        raise SystemExit(f"{system} failed:\n{done.stderr[-2000:]}")
    return Outcome(**json.loads(answer.read_text()))


def record_stream(path: Path, seconds: float, seed: int) -> None:
    """Write the analytic room as a recording."""
    with SensorRecorder(path) as recorder:
        for sample in room_stream(RoomStreamConfig(seconds=seconds, seed=seed)):
            recorder.write(sample)


def stream_of(arguments: argparse.Namespace) -> Iterable[SensorSample]:
    """The recording that was named, or the analytic room."""
    if arguments.stream:
        return read_samples(arguments.stream, say=lambda text: None)
    return room_stream(RoomStreamConfig(arguments.seconds, seed=arguments.seed))


def machine() -> str:
    """Processor and its cores."""
    cpu = platform.processor() or platform.machine()
    for line in Path("/proc/cpuinfo").read_text().splitlines():
        if line.startswith("model name"):
            cpu = line.partition(":")[2].strip()
            break
    return f"{cpu}, {os.cpu_count()} cores, {platform.system()}"


def versions() -> str:
    """Of everything that matters for the figures."""
    names = ("openclone", "rko_lio", "kiss-icp", "numpy", "numba")
    listed = ", ".join(f"{name} {version(name)}" for name in names)
    return f"Python {platform.python_version()}, {listed}"


def summarize(outcomes: dict[str, Outcome]) -> dict[str, object]:
    """Ratios to the better run of each peer, and whether the targets hold."""
    ours = outcomes["openclone"]
    summary: dict[str, object] = {}
    ratios = []
    for peer in ("rko_lio", "kiss-icp"):
        runs = [o for name, o in outcomes.items() if name.startswith(peer)]
        if runs:
            best = min(runs, key=lambda run: run.ate_cm)
            ratios.append(best.ate_cm / ours.ate_cm)
            summary[f"ate_{peer}_over_openclone"] = round(ratios[-1], 2)
            summary[f"time_openclone_over_{peer}"] = round(
                ours.mean_ms / best.mean_ms, 2
            )
    held = {
        f"ATE at least {TARGET_ATE_RATIO:g} x better": bool(ratios)
        and min(ratios) >= TARGET_ATE_RATIO,
        f"mean at most {TARGET_MEAN_MS:g} ms": ours.mean_ms <= TARGET_MEAN_MS,
        f"p99 at most {TARGET_P99_MS:g} ms": ours.p99_ms <= TARGET_P99_MS,
        f"memory at most {TARGET_MB:g} MB": ours.end_mb <= TARGET_MB,
        "memory flat (below 5 % growth)": ours.end_mb <= 1.05 * ours.start_mb,
    }
    summary["targets"] = held
    return summary


def measure(source: list[str], folder: Path, wanted: list[str]) -> dict[str, Outcome]:
    """Run the systems one after the other, and print a row for each."""
    print(f"{'':18}{'ATE cm':>8}{'max cm':>8}{'yaw °':>7}{'tracked':>12}", end="")
    print(f"{'mean ms':>9}{'p99 ms':>8}{'IMU µs':>8}{'MB 10 s':>9}{'MB end':>8}")
    outcomes = {}
    for name in wanted:
        o = outcomes[name] = run_apart(name, source, folder)
        print(
            f"{name:18}{o.ate_cm:8.2f}{o.max_cm:8.2f}{o.heading_deg:7.2f}"
            f"{f'{o.tracked}/{o.scans}':>12}{o.mean_ms:9.1f}{o.p99_ms:8.1f}"
            f"{o.imu_us:8.0f}{o.start_mb:9.0f}{o.end_mb:8.0f}",
            flush=True,
        )
    return outcomes


def main() -> None:
    """Measure, print, and write JSON if asked."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--stream", type=Path, help="a recording with ground truth")
    parser.add_argument(
        "--unrecorded", action="store_true", help="no file: for runs of many minutes"
    )
    parser.add_argument("--only", choices=SYSTEMS, help="run one system")
    parser.add_argument("--one", choices=SYSTEMS, help=argparse.SUPPRESS)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    if arguments.one:
        outcome = run_one(arguments.one, stream_of(arguments))
        arguments.json.write_text(json.dumps(asdict(outcome)))
        return
    begin = time.time()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        stream = arguments.stream or folder / "room.mcap"
        source = ["--stream", str(stream)]
        if arguments.unrecorded:
            source = [f"--seconds={arguments.seconds}", f"--seed={arguments.seed}"]
        elif arguments.stream is None:
            record_stream(stream, arguments.seconds, arguments.seed)
        print(f"{machine()}\n{versions()}\none thread, load ", end="")
        print(f"{os.getloadavg()[0]:.1f} (times are processor times)")
        wanted = [arguments.only] if arguments.only else list(SYSTEMS)
        outcomes = measure(source, folder, wanted)
    result: dict[str, object] = {"machine": machine(), "versions": versions()}
    result |= {name: asdict(outcome) for name, outcome in outcomes.items()}
    if "openclone" in outcomes:
        result |= summarize(outcomes)
        for key, value in summarize(outcomes).items():
            print(f"{key}: {value}")
    print(f"{time.time() - begin:.0f} s in all")
    if arguments.json:
        arguments.json.write_text(json.dumps(result, indent=2) + "\n")


if __name__ == "__main__":
    main()
