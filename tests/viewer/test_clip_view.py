"""The view of one clip: the human's bones stand beside the robot."""

from __future__ import annotations

import numpy as np
import pytest

from openclone.robot.model import standing_qpos
from openclone.viewer.clip_view import ClipView


def test_the_human_stands_beside_the_robot() -> None:
    qpos = np.tile(standing_qpos(), (4, 1))
    qpos[:, 0] = (0.0, 0.1, 0.2, 0.3)
    human = np.zeros((4, 3, 3))
    human[:, 1, 2], human[:, 2, 2] = 1.0, 1.7
    human[..., 0] = qpos[:, :1]
    bones = ((0, 1), (1, 2))
    with ClipView(qpos, 50.0, "a clip", human=human, bones=bones, port=8123) as view:
        assert view.url.startswith("http://127.0.0.1:")
        segments = view.bone_segments(2)
        assert segments.shape == (2, 2, 3)
        assert segments[1, 1] == pytest.approx([0.2, 1.0, 1.7])
        view.show(3)
        view.play(rounds=1)
