"""A clip in the browser: the robot, and beside it the human it was retargeted from."""

from __future__ import annotations

import threading
import time
from types import TracebackType

import numpy as np
import viser

from openclone.errors import OpenCloneError
from openclone.viewer.app import HOST, PORT
from openclone.viewer.scene import RobotScene

_FRAME_S = 1.0 / 30.0
_BONE_COLOUR = (60, 90, 140)
_ASIDE = 1.0
"""Metres to the robot's left where the human goes, so that both are seen whole."""


class ClipView:
    """Serves one clip with play, pause and a slider over its frames."""

    def __init__(
        self,
        qpos: np.ndarray,
        fps: float,
        title: str,
        *,
        human: np.ndarray | None = None,
        bones: tuple[tuple[int, int], ...] = (),
        port: int = PORT,
        host: str = HOST,
    ) -> None:
        """Start the server.

        Args:
            qpos: (T, 36), the motion.
            fps: its rate.
            title: markdown shown above the controls.
            human: (T, J, 3), metres, the joints of the human in the clip's world.
            bones: pairs of joints that are connected.
            port: the next free one is taken if it is in use.
            host: the machine's address that serves.

        Raises:
            OpenCloneError: the page cannot be served.
        """
        self._qpos, self._fps, self._bones = qpos, fps, np.array(bones, dtype=int)
        self._human = human
        try:
            self._server = viser.ViserServer(host=host, port=port, verbose=False)
        except OSError as error:
            raise OpenCloneError(
                f"cannot serve the view on {host}, port {port} ({error}); "
                "choose another --port"
            ) from None
        self.url = f"http://{host}:{self._server.get_port()}"
        self._scene = RobotScene(self._server)
        self._skeleton = None if human is None else self._add_skeleton()
        self._server.gui.add_markdown(title)
        self._playing = self._server.gui.add_checkbox("Play", True)
        self._speed = self._server.gui.add_slider("Speed", 0.1, 2.0, 0.1, 1.0)
        self._slider = self._server.gui.add_slider("Frame", 0, len(qpos) - 1, 1, 0)
        self._closing = threading.Event()

    def __enter__(self) -> ClipView:
        """Use as a context manager: closed at the end."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Stop serving."""
        self._closing.set()
        self._server.stop()

    def _add_skeleton(self) -> viser.LineSegmentsHandle:
        return self._server.scene.add_line_segments(
            "/human",
            np.zeros((len(self._bones), 2, 3), dtype=np.float32),
            _BONE_COLOUR,
            thickness=0.03,
        )

    def bone_segments(self, frame: int) -> np.ndarray:
        """(bones, 2, 3), metres, world: the human's bones, put to the robot's left."""
        assert self._human is not None
        joints = self._human[frame] + np.array([0.0, _ASIDE, 0.0])
        return joints[self._bones]

    def show(self, frame: int) -> None:
        """Show one frame."""
        self._scene.update(self._qpos[frame], None, None)
        if self._skeleton is not None:
            segments = self.bone_segments(frame) - self._scene.centre
            self._skeleton.points = segments.astype(np.float32)

    def play(self, rounds: int | None = None) -> None:
        """Play until Ctrl-C, or ``rounds`` times."""
        frame, done = 0.0, 0
        try:
            while not self._closing.is_set() and (rounds is None or done < rounds):
                if self._playing.value:
                    frame += _FRAME_S * self._fps * self._speed.value
                    if frame > len(self._qpos) - 1:
                        frame, done = 0.0, done + 1
                    self._slider.value = int(frame)
                else:
                    frame = float(self._slider.value)
                self.show(int(frame))
                time.sleep(_FRAME_S)
        except KeyboardInterrupt:
            return
