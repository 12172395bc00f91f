import gc
import sys
from pathlib import Path

import numpy as np
import pytest

from openclone.odometry.noise import OdometryNoiseConfig
from openclone.policy import observation
from openclone.policy.bundle import Bundle, g1_info, load_bundle, write_metadata
from openclone.robot.model import standing_qpos
from openclone.simulation.robot import SimulatedRobot
from openclone.teleop.loop import LoopConfig
from openclone.teleop.messages import OperatorRecording, Phase
from openclone.teleop.session import SessionConfig, run_teleop


@pytest.fixture(scope="module")
def onnx_bundle(tmp_path_factory: pytest.TempPathFactory) -> Bundle:
    """A real ONNX file that always answers zero."""
    onnx = pytest.importorskip("onnx")
    size = observation.student_size()
    weights = np.zeros((size, 29), dtype=np.float32)
    graph = onnx.helper.make_graph(
        [onnx.helper.make_node("MatMul", ["observation", "w"], ["action"])],
        "zero",
        [onnx.helper.make_tensor_value_info("observation", 1, ["n", size])],
        [onnx.helper.make_tensor_value_info("action", 1, ["n", 29])],
        [onnx.numpy_helper.from_array(weights, "w")],
    )
    model = onnx.helper.make_model(
        graph, opset_imports=[onnx.helper.make_opsetid("", 17)]
    )
    model.ir_version = 8
    path: Path = tmp_path_factory.mktemp("bundle") / "zero.onnx"
    onnx.save(model, str(path))
    write_metadata(path, g1_info("zero", "", ""))
    return load_bundle(path)


def test_a_robot_without_a_policy_falls_and_the_run_ends(
    onnx_bundle: Bundle, walking: OperatorRecording
) -> None:
    result = run_teleop(walking, onnx_bundle, seconds=5.0, realtime=False)
    assert result.stats.falls == 1
    assert 30 < result.stats.ticks < 150
    assert result.log.fallen[-1]
    assert not result.log.fallen[:-1].any()
    np.testing.assert_array_equal(result.log.qpos[0], standing_qpos())


def test_without_real_time_a_run_repeats_exactly(
    bundle: Bundle, walking: OperatorRecording
) -> None:
    robot = SimulatedRobot()

    def positions(seed: int) -> np.ndarray:
        noise = OdometryNoiseConfig()
        robot.reset(standing_qpos())
        result = run_teleop(
            walking,
            bundle,
            seconds=0.6,
            realtime=False,
            noise=noise,
            seed=seed,
            robot=robot,
        )
        return result.log.measured_position

    np.testing.assert_array_equal(positions(1), positions(1))
    assert np.abs(positions(1) - positions(2)).max() > 1e-5


def test_the_measured_points_are_the_truth_without_noise(
    bundle: Bundle, walking: OperatorRecording
) -> None:
    log = run_teleop(walking, bundle, seconds=0.5, realtime=False).log
    np.testing.assert_allclose(log.base_position, log.qpos[:, :3], atol=1e-12)
    np.testing.assert_allclose(log.joint_angles, log.qpos[:, 7:], atol=1e-12)
    assert np.isfinite(log.target_position[1:]).all()
    assert log.phase[-1] == Phase.RAMP


def test_recording_time_tells_what_the_operator_showed(
    bundle: Bundle, walking: OperatorRecording
) -> None:
    config = SessionConfig(loop=LoopConfig(stop_on_fall=False))
    result = run_teleop(walking, bundle, realtime=False, config=config)
    shown = result.recording_time_s
    assert shown[0] == 0.0
    assert shown[-1] == pytest.approx(walking.seconds)
    assert (np.diff(shown) >= 0).all()
    # The operator's own path, read back from the log, agrees with the time.
    walked = result.log.operator_position[:, 0, 0]
    np.testing.assert_allclose(walked, 0.5 * shown, atol=1e-6)
    # Lead-in 1.5 s, recording 2.99 s, easing 0.6 s, tail 1 s.
    assert result.stats.ticks == pytest.approx((1.5 + 2.99 + 0.6 + 1.0) * 50, abs=2)


def test_real_time_keeps_pace_and_leaves_the_interpreter_as_it_was(
    onnx_bundle: Bundle, walking: OperatorRecording
) -> None:
    interval = sys.getswitchinterval()
    result = run_teleop(walking, onnx_bundle, seconds=0.8, realtime=True)
    assert sys.getswitchinterval() == interval
    assert gc.isenabled()
    log, stats = result.log, result.stats
    elapsed = (log.stamp_ns[-1] - log.stamp_ns[0]) * 1e-9
    # Fewer ticks than 20 ms intervals only by what was counted as overrun.
    intervals = round(elapsed / 0.02)
    assert 0 <= intervals - (stats.ticks - 1) <= stats.overruns
    assert (log.operator_stamp_ns[5:] > 0).all()


def test_a_tick_is_short(onnx_bundle: Bundle, walking: OperatorRecording) -> None:
    stats = run_teleop(walking, onnx_bundle, seconds=1.0, realtime=False).stats
    # Well under the 20 ms period, even on a busy machine.
    assert stats.p50_ms < 10.0
