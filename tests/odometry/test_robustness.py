"""Faults of sensors and streams: FAST-LIO2 recovers or says that it is lost.

"Never a confident wrong pose": while `health` says tracking, the error stays below
5 cm and 1 degree; a fault may go unnoticed for 0.3 s.
"""

from dataclasses import replace

import box_room
import numpy as np
import pytest
from driving import Drive, drive

FAULT = 2.8
"""Seconds; the walk is at full speed by then."""
LATE = 0.3
"""Seconds that a fault may go unnoticed."""
WRONG_M, WRONG_DEG = 0.05, 1.0


@pytest.fixture(scope="module")
def world() -> box_room.World:
    return box_room.World(
        box_room.walking(turn_rate=0.6),
        box_room.furnished(),
        box_room.Sensors(points=4000),
        np.random.default_rng(1),
    )


@pytest.fixture(scope="module")
def events(world: box_room.World) -> list[box_room.Event]:
    return box_room.stream(world, 4.5)


def assert_never_sure_and_wrong(run: Drive, fault: float = np.inf) -> None:
    metres, degrees = run.worst_tracked(without=(fault, fault + LATE))
    assert metres < WRONG_M
    assert degrees < WRONG_DEG


def late_lidar(
    events: list[box_room.Event], offset: float, begin: float
) -> list[box_room.Event]:
    """Scans that come after ``begin`` are stamped too late by ``offset`` seconds."""
    return [
        event
        if event.stamps is None or event.time < begin
        else replace(event, stamps=event.stamps + round(offset * 1e9))
        for event in events
    ]


def test_undisturbed(world, events) -> None:
    run = drive(events, world)
    metres, degrees = run.worst_tracked()
    assert metres < 0.02
    assert degrees < 0.6
    assert run.share_lost(1.3, 4.5) == 0.0


def test_dropped_scans(world, events) -> None:
    rng = np.random.default_rng(3)
    kept = [
        event
        for event in events
        if event.points is None or event.time < 1.2 or rng.random() > 0.2
    ]
    assert len(kept) < len(events) - 3
    run = drive(kept, world)
    assert_never_sure_and_wrong(run)
    assert run.well_at_the_end()


def test_gap_of_the_imu(world, events) -> None:
    def missing(event: box_room.Event) -> bool:
        return event.points is None and FAULT < event.time < FAULT + 0.2

    run = drive([event for event in events if not missing(event)], world)
    assert_never_sure_and_wrong(run)
    assert run.first_lost(FAULT) <= LATE
    assert run.well_at_the_end()
    assert run.lio.health().imu_gaps == 1


@pytest.mark.parametrize("since", [0.0, 1.15])
@pytest.mark.parametrize("offset", [0.05, -0.05])
def test_clock_offset(world, events, offset: float, since: float) -> None:
    """From the start, or from a jump at rest, which shows when the sensor moves.

    The offset is found; poses are on the IMU's clock.
    """
    run = drive(late_lidar(events, offset, since), world)
    assert_never_sure_and_wrong(run)
    found = run.lio.health().clock_offset_ns * 1e-9
    assert found == pytest.approx(-offset, abs=0.006)
    assert run.well_at_the_end()


@pytest.mark.parametrize("offset", [0.05, -0.05])
def test_clock_that_jumps_while_walking(world, events, offset: float) -> None:
    run = drive(late_lidar(events, offset, FAULT), world)
    assert_never_sure_and_wrong(run, FAULT)
    assert run.first_lost(FAULT) <= LATE
    assert run.well_at_the_end()


@pytest.mark.parametrize(
    ("offset", "seed"), [(0.05, 2), (-0.05, 3), (0.15, 4), (-0.15, 5)]
)
def test_clock_that_jumps_while_turning_evenly(offset: float, seed: int) -> None:
    """At 2 rad/s, 50 ms are 5.7 degrees; only the jump itself shows, nothing later."""
    world = box_room.World(
        box_room.spinning(2.0),
        box_room.furnished(),
        box_room.Sensors(points=4000),
        np.random.default_rng(seed),
    )
    fault = 3.8
    run = drive(late_lidar(box_room.stream(world, 5.5), offset, fault), world)
    assert_never_sure_and_wrong(run, fault)
    assert run.first_lost(fault) <= LATE
    found = run.lio.health().clock_offset_ns * 1e-9
    assert found == pytest.approx(-offset, abs=0.006)
    assert run.well_at_the_end()


