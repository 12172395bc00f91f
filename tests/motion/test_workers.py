"""Worker processes end with the process that started them, however it ends."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import pytest

from openclone.motion.workers import worker_pool

SCRIPT = """
import os, sys, time
from pathlib import Path
from openclone.motion.workers import worker_pool

def linger(folder):
    (Path(folder) / f"{os.getpid()}.pid").touch()
    time.sleep(60)

if __name__ == "__main__":
    with worker_pool(2) as pool:
        list(pool.map(linger, [sys.argv[1]] * 4))
"""


def wait_for(condition: Callable[[], bool], seconds: float) -> bool:
    end = time.monotonic() + seconds
    while time.monotonic() < end:
        if condition():
            return True
        time.sleep(0.05)
    return condition()


def lives(pid: int) -> bool:
    try:
        # A process that has ended but whom nobody has asked for is a zombie.
        return " Z " not in Path(f"/proc/{pid}/stat").read_text()
    except OSError:
        return False


@pytest.mark.skipif(not Path("/proc/self/stat").is_file(), reason="needs /proc")
@pytest.mark.parametrize("ending", [signal.SIGTERM, signal.SIGKILL])
def test_workers_end_with_their_parent(tmp_path: Path, ending: int) -> None:
    script = tmp_path / "work.py"
    script.write_text(SCRIPT)
    workers: list[int] = []
    parent = subprocess.Popen([sys.executable, str(script), str(tmp_path)])
    try:
        assert wait_for(lambda: len(list(tmp_path.glob("*.pid"))) == 2, 60)
        workers = [int(path.stem) for path in tmp_path.glob("*.pid")]
        assert all(lives(pid) for pid in workers)
        parent.send_signal(ending)
        assert parent.wait(20) == -ending
        assert wait_for(lambda: not any(lives(pid) for pid in workers), 10)
    finally:
        parent.kill()
        for pid in filter(lives, workers):
            os.kill(pid, signal.SIGKILL)


def test_workers_are_single_threaded(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("OMP_NUM_THREADS", "7")
    monkeypatch.delenv("MKL_NUM_THREADS", raising=False)
    with worker_pool(1) as pool:
        assert pool.submit(os.getenv, "OMP_NUM_THREADS").result() == "1"
    assert os.environ["OMP_NUM_THREADS"] == "7"
    assert "MKL_NUM_THREADS" not in os.environ
