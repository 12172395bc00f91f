"""FAST-LIO2 beside rko_lio and kiss-icp, on the same recorded streams in one run.

    python benchmarks/odometry.py                   # box room, and walks in two worlds
    python benchmarks/odometry.py --stream FILE       # a recording with ground truth
    python benchmarks/odometry.py --only openclone --unrecorded --seconds 600   # memory

Each stream is written as MCAP once (`odometry_streams.py`). Then each system reads the
file in a process of its own, with one thread. The peers run with several settings
(`odometry_peers.py`) and are judged by their best one on each stream. All see the same
points: no returns are taken out for the peers, which would take them for walls. All
poses are those of the IMU at the end of a scan. Errors are those of evo after its
rigid alignment, over the poses that a system calls tracked, without the first two
seconds, in which some systems still start and the sensor stands still.

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
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path

_LIBRARIES = ("OMP", "NUMBA", "OPENBLAS", "MKL", "TBB")
# Before NumPy is imported, here and in each process.
os.environ.update({f"{name}_NUM_THREADS": "1" for name in _LIBRARIES})

import numpy as np  # noqa: E402

import odometry_streams  # noqa: E402
from odometry_peers import PEERS, SYSTEMS  # noqa: E402
from openclone.odometry.replay import Replay, replay  # noqa: E402
from openclone.odometry.samples import SensorSample  # noqa: E402
from openclone.odometry.trajectory import (  # noqa: E402
    Trajectory,
    compare,
    sample_at,
)
from room_stream import RoomStreamConfig, room_stream  # noqa: E402

START_NS = 2_000_000_000
MINUTE_SCANS = 600
TARGET_ATE_RATIO, TARGET_MEAN_MS, TARGET_P99_MS, TARGET_MB = 3.0, 25.0, 45.0, 400.0


@dataclass(frozen=True)
class Outcome:
    """What one system did with the stream.

    Attributes:
        ate_cm: root mean square position error after alignment, by evo.
        max_cm: largest position error.
        heading_deg: largest heading error.
        scans: read.
        tracked: of them, by the system's own judgement.
        mean_ms: processor time per scan.
        p99_ms: 99th percentile of it.
        imu_us: processor time per IMU reading.
        start_mb: resident memory after 10 s of the stream.
        end_mb: resident memory at its end.
        minutes_mb: resident memory after each minute of the stream.
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
    minutes_mb: list[float]


def _without_start(path: Trajectory) -> Trajectory:
    later = path.stamps_ns >= path.stamps_ns[0] + START_NS
    return Trajectory(path.stamps_ns[later], path.positions[later], path.quats[later])


def evo_ate_cm(estimate: Trajectory, truth: Trajectory) -> float:
    """Aligned ATE by evo, at the estimate's stamps."""
    from evo.core.metrics import APE, PoseRelation, StatisticsType
    from evo.core.trajectory import PoseTrajectory3D

    real = sample_at(truth, estimate.stamps_ns)
    keep = np.isin(estimate.stamps_ns, real.stamps_ns)
    pair = [
        PoseTrajectory3D(positions, quats, real.stamps_ns * 1e-9)
        for positions, quats in (
            (real.positions, real.quats),
            (estimate.positions[keep], estimate.quats[keep]),
        )
    ]
    pair[1].align(pair[0])
    ape = APE(PoseRelation.translation_part)
    ape.process_data((pair[0], pair[1]))
    return 100 * float(ape.get_statistic(StatisticsType.rmse))


