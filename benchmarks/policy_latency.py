"""How long one decision of the student takes on one core, and how large its bundle is.

Three things take turns in blocks of 50 calls, in one process tied to one core:

1. ``raw session``: `onnxruntime.InferenceSession.run` with the input ready, one thread;
   the reference;
2. ``bundle``: `Bundle.act`, which OpenClone calls;
3. ``controller``: `StudentController.step`, a whole decision: sensors and command to
   observation, history, network, joint targets.

Wall time is what a 50 Hz loop feels; processor time leaves out what other programs did
meanwhile. Inputs are different in every call, and the same for 1 and 2.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import time
from collections.abc import Callable
from pathlib import Path

for _library in ("OMP", "OPENBLAS", "MKL"):
    os.environ[f"{_library}_NUM_THREADS"] = "1"

import numpy as np  # noqa: E402
import onnxruntime  # noqa: E402

from openclone.policy.bundle import (  # noqa: E402
    Bundle,
    load_bundle,
    packaged_bundle,
)
from openclone.policy.command import Command, KeyPoints  # noqa: E402
from openclone.policy.controller import StudentController  # noqa: E402
from openclone.policy.observation import Proprioception  # noqa: E402
from openclone.robot import g1  # noqa: E402
from openclone.robot.kinematics import Kinematics  # noqa: E402
from openclone.robot.model import standing_qpos  # noqa: E402

TARGET_P99_MS, TARGET_MB = 1.0, 15.0
_BLOCK = 50


def raw_session(path: Path) -> Callable[[np.ndarray], object]:
    """Only onnxruntime, with one thread."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1
    options.inter_op_num_threads = 1
    session = onnxruntime.InferenceSession(
        str(path), options, providers=["CPUExecutionProvider"]
    )
    return lambda inputs: session.run(["action"], {"observation": inputs})


def controller(bundle: Bundle) -> Callable[[np.ndarray], object]:
    """A whole decision; its sensor readings are the first values of the input."""
    student = StudentController(bundle)
    points, quats = Kinematics().key_points(standing_qpos())
    command = Command(KeyPoints(points + 0.05, quats), np.full((3, 3), 0.1))

    def decide(inputs: np.ndarray) -> object:
        values = inputs[0].astype(np.float64)
        now = Proprioception(
            joint_angles=g1.DEFAULT_POSE + 0.1 * values[:29],
            joint_velocities=values[29:58],
            angular_velocity_b=0.1 * values[58:61],
            base_quat=np.array([1.0, 0.0, 0.0, 0.0]),
        )
        return student.step(command, now, KeyPoints(points, quats))

    return decide


def measure(
    works: dict[str, Callable[[np.ndarray], object]], inputs: np.ndarray, calls: int
) -> dict[str, np.ndarray]:
    """Wall and processor milliseconds of every call, ``(calls, 2)``, by name."""
    times = {name: np.empty((calls, 2)) for name in works}
    for first in range(-_BLOCK, calls, _BLOCK):
        for name, work in works.items():
            for call in range(first, min(first + _BLOCK, calls)):
                row = inputs[call % len(inputs)][None]
                wall, own = time.perf_counter_ns(), time.thread_time_ns()
                work(row)
                own, wall = time.thread_time_ns() - own, time.perf_counter_ns() - wall
                if call >= 0:  # the first block warms up
                    times[name][call] = wall * 1e-6, own * 1e-6
    return times


def summary(times: dict[str, np.ndarray]) -> dict[str, dict[str, float]]:
    """Percentiles in ms, and the medians as multiples of the raw session's."""
    reference = np.median(times["raw session"], axis=0)
    figures = {}
    for name, values in times.items():
        p50, p99 = np.percentile(values, (50, 99), axis=0)
        figures[name] = {
            "p50_ms": float(p50[0]),
            "p99_ms": float(p99[0]),
            "longest_ms": float(values[:, 0].max()),
            "cpu_p50_ms": float(p50[1]),
            "cpu_p99_ms": float(p99[1]),
            "times_raw_p50": float(p50[0] / reference[0]),
            "cpu_times_raw_p50": float(p50[1] / reference[1]),
        }
    return figures


def one_core() -> str:
    """Tie this process to one of its cores, where the system can."""
    if not hasattr(os, "sched_setaffinity"):
        return "not tied to a core"
    core = max(os.sched_getaffinity(0))
    os.sched_setaffinity(0, {core})
    return f"core {core}"


def main() -> None:
    """Measure, print, and write JSON if asked."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--policy", type=Path, help="default: the packaged student")
    parser.add_argument("--calls", type=int, default=5000)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    path = arguments.policy or packaged_bundle()
    core = one_core()
    bundle = load_bundle(path)
    rng = np.random.default_rng(0)
    shape = (64, bundle.info.observation_size)
    inputs = rng.normal(0.0, 0.5, shape).astype(np.float32)
    works = {
        "raw session": raw_session(path),
        "bundle": bundle.act,
        "controller": controller(bundle),
    }
    figures = summary(measure(works, inputs, arguments.calls))
    size_mb = path.stat().st_size / 1e6
    print(f"{'':12}" + "".join(f"{key:>18}" for key in figures["bundle"]))
    for name, values in figures.items():
        print(f"{name:12}" + "".join(f"{value:18.3f}" for value in values.values()))
    student = figures["bundle"]
    print(
        f"p99 of the student {student['p99_ms']:.3f} ms, of its processor time "
        f"{student['cpu_p99_ms']:.3f} ms; target ≤ {TARGET_P99_MS:g} ms "
        f"(load {os.getloadavg()[0]:.1f} on {os.cpu_count()} cores)"
    )
    print(f"bundle {size_mb:.2f} MB, target ≤ {TARGET_MB:g} MB")
    if arguments.json:
        result = {
            "machine": f"{platform.processor() or platform.machine()}, {core}",
            "load": os.getloadavg()[0],
            "onnxruntime": onnxruntime.__version__,
            "calls": arguments.calls,
            "size_mb": size_mb,
            "target_p99_ms": TARGET_P99_MS,
            "target_mb": TARGET_MB,
            **figures,
        }
        arguments.json.write_text(json.dumps(result, indent=2) + "\n")


if __name__ == "__main__":
    main()
