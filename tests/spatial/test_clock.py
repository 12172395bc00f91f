import time

from openclone.spatial.clock import ManualClock, MonotonicClock, Ticker

PERIOD = 20_000_000


def test_deadlines_are_absolute_so_late_work_does_not_add_up() -> None:
    clock = ManualClock(1_000)
    ticker = Ticker(clock, PERIOD)
    for index in range(50):
        wake = ticker.wait()
        assert wake.index == index
        assert wake.deadline_ns == 1_000 + index * PERIOD
        clock.advance(7_000_000 + 100_000 * index)  # up to 12 ms of work
    assert ticker.overruns == 0


def test_missed_deadlines_are_counted_and_skipped() -> None:
    clock = ManualClock()
    ticker = Ticker(clock, PERIOD)
    ticker.wait()
    clock.advance(3 * PERIOD + 5_000_000)  # misses the deadlines at 1, 2, 3 periods
    wake = ticker.wait()
    assert ticker.overruns == 3
    assert wake.deadline_ns == 3 * PERIOD
    assert wake.now_ns == 3 * PERIOD + 5_000_000
    assert ticker.wait().deadline_ns == 4 * PERIOD


def test_work_of_exactly_a_period_is_no_overrun() -> None:
    clock = ManualClock()
    ticker = Ticker(clock, PERIOD)
    for _ in range(10):
        ticker.wait()
        clock.advance(PERIOD)
    assert ticker.overruns == 0


def test_the_manual_clock_never_goes_back() -> None:
    clock = ManualClock(100)
    clock.sleep_until(50)
    assert clock.now_ns() == 100
    clock.sleep_until(150)
    assert clock.now_ns() == 150


def test_real_time_wakes_after_the_deadline_and_keeps_the_rate() -> None:
    clock = MonotonicClock()
    ticker = Ticker(clock, 2_000_000)
    began = time.monotonic_ns()
    wakes = [ticker.wait() for _ in range(50)]
    assert all(wake.now_ns >= wake.deadline_ns for wake in wakes)
    # 49 periods of 2 ms, however busy the machine was; overruns only skip ahead.
    passed = wakes[-1].deadline_ns - wakes[0].deadline_ns
    assert passed % 2_000_000 == 0
    assert 49 <= passed // 2_000_000 <= 49 + ticker.overruns
    assert time.monotonic_ns() - began >= passed
