"""Retargeted frames per second of one core, beside a plain mink loop.

Two rates on the same recording, alternately in one run, in seconds of processor time
(other work on the machine counts in neither):

1. OpenClone end to end: reading the file, targets, foot locking, inverse kinematics
   with joint ranges, speed limits and collision limits, and all quality figures;
2. a plain mink loop: 14 frame tasks, one solution per frame, joint ranges only, its
   targets given; no reading, no contacts, no collision or speed limits, no figures.

Run it with ``python benchmarks/retargeting.py RECORDING``.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import resource
import time
from pathlib import Path

# The matrices are small: more threads only wait for each other.
os.environ.setdefault("OMP_NUM_THREADS", "1")

import mink
import mujoco
import numpy as np

from openclone.motion.clip import Clip, ClipInfo
from openclone.motion.quality import ClipQuality
from openclone.motion.readers import read_recording
from openclone.motion.retarget import Solver, follow
from openclone.robot import g1
from openclone.robot.kinematics import Kinematics
from openclone.robot.model import build_model

INFO = ClipInfo("benchmark", "forward", "a recording", "unknown", 50.0)


def end_to_end(path: Path, solver: Solver) -> tuple[Clip, ClipQuality, float]:
    """Clip, figures and frames per second of processor time."""
    start = time.process_time()
    clip, quality = follow(read_recording(path), INFO, solver)
    return clip, quality, clip.num_frames / (time.process_time() - start)


def plain_mink(clip: Clip) -> float:
    """Frames per second of processor time to follow all 14 key bodies of ``clip``."""
    model = build_model(floor=False)
    configuration = mink.Configuration(model)
    configuration.update(clip.qpos[0])
    positions, quats = Kinematics(model).trajectory(clip.qpos)
    tasks = [
        mink.FrameTask(name, "body", position_cost=10.0, orientation_cost=1.0)
        for name in g1.KEY_BODIES
    ]
    limits = [mink.ConfigurationLimit(model)]
    start = time.process_time()
    for frame in range(clip.num_frames):
        for index, task in enumerate(tasks):
            pose = np.concatenate((quats[frame, index], positions[frame, index]))
            task.set_target(mink.SE3(pose))
        step = mink.solve_ik(configuration, tasks, 1.0, "daqp", limits=limits)
        configuration.integrate_inplace(step, 1.0)
    return clip.num_frames / (time.process_time() - start)


def main() -> None:
    """Measure, print, and write JSON if asked."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("recording", type=Path)
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    solver = Solver()
    ours, plain = [], []
    clip, quality, _ = end_to_end(arguments.recording, solver)
    for _ in range(arguments.rounds):
        ours.append(end_to_end(arguments.recording, solver)[2])
        plain.append(plain_mink(clip))
    peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    result = {
        "machine": f"{platform.processor() or platform.machine()}, "
        f"{os.cpu_count()} cores",
        "versions": f"mujoco {mujoco.__version__}",
        "recording": arguments.recording.name,
        "frames": clip.num_frames,
        "openclone_frames_s": round(float(np.median(ours)), 1),
        "plain_mink_frames_s": round(float(np.median(plain)), 1),
        "openclone_over_plain": round(float(np.median(ours) / np.median(plain)), 3),
        "peak_memory_mb": round(peak_mb),
        "quality": str(quality),
    }
    for name, value in result.items():
        print(f"{name:22} {value}")
    if arguments.json:
        arguments.json.write_text(json.dumps(result, indent=2) + "\n")


if __name__ == "__main__":
    main()
