"""Pushes: their physics, whose fault a fall is, and the statistics."""

from __future__ import annotations

import json
from typing import Any

import mujoco
import numpy as np
import pytest

from openclone.evaluation.experiment_report import (
    push_rows,
    push_size_rows,
    push_text,
    write_push_report,
)
from openclone.evaluation.push_run import (
    WINDOW_S,
    Push,
    PushConfig,
    PushRun,
    _PushingHand,
    push_run,
)
from openclone.evaluation.pushes import (
    PushReport,
    PushResult,
    evaluate_pushes,
    operator_reference,
    share_interval,
)
from openclone.policy.bundle import Bundle, g1_info, load_bundle
from openclone.robot import g1
from openclone.robot.model import CONTROL_PERIOD
from openclone.simulation.robot import SimulatedRobot

SOON = PushConfig(shortest_s=0.0, longest_s=1e-6)
STEADY = PushConfig(shortest_s=3.2, longest_s=3.3)


class Limp(Bundle):
    """Folds its hips: falls whatever happens, long before the first push."""

    def __init__(self) -> None:
        super().__init__(g1_info("limp", "", ""), None)

    def act(self, observations: np.ndarray) -> np.ndarray:
        action = np.zeros((len(observations), g1.NUM_JOINTS))
        action[:, [0, 6]] = 1.8 / g1.ACTION_SCALE[0]
        return action


@pytest.fixture(scope="module")
def still():
    return operator_reference("stand", 12.0)


def test_a_push_changes_the_momentum_of_the_whole_body(still):
    robot = SimulatedRobot()
    hand = _PushingHand(robot, still, SOON, 0.0, np.random.default_rng(5))

    def velocity() -> np.ndarray:
        mujoco.mj_forward(robot.model, robot.data)
        mujoco.mj_subtreeVel(robot.model, robot.data)
        return robot.data.subtree_linvel[0].copy()

    before = velocity()
    state = robot.true_state()
    hand.before(round(1.9 / CONTROL_PERIOD), state)
    assert not hand.busy  # too early
    hand.before(round(2.1 / CONTROL_PERIOD), state)
    assert hand.busy
    change = velocity() - before
    assert np.abs(change[:2]).max() <= 1.5
    assert change[2] == pytest.approx(0.0, abs=1e-9)
    outcome = hand.after(round(2.2 / CONTROL_PERIOD), state, fell=True)
    assert outcome is not None
    # The robot looks along +X: its own frame is the world's.
    assert outcome.kick_h == pytest.approx(tuple(change[:2]), abs=1e-6)
    assert np.isnan(outcome.distance_m)


def test_the_outcome_is_known_three_seconds_later_or_at_the_fall(still):
    robot = SimulatedRobot()
    hand = _PushingHand(robot, still, SOON, 0.0, np.random.default_rng(5))
    state = robot.true_state()
    first = round(2.1 / CONTROL_PERIOD)
    hand.before(first, state)
    last = first + round(WINDOW_S / CONTROL_PERIOD) - 1
    outcomes = [hand.after(t, state, fell=False) for t in range(first, last + 1)]
    assert outcomes[:-1] == [None] * (len(outcomes) - 1)
    assert outcomes[-1] is not None
    assert not outcomes[-1].fell
    assert outcomes[-1].distance_m == pytest.approx(0.0, abs=0.05)


def test_a_walking_operator_is_pushed_while_walking(still):
    robot, rng = SimulatedRobot(), np.random.default_rng(0)
    walk = operator_reference("walk", 12.0)
    speed = np.linalg.norm(walk.point_velocities[:, 0, :2], axis=-1)
    assert speed.max() == pytest.approx(0.35, abs=0.03)
    hand = _PushingHand(robot, still, SOON, 0.25, rng)
    hand.before(round(2.5 / CONTROL_PERIOD), robot.true_state())
    assert not hand.busy  # the operator stands
    hand = _PushingHand(robot, walk, SOON, 0.25, rng)
    hand.before(round(4.0 / CONTROL_PERIOD), robot.true_state())
    assert hand.busy


def test_nobody_withstands_eight_metres_a_second_and_everybody_none(still):
    def run(speed: float) -> PushRun:
        rng = np.random.default_rng(2)
        config = PushConfig(speed, STEADY.shortest_s, STEADY.longest_s)
        return push_run(load_bundle(), still, 2, config, 0.0, None, rng)

    blown_over = run(8.0)
    assert [push.fell for push in blown_over.pushes] == [True, True]
    assert blown_over.other_falls == 0
    quiet = run(0.0)
    assert quiet.falls == 0
    assert len(quiet.pushes) == 2
    assert all(push.speed == 0.0 for push in quiet.pushes)


def test_falls_without_a_push_are_counted_apart_and_end_the_run(still):
    run = push_run(Limp(), still, 3, STEADY, 0.0, None, np.random.default_rng(0))
    assert run.pushes == ()
    assert run.other_falls == run.falls == 3
    report = evaluate_pushes(Limp(), count=1, conditions=("stand",), noise=None)
    data = report.to_json()
    assert (data["pushes"], data["falls_percent"]) == (0, 0.0)
    assert "later falls" in push_text(report)


def test_interval_of_a_share():
    # Wilson's interval; Brown, Cai and DasGupta (2001) and its formula by hand.
    assert share_interval(0, 20) == pytest.approx((0.0, 0.161), abs=1e-3)
    assert share_interval(5, 100) == pytest.approx((0.0215, 0.1118), abs=1e-3)
    assert share_interval(0, 0) == (0.0, 1.0)


def test_tables_and_figures(tmp_path):
    def push(speed: float, fell: bool) -> Push:
        return Push((0.0, speed), fell, float("nan") if fell else 0.1)

    pushes = (push(0.2, False), push(0.7, False), push(0.8, True), push(2.0, True))
    result = PushResult(PushRun(pushes, 1, 20.0), PushRun(pushes[:2], 0, 20.0))
    report = PushReport({"stand": result, "walk": result}, PushConfig())
    data: dict[str, Any] = report.to_json()
    assert (data["pushes"], data["falls"], data["falls_percent"]) == (8, 4, 50.0)
    stand = data["conditions"]["stand"]
    assert stand["distance_after_mm"] == pytest.approx(100.0)
    assert [row["falls"] for row in stand["by_speed"]] == [0, 1, 0, 1]
    assert push_rows(report)[0] == ("stand", "4", "2", "50", "15 - 85", "1", "0")
    assert push_size_rows(report)[1] == ("0.5 - 1.0", "1 of 2", "1 of 2")
    page = write_push_report(report, "intro", tmp_path)
    assert "target ≤ 5 %" in page.read_text()
    assert json.loads((tmp_path / "metrics.json").read_text()) == data
