from __future__ import annotations

import numpy as np
import pytest
from teleop_fakes import ARMS_DOWN, STANDING_HUMAN, constant_bundle

from openclone.policy.bundle import Bundle
from openclone.teleop.messages import OperatorRecording, recording_at_rate


@pytest.fixture
def bundle() -> Bundle:
    return constant_bundle()


@pytest.fixture
def walking() -> OperatorRecording:
    """Three seconds straight ahead at 0.5 m/s."""
    ahead = np.arange(300)[:, None, None] / 100 * np.array([0.5, 0.0, 0.0])
    positions = STANDING_HUMAN + ahead
    return recording_at_rate("walk", 100.0, positions, np.tile(ARMS_DOWN, (300, 1, 1)))