def resident_mb() -> float:
    """Resident memory of this process (Linux)."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def run_one(system: str, samples: Iterable[SensorSample]) -> Outcome:
    """Run ``system`` over the stream, in this process."""
    engine, result = SYSTEMS[system](), Replay()
    memory: list[float] = []
    minutes: list[float] = []

    def progress(replayed: Replay, stamp_ns: int) -> None:
        if replayed.scans % 10 == 0:
            memory.append(resident_mb())
        if replayed.scans % MINUTE_SCANS == 0:
            minutes.append(round(memory[-1], 1))

    replay(samples, engine, result, progress)
    path = _without_start(result.trajectory)
    error = compare(path, result.reference)
    scan_ms = 1e3 * np.array(result.scan_cpu_s)
    return Outcome(
        ate_cm=evo_ate_cm(path, result.reference),
        max_cm=100 * error.ate_max_m,
        heading_deg=error.heading_max_deg,
        scans=result.scans,
        tracked=result.tracked,
        mean_ms=float(scan_ms.mean()),
        p99_ms=float(np.percentile(scan_ms, 99)),
        imu_us=1e6 * result.imu_cpu_s / max(result.samples - result.scans, 1),
        start_mb=memory[min(9, len(memory) - 1)],
        end_mb=memory[-1],
        minutes_mb=minutes,
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
    names = ("openclone", "rko_lio", "kiss-icp", "evo", "numpy", "numba")
    listed = ", ".join(f"{name} {version(name)}" for name in names)
    return f"Python {platform.python_version()}, {listed}"


def summarize(outcomes: dict[str, Outcome]) -> dict[str, object]:
    """Ratios to the best run of each peer, and whether the targets hold."""
    ours = outcomes["openclone"]
    summary: dict[str, object] = {}
    ratios = []
    for peer in PEERS:
        runs = {n: o for n, o in outcomes.items() if n.startswith(peer)}
        if runs:
            name = min(runs, key=lambda one: runs[one].ate_cm)
            ratios.append(runs[name].ate_cm / ours.ate_cm)
            summary[f"best of {peer}"] = name
            summary["... its ATE over ours"] = round(ratios[-1], 2)
            faster = ours.mean_ms / runs[name].mean_ms
            summary["... our time over its"] = round(faster, 2)
            summary = {k.replace("...", peer): v for k, v in summary.items()}
    held = {
        f"mean at most {TARGET_MEAN_MS:g} ms": ours.mean_ms <= TARGET_MEAN_MS,
        f"p99 at most {TARGET_P99_MS:g} ms": ours.p99_ms <= TARGET_P99_MS,
        f"memory at most {TARGET_MB:g} MB": ours.end_mb <= TARGET_MB,
        "memory flat (below 5 % growth)": ours.end_mb <= 1.05 * ours.start_mb,
    }
    if ratios:
        ahead = min(ratios) >= TARGET_ATE_RATIO
        held = {f"ATE at least {TARGET_ATE_RATIO:g} x better": ahead} | held
    summary["targets"] = held
    return summary


def measure(source: list[str], folder: Path, wanted: list[str]) -> dict[str, Outcome]:
    """Run the systems one after the other, and print a row for each."""
    print(f"{'':29}{'ATE cm':>8}{'max cm':>8}{'yaw °':>7}{'tracked':>12}", end="")
    print(f"{'mean ms':>9}{'p99 ms':>8}{'IMU µs':>8}{'MB 10 s':>9}{'MB end':>8}")
    outcomes = {}
    for name in wanted:
        o = outcomes[name] = run_apart(name, source, folder)
        print(
            f"{name:29}{o.ate_cm:8.2f}{o.max_cm:8.2f}{o.heading_deg:7.2f}"
            f"{f'{o.tracked}/{o.scans}':>12}{o.mean_ms:9.1f}{o.p99_ms:8.1f}"
            f"{o.imu_us:8.0f}{o.start_mb:9.0f}{o.end_mb:8.0f}",
            flush=True,
        )
        if o.minutes_mb:
            listed = ", ".join(f"{value:.0f}" for value in o.minutes_mb)
            print(f"{'':29} MB after each minute: {listed}")
    return outcomes


def arguments_of() -> argparse.Namespace:
    """The command line."""
    names = (odometry_streams.BOX, *odometry_streams.WALKS)
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seconds", type=float, default=30.0, help="of each stream")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument(
        "--streams", nargs="+", choices=names, default=["box", "room", "hall"]
    )
    parser.add_argument("--stream", type=Path, help="a recording instead of these")
    parser.add_argument(
        "--unrecorded",
        action="store_true",
        help="the box room without a file: for runs of many minutes",
    )
    parser.add_argument("--only", help="systems whose name begins so")
    parser.add_argument("--one", choices=SYSTEMS, help=argparse.SUPPRESS)
    parser.add_argument("--json", type=Path)
    return parser.parse_args()


def run_in_this_process(arguments: argparse.Namespace) -> None:
    """What `run_apart` starts."""
    if arguments.stream:
        samples = odometry_streams.read(arguments.stream)
    else:
        samples = room_stream(RoomStreamConfig(arguments.seconds, seed=arguments.seed))
    outcome = run_one(arguments.one, samples)
    arguments.json.write_text(json.dumps(asdict(outcome)))


def source_of(name: str, arguments: argparse.Namespace, folder: Path) -> list[str]:
    """What tells a process of `run_apart` where its stream is; recorded if need be."""
    if arguments.stream:
        return ["--stream", str(arguments.stream)]
    if arguments.unrecorded:
        return [f"--seconds={arguments.seconds}", f"--seed={arguments.seed}"]
    path = folder / f"{name}.mcap"
    odometry_streams.record(name, path, arguments.seconds, arguments.seed)
    return ["--stream", str(path)]


def main() -> None:
    """Measure, print, and write JSON if asked."""
    arguments = arguments_of()
    if arguments.one:
        run_in_this_process(arguments)
        return
    begin = time.time()
    streams = list(arguments.streams)
    if arguments.stream or arguments.unrecorded:
        streams = [arguments.stream.name if arguments.stream else odometry_streams.BOX]
    wanted = [name for name in SYSTEMS if name.startswith(arguments.only or "")]
    if not wanted:
        raise SystemExit(f"no system begins with {arguments.only!r}: {list(SYSTEMS)}")
    result: dict[str, object] = {"machine": machine(), "versions": versions()}
    print(f"{machine()}\n{versions()}\none thread, load ", end="")
    print(f"{os.getloadavg()[0]:.1f} (times are processor times)")
    with tempfile.TemporaryDirectory() as temporary:
        folder = Path(temporary)
        for name in streams:
            print(
                f"\n{name}, {arguments.seconds:g} s:" if not arguments.stream else name
            )
            source = source_of(name, arguments, folder)
            outcomes = measure(source, folder, wanted)
            rows: dict[str, object] = {n: asdict(o) for n, o in outcomes.items()}
            if "openclone" in outcomes:
                summary = summarize(outcomes)
                rows |= summary
                for key, value in summary.items():
                    print(f"{key}: {value}")
            result[name] = rows
            if arguments.json:
                arguments.json.write_text(json.dumps(result, indent=2) + "\n")
    print(f"{time.time() - begin:.0f} s in all")


if __name__ == "__main__":
    main()
