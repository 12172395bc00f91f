"""Compiles the inner loops before the first scan needs them."""

from __future__ import annotations

import numpy as np

from openclone.odometry.clock_offset import disagreement
from openclone.odometry.fast_lio import FastLio, FastLioConfig
from openclone.odometry.imu import STANDARD_GRAVITY

PERIOD_NS = 5_000_000
SCAN_SAMPLES = 20


def warm_up(config: FastLioConfig | None = None) -> None:
    """Run a still second in a cube, so that all loops are compiled and loaded.

    The first call on a machine takes most of a minute, later ones about a second:
    compiled code is cached beside the source.
    """
    lio = FastLio(config or FastLioConfig())
    rng = np.random.default_rng(0)
    rays = rng.standard_normal((3000, 3))
    points = 2.5 * rays / np.abs(rays).max(axis=1, keepdims=True)
    for k in range(14 * SCAN_SAMPLES + 1):
        stamp = k * PERIOD_NS
        lio.add_imu(stamp, np.zeros(3), np.array((0.0, 0.0, STANDARD_GRAVITY)))
        if k and k % SCAN_SAMPLES == 0:
            start = stamp - SCAN_SAMPLES * PERIOD_NS
            lio.add_tilt(stamp, (0.0, 0.0, 1.0))
            lio.add_scan(points, np.linspace(start + 1, stamp, 3000).astype(np.int64))
    lio.pose_at(14 * SCAN_SAMPLES * PERIOD_NS - PERIOD_NS // 2)
    # A sound stream never needs this one; it must not be compiled in mid-fault.
    times, first, none = np.arange(3) * 0.1, np.zeros(1, np.int64), np.zeros(1)
    seen = np.zeros((2, 3, 3))
    disagreement(times, np.zeros((3, 3)), times[:2], seen, first, none)
