"""What the Python interpreter must not do in the middle of a control step."""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress

_SWITCH_INTERVAL_S = 0.0005
_OLDER_EVERY = 50
_PRIORITY = 10
"""Of SCHED_FIFO: above every ordinary thread, below the kernel's own (50)."""


@contextmanager
def realtime_priority(priority: int = _PRIORITY) -> Iterator[bool]:
    """Let the calling thread run before all ordinary ones, where the system allows it.

    Linux allows it to root and to users with an ``rtprio`` limit. Elsewhere nothing
    changes. Threads started meanwhile do not inherit the priority.

    Args:
        priority: of SCHED_FIFO; the loop has the default.

    Yields:
        Whether the priority was granted.
    """
    if not hasattr(os, "sched_setscheduler"):
        yield False
        return
    policy, parameter = os.sched_getscheduler(0), os.sched_getparam(0)
    fifo = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
    try:
        os.sched_setscheduler(0, fifo, os.sched_param(priority))
    except OSError:
        yield False
        return
    try:
        yield True
    finally:
        # Without privileges the reset flag cannot be taken back; nothing hangs on it.
        with suppress(OSError):
            os.sched_setscheduler(0, policy, parameter)


@contextmanager
def interpreter_for_control() -> Iterator[None]:
    """Keep pauses of the interpreter out of the loop.

    A full garbage collection takes tens of milliseconds once a few libraries are
    loaded, and another thread (a viewer) may keep the interpreter for 5 ms. Here the
    loop collects by itself, between ticks (`collect_garbage`), and threads take turns
    ten times as often.
    """
    interval = sys.getswitchinterval()
    was_enabled = gc.isenabled()
    gc.collect()
    gc.freeze()
    gc.disable()
    sys.setswitchinterval(_SWITCH_INTERVAL_S)
    try:
        yield
    finally:
        sys.setswitchinterval(interval)
        gc.unfreeze()
        if was_enabled:
            gc.enable()


def collect_garbage(tick: int) -> None:
    """Free young cyclic garbage; call after a tick. Takes well under a millisecond."""
    gc.collect(1 if tick % _OLDER_EVERY == 0 else 0)
