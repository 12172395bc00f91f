"""Operators and policies that do what a test wants."""

from __future__ import annotations

import numpy as np

from openclone.policy.bundle import Bundle, g1_info


class ConstantSession:
    """Stands in for onnxruntime: the same action whatever is observed."""

    def __init__(self, action: np.ndarray) -> None:
        self.action = action

    def run(
        self, outputs: list[str], inputs: dict[str, np.ndarray]
    ) -> list[np.ndarray]:
        count = len(inputs["observation"])
        return [np.tile(self.action.astype(np.float32), (count, 1))]


def constant_bundle(value: float = 0.0) -> Bundle:
    return Bundle(g1_info("test", "", ""), ConstantSession(np.full(29, value)))


STANDING_HUMAN = np.array([[0.0, 0.0, 1.6], [0.0, 0.22, 0.85], [0.0, -0.22, 0.85]])
ARMS_DOWN = np.array(
    [
        [1.0, 0, 0, 0],
        [np.sqrt(0.5), 0, np.sqrt(0.5), 0],
        [np.sqrt(0.5), 0, np.sqrt(0.5), 0],
    ]
)
