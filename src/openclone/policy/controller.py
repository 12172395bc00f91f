"""The student as a controller: command and sensors in, joint targets out, at 50 Hz."""

from __future__ import annotations

import numpy as np

from openclone.policy import observation
from openclone.policy.bundle import Bundle
from openclone.policy.command import Command, KeyPoints
from openclone.policy.observation import History, Proprioception
from openclone.robot import g1
from openclone.spatial import rotations


class StudentController:
    """Keeps the history and the last action of one robot."""

    def __init__(self, bundle: Bundle) -> None:
        """Start with an empty history."""
        self._bundle = bundle
        self._default = np.array(bundle.info.default_pose)
        self._scale = np.array(bundle.info.action_scale)
        self.reset()

    def reset(self) -> None:
        """Forget the past; the next frame fills the history."""
        self._history: History | None = None
        self.action = np.zeros(g1.NUM_JOINTS)

    def observe(
        self, command: Command, now: Proprioception, measured: KeyPoints
    ) -> np.ndarray:
        """The student's input, ``(observation_size,)``; call once per control step.

        Args:
            command: head and hand targets for the next step, world.
            now: joint and IMU readings; ``base_quat`` must carry the heading.
            measured: head and hands from odometry and kinematics, world.
        """
        frame = observation.frame(now, self.action, self._default)
        if self._history is None:
            self._history = History(frame, self._bundle.info.history)
        else:
            self._history.push(frame)
        task = observation.task(command, measured, rotations.heading(now.base_quat))
        return observation.student(task, self._history)

    def step(
        self, command: Command, now: Proprioception, measured: KeyPoints
    ) -> np.ndarray:
        """Joint targets ``(29,)`` in radians for the next control step."""
        inputs = self.observe(command, now, measured)
        self.action = self._bundle.act(inputs[None])[0].astype(np.float64)
        return self._default + self._scale * self.action
