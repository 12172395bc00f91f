"""The streams that `odometry.py` runs on, recorded to files once.

``box``: a sensor on an analytic path through a room of boxes (`room_stream.py`), ideal
but for noise. ``room``, ``hall`` and the other worlds of the simulator: the simulated
robot walks there by the packaged policy, and its head is shaken by its footfalls; what
`openclone odometry simulate` writes.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable
from pathlib import Path

from openclone.odometry.recording import SensorRecorder, read_samples
from openclone.odometry.samples import SensorSample
from room_stream import RoomStreamConfig, room_stream

BOX = "box"
WALKS = ("room", "hall", "corridor", "glass", "people")


def record(name: str, path: Path, seconds: float, seed: int) -> None:
    """Write the stream ``name`` of ``seconds`` to ``path``, an MCAP file."""
    if name == BOX:
        with SensorRecorder(path) as recorder:
            for sample in room_stream(RoomStreamConfig(seconds=seconds, seed=seed)):
                recorder.write(sample)
        return
    # The policy and the physics are not needed where the box room is enough.
    from openclone.evaluation.sensor_recording import STILL_S, record_walk
    from openclone.policy.bundle import load_bundle

    walk = record_walk(
        path, load_bundle(None), world=name, seconds=seconds - STILL_S, seed=seed
    )
    if walk.fell:
        print(f"{name}: the robot fell; the stream goes on", file=sys.stderr)


def read(path: Path) -> Iterable[SensorSample]:
    """The samples of a recording."""
    return read_samples(path, say=lambda text: None)
