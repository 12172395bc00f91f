"""Commands that run the robot: demo, teleop, view."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from openclone.cli.options import positive, print_figures, write_figures
from openclone.cli.performance import Performance, load_performance, measure_session
from openclone.errors import InputError

if TYPE_CHECKING:
    from openclone.evaluation.tracking import TrackingReport
    from openclone.teleop.messages import Subscriber
    from openclone.teleop.session import SessionResult
    from openclone.viewer.app import TeleopView


@contextmanager
def _view(port: int | None) -> Iterator[TeleopView | None]:
    """Serve the browser view on ``port``; nothing if that is None."""
    if port is None:
        yield None
        return
    from openclone.viewer.app import TeleopView

    with TeleopView(port) as page:
        print(f"browser view: {page.url}", flush=True)
        yield page


def _announce(page: TeleopView, performance: Performance) -> None:
    """Tell the view what the operator means, if that is known."""
    if performance.reference is None:
        page.set_title(performance.recording.name)
        return
    replay = performance.config.replay
    page.show_reference(performance.recording, performance.reference, replay)


def teleop(
    *,
    operator: Literal["replay"] = "replay",
    recording: Path,
    policy: Path | None = None,
    seconds: float | None = None,
    realtime: bool = True,
    odometry: Literal["ground-truth", "lio", "rko"] = "ground-truth",
    world: Literal["flat", "room", "corridor", "hall", "glass", "people"] | None = None,
    noise: bool = True,
    look: bool = False,
    seed: int = 0,
    json: Path | None = None,
    record: Path | None = None,
    view: bool = False,
    port: int = 8080,
) -> None:
    """Let an operator drive the simulated G1, closed loop at 50 Hz.

    Args:
        operator: where head and wrists come from.
        recording: human recording (.bvh, .amc, DeepMimic .txt) or clip (.npz).
        policy: policy bundle; the packaged student by default.
        seconds: length of the run; by default until the recording ends.
        realtime: keep real time; otherwise as fast as possible and reproducible.
        odometry: the simulator's truth, FAST-LIO2 (lio) or rko_lio (rko).
        world: where the robot is; by default flat ground, with a LiDAR the room.
        noise: add the odometry error of Eq. 2 to the truth.
        look: the robot turns as the operator's head does; else one looks freely.
        seed: of the odometry error, or of the simulated sensors.
        json: write the measurements to this file.
        record: write every tick to this .npz file.
        view: serve the browser view meanwhile.
        port: of the browser view.
    """
    from openclone.odometry.noise import OdometryNoiseConfig
    from openclone.policy.bundle import load_bundle
    from openclone.teleop.session import run_teleop

    positive("--seconds", seconds)
    bundle = load_bundle(policy)
    performance = load_performance(recording, seconds, look)
    with _view(port if view else None) as page:
        if page is not None:
            _announce(page, performance)
        result = run_teleop(
            performance.recording,
            bundle,
            seconds=seconds,
            realtime=realtime,
            subscribers=() if page is None else (page,),
            noise=OdometryNoiseConfig() if noise else None,
            seed=seed,
            config=performance.config,
            world=world or ("flat" if odometry == "ground-truth" else "room"),
            odometry=odometry,
        )
    figures = _session_figures(result, measure_session(performance, result), odometry)
    write_figures(json, {"operator": operator, **figures})
    _save(result, record)


def _save(result: SessionResult, path: Path | None) -> None:
    """Write every tick of the session, if wanted."""
    from openclone.teleop.recorder import save_log

    if path is not None:
        save_log(result.log, path)
        print(f"recorded: {path}")


def _session_figures(
    result: SessionResult, report: TrackingReport | None, odometry: str
) -> dict[str, object]:
    """Print what a session achieved, and return it for a JSON file."""
    from openclone.evaluation.report import COLUMNS, table_row

    loop = asdict(result.stats)
    print_figures(loop)
    figures: dict[str, object] = {"loop": loop}
    if report is not None:
        print_figures(dict(zip(COLUMNS, table_row(report.overall), strict=True)))
        figures |= report.to_json()
    if odometry != "ground-truth":
        figures["odometry"] = _odometry_figures(result, odometry)
    return figures


def _odometry_figures(result: SessionResult, name: str) -> dict[str, object]:
    """Print what the LiDAR odometry achieved, and return it."""
    from openclone.evaluation.odometry import pose_errors

    distance_mm, heading_deg = pose_errors(result.log)
    figures: dict[str, object] = {
        "name": name,
        "mean_mm": float(distance_mm.mean()),
        "max_mm": float(distance_mm.max()),
        "heading_max_deg": float(heading_deg.max()),
        **asdict(result.odometry_cost),
    }
    print_figures(figures)
    return figures


def demo(
    *, out: Path = Path("reports/demo"), view: bool = False, port: int = 8080
) -> None:
    """Drive the simulated G1 with synthetic operators and write a report folder.

    Args:
        out: folder for report.html, video.mp4 and a picture.
        view: also serve the browser view, until Ctrl-C.
        port: of the browser view.
    """
    from openclone.evaluation.demo import run_demo

    with _view(port if view else None) as page:
        run_demo(out, page)
        if page is not None:
            print(f"the last pose stays at {page.url}; Ctrl-C ends")
            page.wait()


def view(
    *,
    recording: Path | None = None,
    motion: Path | None = None,
    policy: Path | None = None,
    port: int = 8080,
) -> None:
    """Show a recording (driving the robot) or a clip in the browser, until Ctrl-C.

    Args:
        recording: human recording or clip whose operator drives the simulated robot.
        motion: clip file to play without physics.
        policy: policy bundle; the packaged student by default.
        port: of the web page on this machine.
    """
    if (recording is None) == (motion is None):
        raise InputError(
            "nothing to show", remedy="give either --recording FILE or --motion CLIP"
        )
    from openclone.motion.clip import load_clip
    from openclone.odometry.noise import OdometryNoiseConfig
    from openclone.policy.bundle import load_bundle
    from openclone.robot.model import CONTROL_PERIOD
    from openclone.teleop.session import run_teleop
    from openclone.viewer.app import TeleopView, watch_motion, watch_sessions

    if motion is not None:
        clip = load_clip(motion)
        with TeleopView(port) as page:
            print(f"browser view: {page.url}; Ctrl-C ends", flush=True)
            qpos = clip.resampled(1.0 / CONTROL_PERIOD).qpos
            watch_motion(page, qpos, clip.info.name)
        return
    assert recording is not None
    bundle, performance = load_bundle(policy), load_performance(recording, None)

    def session(subscriber: Subscriber, number: int) -> None:
        run_teleop(
            performance.recording,
            bundle,
            subscribers=(subscriber,),
            noise=OdometryNoiseConfig(),
            seed=number,
            config=performance.config,
        )

    with TeleopView(port) as page:
        print(f"browser view: {page.url}; Ctrl-C ends", flush=True)
        _announce(page, performance)
        watch_sessions(page, session)
