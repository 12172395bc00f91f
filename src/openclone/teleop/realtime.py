"""What the Python interpreter must not do in the middle of a control step."""

from __future__ import annotations

import gc
import sys
from collections.abc import Iterator
from contextlib import contextmanager

_SWITCH_INTERVAL_S = 0.0005
_OLDER_EVERY = 50


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
