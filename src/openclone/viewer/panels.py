"""The panel beside the picture: live figures, an error plot and switches."""

from __future__ import annotations

from collections import deque

import numpy as np
import viser
from viser import uplot

from openclone.robot import g1
from openclone.robot.model import CONTROL_PERIOD
from openclone.spatial import rotations
from openclone.teleop.messages import LoopTick, Phase
from openclone.viewer.scene import SceneOptions

_WINDOW_S = 10.0
_PLOT_POINTS = 150
_COLOURS = ("#f28c1a", "#33bf4d", "#cc4099")
_PHASE_COLOURS = {
    Phase.ACTIVE: "#1a7f37",
    Phase.RAMP: "#9a6700",
    Phase.HOLD: "#9a6700",
    Phase.DAMPING: "#d1242f",
}


class LiveFigures:
    """Figures over the last ten seconds of ticks."""

    def __init__(self) -> None:
        """Start without ticks."""
        window = round(_WINDOW_S / CONTROL_PERIOD)
        self._durations_ns: deque[int] = deque(maxlen=window)
        self._point_errors: deque[np.ndarray] = deque(maxlen=window)
        self._hand_errors: deque[float] = deque(maxlen=window)
        self.falls = 0
        self._was_fallen = False
        self._last: LoopTick | None = None

    def add(self, tick: LoopTick, points: np.ndarray, quats: np.ndarray) -> None:
        """Take one tick.

        Args:
            tick: as the loop published it.
            points: (3, 3), metres, where head and hands truly are.
            quats: (3, 4), wxyz, their true orientations.
        """
        before, self._last = self._last, tick
        self._durations_ns.append(tick.durations.total_ns)
        self.falls += tick.fallen and not self._was_fallen
        self._was_fallen = tick.fallen
        # The last command was meant for now.
        command = before.command if before else None
        if command is None:
            return
        error = np.linalg.norm(command.target.position - points, axis=1)
        self._point_errors.append(error)
        dots = (command.target.quat[1:] * quats[1:]).sum(axis=1)
        self._hand_errors.append(float(1.0 - (dots**2).mean()))

    def errors_mm(self) -> np.ndarray:
        """(n, 3), millimetres: distance of head, left and right hand from targets."""
        return 1000.0 * np.array(list(self._point_errors)).reshape(-1, 3)

    def html(self) -> str:
        """The figures as a table."""
        tick = self._last
        if tick is None:
            return "<p>waiting for the control loop ...</p>"
        milliseconds = np.array(list(self._durations_ns)) * 1e-6
        errors = self.errors_mm()
        colour = _PHASE_COLOURS.get(tick.phase, "#59636e")
        rows = [
            (
                "phase",
                f'<b style="color:{colour}">{tick.phase.name}</b> {tick.trigger}',
            ),
            ("head error", _mean_mm(errors[:, :1])),
            ("hand errors", _mean_mm(errors[:, 1:])),
            ("E_hand x 100", _mean(np.array(list(self._hand_errors)) * 100)),
            ("tick p50 / p99", _percentiles(milliseconds)),
            ("missed deadlines", f"{tick.overruns} of {tick.index + 1}"),
            ("falls", f"{self.falls}"),
        ]
        if tick.qpos is not None:
            yaw_deg = float(np.degrees(rotations.yaw(tick.qpos[3:7])))
            x, y, height = tick.qpos[:3]
            rows.append(("place", f"{x:.2f}, {y:.2f} m, {yaw_deg:.0f}°"))
            rows.append(
                ("pelvis height", f"{height:.2f} of {g1.STANDING_HEIGHT:.2f} m")
            )
        cells = "".join(
            f'<tr><td style="color:#59636e;padding-right:1em">{name}</td>'
            f"<td>{value}</td></tr>"
            for name, value in rows
        )
        return f'<table style="font-size:0.85em;margin:0.4em 1em">{cells}</table>'


class Panel:
    """The controls of the page."""

    def __init__(self, server: viser.ViserServer, options: SceneOptions) -> None:
        """Build the panel; its switches write to ``options``."""
        server.gui.configure_theme(show_logo=False, show_share_button=False)
        server.gui.set_panel_label("OpenClone")
        self._title = server.gui.add_markdown("")
        self._figures = server.gui.add_html("")
        empty = np.zeros(1)
        series = [
            uplot.Series(label=label, stroke=colour, width=1.5)
            for label, colour in zip(("head", "left", "right"), _COLOURS, strict=True)
        ]
        self._plot = server.gui.add_uplot(
            (empty, empty, empty, empty),
            (uplot.Series(label="s"), *series),
            title="distance from target, mm",
            scales={"x": uplot.Scale(time=False)},
            aspect=1.7,
            visible=False,  # until there is something to plot
        )
        for name, label in (
            ("ghost", "reference (ghost)"),
            ("targets", "targets"),
            ("follow", "follow the robot"),
        ):
            self._add_switch(server, options, name, label)

    @staticmethod
    def _add_switch(
        server: viser.ViserServer, options: SceneOptions, name: str, label: str
    ) -> None:
        box = server.gui.add_checkbox(label, initial_value=getattr(options, name))

        @box.on_update
        def _(_: object) -> None:
            setattr(options, name, box.value)

    def set_title(self, text: str) -> None:
        """Name what is shown (plain text)."""
        self._title.content = f"**{text}**"

    def refresh(self, figures: LiveFigures) -> None:
        """Show the newest figures; a few times a second is enough."""
        self._figures.content = figures.html()
        errors = figures.errors_mm()
        if len(errors) < 2:
            return
        step = max(1, len(errors) // _PLOT_POINTS)
        kept = errors[::-1][::step][::-1]
        ago = np.arange(len(kept), dtype=np.float64) - len(kept) + 1
        time_s = ago * (step * CONTROL_PERIOD)
        self._plot.visible = True
        self._plot.data = (time_s, *kept.T.copy())


def _mean(values: np.ndarray, unit: str = "") -> str:
    return f"{values.mean():.1f}{unit}" if len(values) else "-"


def _mean_mm(errors: np.ndarray) -> str:
    return _mean(errors, " mm")


def _percentiles(milliseconds: np.ndarray) -> str:
    p50, p99 = np.percentile(milliseconds, (50, 99))
    return f"{p50:.2f} / {p99:.2f} ms"
