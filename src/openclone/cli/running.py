"""Commands that run the robot: demo, teleop, view."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from openclone.teleop.messages import OperatorRecording


def _operator_recording(path: Path) -> OperatorRecording:
    """What a headset would have seen of a recorded human, or of a G1 in a clip."""
    from openclone.teleop.messages import recording_at_rate

    if path.suffix == ".npz":
        from openclone.motion.clip import load_clip
        from openclone.robot.kinematics import Kinematics
        from openclone.robot.state import key_point_poses

        clip = load_clip(path)
        points = key_point_poses(*Kinematics().trajectory(clip.qpos))
        return recording_at_rate(clip.info.name, clip.info.fps, *points)
    from openclone.motion.library import read_recording
    from openclone.motion.skeleton import operator_points

    motion = read_recording(path)
    return recording_at_rate(motion.name, motion.fps, *operator_points(motion))


def demo(*, out: Path = Path("reports/demo"), view: bool = False) -> None:
    """Drive the simulated G1 with synthetic operators and write a report folder.

    Args:
        out: folder for report.html, video.mp4 and a picture.
        view: also serve the browser view.
    """
    from openclone.evaluation.demo import run_demo

    run_demo(out, view)


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
    """
    raise NotImplementedError


def view(
    *, recording: Path | None = None, motion: Path | None = None, port: int = 8080
) -> None:
    """Show a recording (driving the robot) or a clip in the browser.

    Args:
        recording: human recording or clip that drives the simulated robot.
        motion: clip file to play without physics.
        port: of the web page on this machine.
    """
    raise NotImplementedError