def test_rotating_at_two_rad_per_second() -> None:
    world = box_room.World(
        box_room.spinning(2.0),
        box_room.furnished(),
        box_room.Sensors(points=4000),
        np.random.default_rng(2),
    )
    run = drive(box_room.stream(world, 5.0), world)
    metres, degrees = run.worst_tracked()
    assert run.share_lost(1.3, 5.0) == 0.0
    assert metres < 0.02
    assert degrees < 0.8


def test_starting_while_moving(world) -> None:
    """The walk backwards in time: it begins in motion and ends with 1.2 s of rest."""
    forward, total = world.motion, 4.6
    motion = box_room.Motion(
        lambda t: forward.position(total - np.asarray(t)),
        lambda t: forward.angles(total - np.asarray(t)),
    )
    backwards = box_room.World(
        motion, world.room, world.sensors, np.random.default_rng(4)
    )
    run = drive(box_room.stream(backwards, total), backwards)
    moving = np.array(run.times) < total - box_room.STILL
    assert not np.array(run.tracking)[moving].any()
    assert any("still" in reason for reason in run.reasons)
    # The last swaying before the rest may be part of the still second, so its first
    # pose, which defines the world, is not exactly the pose at rest.
    assert_never_sure_and_wrong(run)
    assert run.tracking[-1]


def test_a_scan_of_zeros(world, events) -> None:
    empty = [
        replace(event, points=np.zeros_like(event.points))
        if event.points is not None and abs(event.time - FAULT) < 0.05
        else event
        for event in events
    ]
    run = drive(empty, world)
    assert run.lio.health().skipped_scans == 1
    assert_never_sure_and_wrong(run)
    assert run.well_at_the_end()


def test_a_covered_lidar_is_reported_and_uncovering_it_recovers(world, events) -> None:
    covered = [
        replace(event, points=np.zeros_like(event.points))
        if event.points is not None and FAULT <= event.time < FAULT + 0.7
        else event
        for event in events
    ]
    run = drive(covered, world)
    assert run.first_lost(FAULT) <= LATE
    assert run.share_lost(FAULT + LATE, FAULT + 0.65) == 1.0
    assert_never_sure_and_wrong(run)
    assert run.well_at_the_end()


def test_nan_points(world, events) -> None:
    rng = np.random.default_rng(5)

    def spoil(points: np.ndarray) -> np.ndarray:
        out = points.copy()
        out[rng.random(len(out)) < 0.3] = np.nan
        out[rng.random(len(out)) < 0.05] = np.inf
        return out

    spoiled = [
        event if event.points is None else replace(event, points=spoil(event.points))
        for event in events
    ]
    run = drive(spoiled, world)
    metres, degrees = run.worst_tracked()
    assert metres < 0.02
    assert degrees < 0.6
    assert run.lio.health().dropped_points > 10_000


def test_duplicate_and_backward_stamps_change_nothing(world, events) -> None:
    disturbed, added = [], 0
    scans = [event for event in events if event.points is not None]
    for k, event in enumerate(events):
        disturbed.append(event)
        if k > 300 and k % 37 == 0:
            disturbed.append(event)
            disturbed.append(events[k - 7])
            added += 2
        if event.points is not None and event.time > 2.0:
            disturbed.append(scans[5])
            added += 1
    run, plain = drive(disturbed, world), drive(events, world)
    assert run.refused == run.lio.health().refused == added
    assert run.lio.health().restarts == 0
    assert_never_sure_and_wrong(run)
    assert run.share_lost(1.3, 4.5) == 0.0
    last_ns = round(events[-1].time * 1e9)
    np.testing.assert_array_equal(
        run.lio.pose_at(last_ns)[0], plain.lio.pose_at(last_ns)[0]
    )


def test_a_wild_stamp_does_not_poison_the_stream(world, events) -> None:
    """Single samples and scans stamped days ahead or at zero are left out."""
    disturbed = []
    for k, event in enumerate(events):
        disturbed.append(event)
        if k == 600:
            disturbed.append(replace(events[0], time=1e6))
            disturbed.append(replace(events[0], time=-1e6))
        if k > 600 and event.stamps is not None:
            disturbed.append(replace(event, stamps=event.stamps + 10**15))
    run, plain = drive(disturbed, world), drive(events, world)
    assert run.refused > 10
    assert run.errors[-1] == plain.errors[-1]
    assert_never_sure_and_wrong(run)
    assert run.well_at_the_end()
