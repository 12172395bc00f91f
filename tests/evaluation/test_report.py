"""Report, film and demonstration, with stand-ins for the student."""

from __future__ import annotations

import json

import mujoco
import numpy as np
import pytest

from openclone.errors import OpenCloneError
from openclone.evaluation.demo import run_demo
from openclone.evaluation.report import PAPER_ROWS, Report, write_report
from openclone.evaluation.tracking import TrackingReport, evaluate_tracking
from openclone.evaluation.video import Film, film_run
from openclone.motion.clip import Clip, ClipInfo, clip_from_qpos
from openclone.policy.bundle import Bundle, g1_info
from openclone.robot import g1
from openclone.robot.ghost import build_ghost_model, ghost_qpos, thin_out
from openclone.robot.model import build_model, standing_qpos


class HoldPose(Bundle):
    """Motors that hold the standing pose; the robot topples after a second or so."""

    def __init__(self) -> None:
        super().__init__(g1_info("hold <pose>", "", "none"), None)

    def act(self, observations: np.ndarray) -> np.ndarray:
        return np.zeros((len(observations), g1.NUM_JOINTS))


def still(name: str, seconds: float) -> Clip:
    info = ClipInfo(name, "stand", "test", "", 50.0)
    return clip_from_qpos(info, np.tile(standing_qpos(), (round(50 * seconds) + 1, 1)))


@pytest.fixture(scope="module")
def tracking() -> TrackingReport:
    return evaluate_tracking([still("a&b", 0.3), still("c", 4.0)], HoldPose())


def test_report_is_one_page_that_needs_nothing_else(tracking, tmp_path):
    report = Report(
        "Title <1>",
        "intro",
        tracking,
        (("falls", "1"),),
        np.full(100, 1.5),
        ("a note",),
    )
    page = write_report(report, tmp_path).read_text()
    assert "Title &lt;1&gt;" in page
    assert "a&amp;b" in page
    assert "a note" in page
    assert page.count("data:image/png;base64,") == 4
    assert "http" not in page
    assert "<video" not in page
    for row in PAPER_ROWS:
        assert f"{row[2]:.2f}" in page
    data = json.loads((tmp_path / "metrics.json").read_text())
    assert data["sr"] == 50.0


def test_thinning_out_keeps_the_shape_of_a_block():
    # A cube of 0.1 m, each side split into 20 x 20 squares of two triangles.
    grid = np.linspace(0, 0.1, 21)
    u, v = (x.reshape(-1) for x in np.meshgrid(grid[:-1], grid[:-1], indexing="ij"))
    step = grid[1]
    square = [(0, 0), (step, 0), (step, step), (0, step)]
    sides = []
    for axis in range(3):
        for height in (0.0, 0.1):
            corners = [
                np.insert(np.stack((u + a, v + b), 1), axis, height, axis=1)
                for a, b in square
            ]
            sides += [
                np.stack([corners[k] for k in c], 1) for c in ((0, 1, 2), (0, 2, 3))
            ]
    triangles = np.concatenate(sides)
    vertices, faces = thin_out(triangles, cell=0.02)
    assert len(faces) < len(triangles) / 5
    assert vertices.min() >= -1e-6
    assert vertices.max() <= 0.1 + 1e-6
    assert np.ptp(vertices, axis=0).min() > 0.1 - 0.02
    assert faces.max() < len(vertices)
    assert not np.any(faces[:, 0] == faces[:, 1])


def test_ghost_stands_where_the_reference_says():
    model, plain = build_ghost_model(), build_model()
    assert model.nq == 2 * plain.nq
    assert model.nu == plain.nu
    data, alone = mujoco.MjData(model), mujoco.MjData(plain)
    robot, reference = standing_qpos(), standing_qpos()
    reference[:2] += (1.0, -0.5)
    reference[7 + g1.joint_index("left_elbow_joint")] += 0.7
    data.qpos[:] = ghost_qpos(robot, reference)
    alone.qpos[:] = reference
    mujoco.mj_kinematics(model, data)
    mujoco.mj_kinematics(plain, alone)
    for name in g1.KEY_BODIES:
        ghost = data.body(f"ghost_{name}").xpos
        assert ghost == pytest.approx(alone.body(name).xpos, abs=1e-6)


def _film(frames: int) -> Film:
    qpos = np.tile(standing_qpos(), (frames, 1))
    targets = np.tile([0.0, 0.0, 1.2], (frames, 3, 1))
    return Film(qpos, qpos, targets, np.tile([1.0, 0, 0, 0], (frames, 3, 1)), 0.02)


def test_film_is_as_long_as_the_run(tmp_path):
    av = pytest.importorskip("av")
    try:
        video, still_picture = film_run(_film(10), tmp_path)
    except OpenCloneError as error:
        pytest.skip(str(error))
    with av.open(str(video)) as container:
        frames = list(container.decode(video=0))
    assert len(frames) == 5
    picture = frames[0].to_ndarray(format="rgb24")
    assert picture.shape == (480, 640, 3)
    assert picture.std() > 10  # not a blank picture
    assert still_picture.is_file()
    assert not (tmp_path / "run.npz").exists()


def test_a_machine_that_cannot_render_is_told_what_to_install(tmp_path, monkeypatch):
    monkeypatch.setenv("MUJOCO_GL", "no-such-renderer")
    with pytest.raises(OpenCloneError, match="apt-get install libosmesa6"):
        film_run(_film(2), tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_demo_measures_every_clip_and_goes_on_after_a_fall(tmp_path):
    seen: list[int] = []

    class Watcher:
        def put(self, value, /) -> None:
            seen[-1] += 1

        def show_reference(self, recording, qpos) -> None:
            seen.append(0)

    lines: list[str] = []
    result = run_demo(
        tmp_path,
        Watcher(),
        bundle=HoldPose(),
        clips=[still("a", 3.0), still("b", 3.0)],
        realtime=False,
        video=False,
        say=lines.append,
    )
    assert list(result.tracking.clips) == ["a", "b"]
    assert result.tracking.overall.sr == 0.0  # nobody balances
    assert len(seen) == 2
    assert min(seen) > 50
    assert any("falls 2" in line for line in lines)
    assert "openclone view --recording" in lines[-1]
    assert result.page.is_file()
    assert result.motion.is_file()
