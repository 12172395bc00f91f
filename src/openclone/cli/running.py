"""Commands that run the robot: demo, teleop, view."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from openclone.cli.options import positive, print_figures, write_figures
from openclone.errors import InputError

if TYPE_CHECKING:
    import numpy as np

    from openclone.evaluation.tracking import TrackingReport
    from openclone.motion.clip import Clip, ClipInfo
    from openclone.teleop.messages import OperatorRecording, Subscriber
    from openclone.teleop.session import SessionConfig, SessionResult
    from openclone.viewer.app import TeleopView


@dataclass(frozen=True)
class _Performance:
    """An operator to replay, and the motion of the G1 that he or she means.

    Attributes:
        recording: head and wrists, operator's world.
        info: name and category of the motion.
        reference: (T, 36), the motion on the G1 at 50 Hz, in the robot's world; what
            metrics compare the robot with.
        config: settings that suit this operator.
    """

    recording: OperatorRecording
    info: ClipInfo
    reference: np.ndarray
    config: SessionConfig


def _load_performance(path: Path, seconds: float | None) -> _Performance:
    """Read a clip (.npz) or a human recording, which is retargeted for its metrics."""
    from openclone.teleop.loop import LoopConfig
    from openclone.teleop.operators.replay import ReplayConfig
    from openclone.teleop.session import SessionConfig

    # With a given length the operator stays at the end of the recording.
    replay = ReplayConfig(tail_s=1.0 if seconds is None else max(seconds, 1.0))
    if path.suffix == ".npz":
        from openclone.evaluation.operator import calibration_of_operator, operator_of
        from openclone.motion.clip import load_clip
        from openclone.robot.kinematics import Kinematics

        clip = load_clip(path)
        loop = LoopConfig(calibration=calibration_of_operator())
        recording = operator_of(clip, Kinematics())
        config = SessionConfig(loop, replay)
        return _Performance(recording, clip.info, _reference(clip), config)
    from openclone.evaluation.human_operator import operator_of_motion
    from openclone.motion.clip import ClipInfo
    from openclone.motion.library import read_recording
    from openclone.motion.retarget import retarget

    motion = read_recording(path)
    recording, calibration = operator_of_motion(motion)
    info = ClipInfo(path.stem, "transition", str(path), "unknown", motion.fps)
    clip, _ = retarget(motion, info)
    config = SessionConfig(LoopConfig(calibration=calibration), replay)
    return _Performance(recording, info, _reference(clip), config)


def _reference(clip: Clip) -> np.ndarray:
    """The clip at 50 Hz, placed where calibration places its operator."""
    from openclone.evaluation.programme import place_head
    from openclone.robot.kinematics import Kinematics
    from openclone.robot.model import CONTROL_PERIOD, standing_qpos

    kinematics = Kinematics()
    qpos = clip.resampled(1.0 / CONTROL_PERIOD).qpos
    head_xy = kinematics.key_points(standing_qpos())[0][0, :2].copy()
    return place_head(qpos, kinematics.bodies(qpos[0]), head_xy)


def _measure(performance: _Performance, result: SessionResult) -> TrackingReport:
    """Compare the session with the motion that the operator meant."""
    from openclone.evaluation.programme import Part
    from openclone.evaluation.session import session_results
    from openclone.evaluation.tracking import TrackingReport
    from openclone.robot.kinematics import Kinematics

    info, reference = performance.info, performance.reference
    parts = (Part(info.name, info.category, 0, len(reference)),)
    results = session_results(result, reference, parts, Kinematics())
    return TrackingReport(results)


@contextmanager
def _view(port: int | None) -> Iterator[TeleopView | None]:
    """Serve the browser view on ``port``; nothing if that is None."""
    if port is None:
        yield None
        return
    from openclone.viewer.app import TeleopView

    with TeleopView(port) as page:
        print(f"browser view: {page.url}")
        yield page


def teleop(
    *,
    operator: Literal["replay"] = "replay",
    recording: Path,
    policy: Path | None = None,
    seconds: float | None = None,
    realtime: bool = True,
    noise: bool = True,
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
        noise: add the odometry error of Eq. 2.
        seed: of the odometry error.
        json: write the measurements to this file.
        record: write every tick to this .npz file.
        view: serve the browser view meanwhile.
        port: of the browser view.
    """
    from dataclasses import asdict

    from openclone.evaluation.report import COLUMNS, table_row
    from openclone.odometry.noise import OdometryNoiseConfig
    from openclone.policy.bundle import load_bundle
    from openclone.teleop.recorder import save_log
    from openclone.teleop.session import run_teleop

    positive("--seconds", seconds)
    bundle = load_bundle(policy)
    performance = _load_performance(recording, seconds)
    with _view(port if view else None) as page:
        if page is not None:
            replay = performance.config.replay
            page.show_reference(performance.recording, performance.reference, replay)
        result = run_teleop(
            performance.recording,
            bundle,
            seconds=seconds,
            realtime=realtime,
            subscribers=() if page is None else (page,),
            noise=OdometryNoiseConfig() if noise else None,
            seed=seed,
            config=performance.config,
        )
    stats = asdict(result.stats)
    print_figures(stats)
    report = _measure(performance, result)
    if report.clips:
        figures = zip(COLUMNS, table_row(report.overall), strict=True)
        print_figures(dict(figures))
        write_figures(json, {**report.to_json(), "operator": operator, "loop": stats})
    else:
        write_figures(json, {"operator": operator, "loop": stats})
    if record is not None:
        save_log(result.log, record)
        print(f"recorded: {record}")


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
            print(f"browser view: {page.url}; Ctrl-C ends")
            qpos = clip.resampled(1.0 / CONTROL_PERIOD).qpos
            watch_motion(page, qpos, clip.info.name)
        return
    assert recording is not None
    bundle, performance = load_bundle(policy), _load_performance(recording, None)

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
        print(f"browser view: {page.url}; Ctrl-C ends")
        page.show_reference(performance.recording, performance.reference)
        watch_sessions(page, session)
