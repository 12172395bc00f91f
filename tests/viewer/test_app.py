"""The browser view: figures, picture, and that it never holds up the loop."""

from __future__ import annotations

import socket
import time
import urllib.request
from dataclasses import replace

import numpy as np
import pytest

from openclone.policy.command import Command, KeyPoints
from openclone.robot.kinematics import Kinematics
from openclone.robot.model import standing_qpos
from openclone.simulation.robot import SimulatedRobot
from openclone.teleop.messages import (
    LoopTick,
    OperatorFrame,
    Phase,
    TickDurations,
    recording_at_rate,
)
from openclone.teleop.operators.replay import ReplayConfig
from openclone.viewer.app import TeleopView, watch_motion, watch_sessions
from openclone.viewer.panels import LiveFigures


@pytest.fixture(scope="module")
def view():
    with TeleopView(port=18_080) as running:
        yield running


@pytest.fixture(scope="module")
def points() -> KeyPoints:
    return KeyPoints(*Kinematics().key_points(standing_qpos()))


@pytest.fixture
def tick(points) -> LoopTick:
    """A robot that stands 3 cm behind its targets."""
    target = KeyPoints(points.position + np.array([0.03, 0, 0]), points.quat)
    frame = OperatorFrame(0, 0, points.position, points.quat, np.ones(3, dtype=bool))
    return LoopTick(
        index=7,
        stamp_ns=0,
        phase=Phase.ACTIVE,
        trigger="",
        operator=frame,
        command=Command(target, np.zeros((3, 3))),
        measured=points,
        reading=SimulatedRobot().reading(),
        base_position=standing_qpos()[:3],
        base_quat=standing_qpos()[3:7],
        action=np.zeros(29),
        targets=np.zeros(29),
        qpos=standing_qpos(),
        qvel=np.zeros(35),
        fallen=False,
        durations=TickDurations(0, 0, 0, 2_000_000),
        overruns=2,
    )


def wait_for(condition, seconds: float = 20.0) -> bool:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.05)
    return False


def test_figures_compare_with_the_command_of_the_tick_before(tick, points):
    figures = LiveFigures()
    assert "waiting" in figures.html()
    figures.add(tick, points.position, points.quat)
    assert len(figures.errors_mm()) == 0  # nothing was commanded for this instant
    figures.add(replace(tick, index=8), points.position, points.quat)
    assert figures.errors_mm() == pytest.approx(np.full((1, 3), 30.0))
    page = figures.html()
    for text in ("ACTIVE", "30.0 mm", "2.00 / 2.00 ms", "2 of 9"):
        assert text in page


def test_a_fall_counts_once(tick, points):
    figures = LiveFigures()
    for fallen in (False, True, True, False, True):
        figures.add(replace(tick, fallen=fallen), points.position, points.quat)
    assert figures.falls == 2


def test_page_is_served_on_this_machine_only(view):
    assert view.url.startswith("http://127.0.0.1:")
    with urllib.request.urlopen(view.url, timeout=10) as answer:
        assert answer.status == 200
    port = int(view.url.rsplit(":", 1)[1])
    probe = socket.socket()
    probe.settimeout(1.0)
    own = socket.gethostbyname(socket.gethostname())
    if not own.startswith("127."):
        with pytest.raises(OSError, match=r"refused|timed out"):
            probe.connect((own, port))
    probe.close()


def test_taking_ticks_never_waits(view, tick):
    began = time.perf_counter()
    for index in range(5000):
        view.put(replace(tick, index=index))
    assert (time.perf_counter() - began) / 5000 < 1e-3
    assert wait_for(lambda: "of 5000" in view._figures.html())


def test_robot_ghost_and_targets_stand_where_they_should(view, tick, points):
    reference = np.tile(standing_qpos(), (100, 1))
    reference[:, 1] = np.arange(100) * 0.01
    recording = recording_at_rate(
        "someone",
        50.0,
        np.tile(points.position, (100, 1, 1)),
        np.tile(points.quat, (100, 1, 1)),
    )
    replay = ReplayConfig(lead_in_s=1.0, ease_s=0.0)
    view.show_reference(recording, reference, replay)
    assert tick.operator is not None
    stamp_ns = round(1.4e9)  # 0.4 s into the recording: the reference is at y = 0.2
    view.put(replace(tick, operator=replace(tick.operator, sensor_stamp_ns=stamp_ns)))
    ghost = view._scene._ghost[1]
    assert wait_for(lambda: abs(ghost.position[1] - 0.2) < 1e-6)
    assert ghost.position[2] == pytest.approx(standing_qpos()[2])
    head = view._scene._targets[0]
    assert head.position == pytest.approx(points.position[0] + [0.03, 0, 0], abs=1e-6)
    assert head.visible
    view._scene.options.targets = view._scene.options.ghost = False
    view.put(tick)
    assert wait_for(lambda: not head.visible and not view._scene._ghost_root.visible)
    view._scene.options.targets = view._scene.options.ghost = True


def test_picture_follows_the_robot_without_leaving_the_floor(view):
    far = standing_qpos()
    far[:2] = (5.0, -3.0)
    for _ in range(60):
        view.show_pose(far)
    assert view._scene._floor.position == pytest.approx((-5.0, 3.0, 0.0), abs=0.01)
    view._scene.options.follow = False
    for _ in range(60):
        view.show_pose(far)
    assert view._scene._floor.position == pytest.approx((0.0, 0.0, 0.0), abs=0.01)
    view._scene.options.follow = True


def test_motions_and_sessions_are_played_in_rounds(view, tick):
    watch_motion(view, np.tile(standing_qpos(), (6, 1)), "a motion", rounds=2)
    numbers: list[int] = []

    def run(subscriber, number: int) -> None:
        subscriber.put(tick)
        numbers.append(number)

    watch_sessions(view, run, rounds=2)
    assert numbers == [0, 1]


def test_ctrl_c_ends_the_watching(view):
    def interrupt(subscriber, number: int) -> None:
        raise KeyboardInterrupt

    watch_sessions(view, interrupt)
