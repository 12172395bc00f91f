"""NEES of FAST-LIO2 over seeded runs: are its errors as large as it says?

    python benchmarks/odometry_consistency.py --runs 50 --json nees.json

Each run draws biases, sensor noise and path from its seed. The filter is told the true
noise densities of the simulated IMU; everything else is as shipped. For a consistent
filter, the normalized squared error per dimension averages 1.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "odometry"))
import consistency


def main() -> None:
    """Run, print and store."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=50)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    start = time.process_time()
    runs = []
    for seed in range(options.runs):
        runs.append(consistency.run(seed, config=consistency.told_noise()))
        print(f"run {seed + 1} of {options.runs}", file=sys.stderr, flush=True)
    result = consistency.nees(runs)
    for name, value in result.items():
        size = len(consistency.BLOCKS[name])
        # 95 % of the averages of one moment per run lie in this band.
        width = 2.0 * np.sqrt(2.0 / (size * options.runs))
        print(f"{name:12s} {value:5.2f}   95 %: {1 - width:.2f} to {1 + width:.2f}")
    print(f"{options.runs} runs, {time.process_time() - start:.0f} s of CPU")
    if options.json:
        text = json.dumps({"runs": options.runs, "nees": result}, indent=2)
        options.json.write_text(text + "\n")


if __name__ == "__main__":
    main()
