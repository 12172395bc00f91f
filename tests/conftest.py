"""What all tests share."""

from __future__ import annotations

import os
from pathlib import Path

import pytest
from hypothesis import settings

# The suite often runs beside other work on few cores: no deadlines on examples, and
# the same examples every time.
settings.register_profile("openclone", deadline=None, derandomize=True, max_examples=60)
settings.load_profile("openclone")
os.environ.setdefault("OMP_NUM_THREADS", "1")

RECORDINGS = Path(__file__).parents[2] / "shared" / "motions"


@pytest.fixture(scope="session")
def recordings() -> Path:
    """Folder of real human recordings, which lies beside the repository."""
    if not RECORDINGS.is_dir():
        pytest.skip(f"needs the recordings in {RECORDINGS}")
    return RECORDINGS
