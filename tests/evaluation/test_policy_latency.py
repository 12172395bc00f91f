"""The latency benchmark: what it counts, and that it runs."""

from __future__ import annotations

import numpy as np
import pytest

import policy_latency
from openclone.policy.bundle import load_bundle, packaged_bundle


def test_percentiles_and_ratios_by_hand():
    # Wall times 1 to 101 ms, processor times half of that.
    wall = np.arange(1.0, 102.0)
    raw = np.stack((wall, wall / 2), axis=1)
    figures = policy_latency.summary({"raw session": raw, "bundle": 2.0 * raw})
    assert figures["raw session"]["p50_ms"] == pytest.approx(51.0)
    assert figures["raw session"]["p99_ms"] == pytest.approx(100.0)
    assert figures["bundle"]["cpu_p50_ms"] == pytest.approx(51.0)
    assert figures["bundle"]["longest_ms"] == pytest.approx(202.0)
    assert figures["bundle"]["times_raw_p50"] == pytest.approx(2.0)


def test_reference_and_bundle_compute_the_same_and_every_call_is_timed():
    bundle = load_bundle()
    works = {
        "raw session": policy_latency.raw_session(packaged_bundle()),
        "bundle": bundle.act,
        "controller": policy_latency.controller(bundle),
    }
    rng = np.random.default_rng(0)
    shape = (4, bundle.info.observation_size)
    inputs = rng.normal(size=shape).astype(np.float32)
    raw = works["raw session"](inputs[:1])
    assert isinstance(raw, list)
    assert np.array_equal(raw[0], bundle.act(inputs[:1]))
    times = policy_latency.measure(works, inputs, 60)
    for values in times.values():
        assert values.shape == (60, 2)
        assert values.min() >= 0.0
        assert np.isfinite(values).all()
    # A whole decision contains the network: it cannot be faster.
    means = {name: np.median(values[:, 1]) for name, values in times.items()}
    assert means["controller"] > means["bundle"]
