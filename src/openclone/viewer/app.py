"""The browser view: a subscriber of the loop that never holds it up.

The loop puts ticks into a bounded queue; a thread of the view's own reads them at 30 Hz
and moves the picture. Pages are served on this machine only unless told otherwise.
"""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Callable
from types import TracebackType

import numpy as np
import viser

from openclone.errors import OpenCloneError
from openclone.robot.kinematics import Kinematics
from openclone.robot.model import CONTROL_PERIOD
from openclone.teleop.messages import (
    KeyPoints,
    LoopTick,
    OperatorRecording,
    Subscriber,
)
from openclone.teleop.operators.replay import Playback, ReplayConfig
from openclone.viewer.panels import LiveFigures, Panel
from openclone.viewer.scene import RobotScene

HOST, PORT = "127.0.0.1", 8080
_FRAME_S = 1.0 / 30.0
_PANEL_EVERY = 6
_PAUSE_S = 1.5


class TeleopView:
    """Serves the page and shows every tick it is given."""

    def __init__(self, port: int = PORT, host: str = HOST) -> None:
        """Start the server and the thread that draws.

        Raises:
            OpenCloneError: the page cannot be served on ``host``.
        """
        try:
            self._server = viser.ViserServer(host=host, port=port, verbose=False)
        except OSError as error:
            raise OpenCloneError(
                f"cannot serve the view on {host}, port {port} ({error}); "
                "choose another --port"
            ) from None
        # viser takes the next free port when this one is in use.
        self.url = f"http://{host}:{self._server.get_port()}"
        self._scene = RobotScene(self._server)
        self._panel = Panel(self._server, self._scene.options)
        self._kinematics = Kinematics()
        self._ticks: deque[LoopTick] = deque(maxlen=500)
        self._figures = LiveFigures()
        self._reference: Callable[[LoopTick], np.ndarray | None] = lambda _: None
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._work, daemon=True)
        self._thread.start()

    def __enter__(self) -> TeleopView:
        """Use as a context manager: closed at the end."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        value: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Stop serving."""
        self.close()

    def put(self, value: LoopTick, /) -> None:
        """Take one tick; returns at once. The oldest go when drawing cannot follow."""
        self._ticks.append(value)

    def show_reference(
        self,
        recording: OperatorRecording,
        qpos: np.ndarray,
        replay: ReplayConfig | None = None,
    ) -> None:
        """Show the motion that an operator means as a ghost.

        Args:
            recording: the operator; his or her time stamps place the ghost.
            qpos: (T, 36), the motion at 50 Hz in the robot's world.
            replay: how the recording is played.
        """
        playback = Playback(recording, replay or ReplayConfig())

        def at(tick: LoopTick) -> np.ndarray | None:
            if tick.operator is None:
                return None
            played_s = np.array(tick.operator.sensor_stamp_ns * 1e-9)
            frame = float(playback.recording_time(played_s)) / CONTROL_PERIOD
            return qpos[min(round(frame), len(qpos) - 1)]

        self._reference = at
        self.set_title(recording.name)

    def set_title(self, text: str) -> None:
        """Name what is shown."""
        self._panel.set_title(text)

    def show_pose(self, qpos: np.ndarray) -> None:
        """Show one pose ``(36,)`` and its key points, without a loop."""
        points, quats = self._kinematics.key_points(qpos)
        self._scene.update(qpos, None, KeyPoints(points, quats))

    def wait(self) -> None:
        """Keep serving until Ctrl-C."""
        try:
            while not self._closing.wait(0.2):
                pass
        except KeyboardInterrupt:
            return

    def close(self) -> None:
        """Stop serving."""
        self._closing.set()
        self._thread.join()
        self._server.stop()

    def _work(self) -> None:
        drawn = 0
        while not self._closing.wait(_FRAME_S):
            tick = self._take()
            if tick is None:
                continue
            self._draw(tick)
            drawn += 1
            if drawn % _PANEL_EVERY == 0:
                self._panel.refresh(self._figures)

    def _take(self) -> LoopTick | None:
        """Feed all waiting ticks to the figures and return the newest."""
        newest = None
        while self._ticks:
            newest = self._ticks.popleft()
            if newest.qpos is not None:
                points, quats = self._kinematics.key_points(newest.qpos)
                self._figures.add(newest, points, quats)
        return newest

    def _draw(self, tick: LoopTick) -> None:
        if tick.qpos is not None:
            qpos = tick.qpos
        else:
            base = (tick.base_position, tick.base_quat)
            qpos = np.concatenate((*base, tick.reading.joint_angles))
        target = tick.command.target if tick.command else None
        self._scene.update(qpos, self._reference(tick), target)


def watch_sessions(
    view: TeleopView,
    run: Callable[[Subscriber, int], object],
    *,
    rounds: int | None = None,
) -> None:
    """Run sessions one after the other until Ctrl-C.

    Args:
        view: where to show them.
        run: runs one session with a subscriber, to its end; gets its number as well.
        rounds: stop after this many.
    """
    done = 0
    try:
        while rounds is None or done < rounds:
            run(view, done)
            done += 1
            time.sleep(_PAUSE_S)
    except KeyboardInterrupt:
        return


def watch_motion(
    view: TeleopView, qpos: np.ndarray, name: str, *, rounds: int | None = None
) -> None:
    """Play a motion ``(T, 36)`` at 50 Hz without physics, until Ctrl-C."""
    view.set_title(name)
    done = 0
    try:
        while rounds is None or done < rounds:
            began = time.monotonic()
            frame = 0
            while frame < len(qpos):
                view.show_pose(qpos[frame])
                time.sleep(_FRAME_S)
                frame = int((time.monotonic() - began) / CONTROL_PERIOD)
            done += 1
    except KeyboardInterrupt:
        return
