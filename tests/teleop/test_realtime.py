"""The loop's thread may ask for priority, and always gives it back."""

from __future__ import annotations

import os
import threading

import pytest

from openclone.teleop.realtime import realtime_priority

pytestmark = pytest.mark.skipif(
    not hasattr(os, "sched_getscheduler"), reason="no POSIX scheduling here"
)


def test_priority_is_given_back() -> None:
    """After the block the thread is ordinary again."""
    with realtime_priority() as granted:
        inside = os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK
        assert (inside == os.SCHED_FIFO) == granted
    assert os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_OTHER


def test_new_threads_do_not_inherit_it() -> None:
    """The headset's and the viewer's threads must not compete with the loop."""
    seen: list[int] = []
    with realtime_priority():
        thread = threading.Thread(target=lambda: seen.append(os.sched_getscheduler(0)))
        thread.start()
        thread.join()
    assert seen == [os.SCHED_OTHER]


def test_refusal_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the privilege the loop runs as before."""

    def refuse(*_: object) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    with realtime_priority() as granted:
        assert not granted
