"""Squats: what is commanded, and how a run along it is judged."""

from __future__ import annotations

import json

import numpy as np
import pytest

from openclone.evaluation.experiment_report import (
    squat_summary,
    squat_text,
    write_squat_report,
)
from openclone.evaluation.metrics import Trace
from openclone.evaluation.squat import (
    TOLERANCE,
    SquatLevel,
    SquatReport,
    judge,
    operator_scale,
)
from openclone.evaluation.squat_reference import SquatReference, squat_reference
from openclone.robot import g1
from openclone.robot.model import CONTROL_PERIOD

PERIOD = CONTROL_PERIOD
ANKLES = [g1.KEY_BODIES.index(f"{side}_ankle_roll_link") for side in ("left", "right")]


@pytest.fixture(scope="module")
def squats() -> dict[float, SquatReference]:
    return {
        height: squat_reference(height, np.random.default_rng(3))
        for height in (0.9, 0.6, 0.47)
    }


def run_of(wanted: SquatReference, lift: np.ndarray | float = 0.0) -> Trace:
    """A run that does what the body's reference does, ``lift (T,)`` metres higher."""
    reference = wanted.reference
    position = reference.position[1:].copy()
    position[..., 2] += np.broadcast_to(lift, len(position))[:, None]
    quat = reference.quat[1:]
    return Trace(PERIOD, position, quat, reference.position[1:], quat, None, False)


@pytest.mark.parametrize("height", [0.9, 0.6, 0.47])
def test_the_commanded_head_goes_there_and_comes_back(squats, height):
    head = squats[height].reference.points[:, 0, 2]
    assert head.min() == pytest.approx(height, abs=0.01)
    assert head[squats[height].low] == pytest.approx(height, abs=0.01)
    assert head[0] == pytest.approx(head[-1], abs=0.005)
    # No jumps: nobody lowers the head faster than 2 m/s in these squats.
    assert np.abs(np.diff(head)).max() < 2.0 * PERIOD
    vertical = squats[height].reference.point_velocities[:, 0, 2]
    rebuilt = head[0] + np.cumsum(vertical[:-1]) * PERIOD
    assert rebuilt[-1] == pytest.approx(head[-1], abs=0.01)


@pytest.mark.parametrize("height", [0.9, 0.6, 0.47])
def test_feet_stay_and_hands_stay_above_the_ground(squats, height):
    reference = squats[height].reference
    feet = reference.position[:, ANKLES]
    assert np.linalg.norm(feet - feet[0], axis=-1).max() < 0.005
    assert reference.points[:, 1:, 2].min() >= 0.1


def test_below_the_bodys_reach_only_the_points_go_on(squats):
    assert squats[0.6].has_body
    assert not squats[0.47].has_body
    body, points = squats[0.47].reference.position, squats[0.47].reference.points
    head = body[:, g1.TORSO, 2]
    lowest = squats[0.6].reference.position[:, g1.TORSO, 2].min()
    assert head.min() == pytest.approx(lowest, abs=0.01)
    assert points[:, 0, 2].min() == pytest.approx(0.47, abs=0.01)
    # Standing, nothing is shifted.
    assert points[0] == pytest.approx(squats[0.6].reference.points[0], abs=1e-6)


def test_doing_as_told_is_success_and_reaches(squats):
    trial = judge(run_of(squats[0.6]), squats[0.6])
    assert (trial.success, trial.reached, trial.fell) == (True, True, False)
    assert trial.low_m == pytest.approx(0.6, abs=0.01)
    assert trial.metrics is not None
    assert trial.metrics.mpkpe_mm == pytest.approx(0.0, abs=1e-6)


def test_a_lazy_squat_is_no_fall_but_not_low_enough(squats):
    wanted = squats[0.9]
    lift = np.zeros(len(wanted.reference.qpos) - 1)
    lift[wanted.low.start - 1 : wanted.low.stop - 1] = TOLERANCE + 0.02
    trial = judge(run_of(wanted, lift), wanted)
    assert (trial.success, trial.reached) == (True, False)
    lift[:] = 0.0
    lift[-20:] = -(TOLERANCE + 0.02)  # it does not come up again
    trial = judge(run_of(wanted, lift), wanted)
    assert (trial.success, trial.reached) == (False, True)


def test_a_fall_on_the_way_down(squats):
    whole = run_of(squats[0.6])
    cut = Trace(
        PERIOD,
        whole.position[:80],
        whole.quat[:80],
        whole.reference_position[:80],
        whole.reference_quat[:80],
        None,
        True,
    )
    trial = judge(cut, squats[0.6])
    assert (trial.success, trial.reached, trial.fell) == (False, False, True)
    assert np.isnan(trial.low_m)
    level = SquatLevel(0.77, 0.6, (trial, judge(whole, squats[0.6])))
    data = level.to_json()
    assert (data["sr"], data["falls"], data["reached_percent"]) == (50.0, 1, 50.0)
    assert data["reached_mean_m"] == pytest.approx(0.6, abs=0.01)


def test_report_says_whether_the_deepest_squat_got_there(squats, tmp_path):
    low = SquatLevel(0.77, 0.6, (judge(run_of(squats[0.6]), squats[0.6]),))
    deep = SquatLevel(0.6, 0.47, (judge(run_of(squats[0.47]), squats[0.47]),))
    report = SquatReport((low,), (deep,))
    # The body's reference stops at 0.60 m: 13 cm above the command.
    summary = squat_summary(report)
    assert "SR 100 %" in summary
    assert "cm of that 0 %" in summary
    assert "0.47" in squat_text(report)
    page = write_squat_report(report, "intro <1>", tmp_path)
    assert "intro &lt;1&gt;" in page.read_text()
    data = json.loads((tmp_path / "metrics.json").read_text())
    assert (data["operator_m"], data["sr"], data["sr_reached"]) == (0.6, 100.0, 0.0)
    assert (tmp_path / "heights.png").read_bytes()[:4] == b"\x89PNG"


def test_operator_is_scaled_by_standing_height():
    # 1.58 m of a person of 1.70 m are the 1.23 m of the standing G1.
    assert operator_scale() == pytest.approx(1.228 / 1.58, abs=0.002)
