import numpy as np
import onnx
import pytest
import torch

from openclone.errors import InputError
from openclone.policy import observation
from openclone.policy.bundle import g1_info, load_bundle, packaged_bundle
from openclone.policy.command import Command, KeyPoints
from openclone.policy.controller import StudentController
from openclone.policy.mlp import MlpConfig
from openclone.policy.moe import MoeConfig
from openclone.policy.observation import Proprioception
from openclone.policy.student import StudentModel, export_bundle, import_bundle
from openclone.robot import g1


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    torch.manual_seed(0)
    model = StudentModel(MoeConfig(width=32), observation.HISTORY)
    with torch.no_grad():
        model.mlp.head.weight.normal_()
    model.obs_normalizer.update(torch.randn(64, observation.student_size()) * 2 + 1)
    path = tmp_path_factory.mktemp("bundle") / "student.onnx"
    export_bundle(model, g1_info("test", "abc", "none"), path)
    return model.eval(), path


def test_onnx_equals_torch(exported):
    model, path = exported
    inputs = torch.randn(7, observation.student_size())
    with torch.no_grad():
        expected = model.mean_action(inputs).numpy()
    got = load_bundle(path).act(inputs.numpy())
    np.testing.assert_allclose(got, expected, atol=1e-4)
    assert np.abs(expected).max() > 0.5


def test_a_bundle_can_be_trained_on(exported):
    model, path = exported
    torch.manual_seed(1)
    again = StudentModel(MoeConfig(width=32), observation.HISTORY)
    import_bundle(again, path)
    inputs = torch.randn(7, observation.student_size()) * 3
    with torch.no_grad():
        before = again.eval().mean_action(inputs)
        torch.testing.assert_close(before, model.mean_action(inputs))
        # What it has seen counts: one batch changes little.
        again.train().obs_normalizer.update(torch.randn(64, observation.student_size()))
        torch.testing.assert_close(
            again.eval().mean_action(inputs), before, rtol=0, atol=1e-2
        )
    import_bundle(StudentModel(MoeConfig(), 25), packaged_bundle())
    with pytest.raises(RuntimeError, match="size mismatch"):
        import_bundle(StudentModel(MoeConfig(width=16), 25), path)


@pytest.mark.parametrize(
    ("network", "history"),
    [(MlpConfig((16, 8)), 5), (MoeConfig(layers=1, experts=8, width=16), 50)],
)
def test_other_networks_and_histories_run_in_the_loop(network, history, tmp_path):
    torch.manual_seed(0)
    model = StudentModel(network, history)
    with torch.no_grad():
        model.network.head.weight.normal_()
    path = tmp_path / "ablation.onnx"
    export_bundle(model, g1_info("ablation", "", "", history), path)
    bundle = load_bundle(path)
    assert bundle.info.observation_size == 63 + 93 * history
    controller = StudentController(bundle)
    points = KeyPoints(np.zeros((3, 3)), np.tile([1.0, 0, 0, 0], (3, 1)))
    command = Command(points, np.zeros((3, 3)))
    resting = Proprioception(
        g1.DEFAULT_POSE, np.zeros(29), np.zeros(3), np.array([1.0, 0, 0, 0])
    )
    for _ in range(3):
        before = controller.action
        targets = controller.step(command, resting, points)
    # The loop's own input is the network's: the history holds the last actions.
    inputs = torch.from_numpy(bundle_input(command, points, controller, before))
    with torch.no_grad():
        expected = model.eval().mean_action(inputs[None].float())[0].numpy()
    np.testing.assert_allclose(controller.action, expected, atol=1e-4)
    np.testing.assert_allclose(
        targets, g1.DEFAULT_POSE + g1.ACTION_SCALE * controller.action, atol=1e-9
    )


def bundle_input(command, points, controller, before):
    history = controller._history
    assert history is not None
    # The newest frame ends with the previous action, halved.
    np.testing.assert_allclose(history.frames[0, -29:], before * 0.5, atol=1e-12)
    heading = np.array([1.0, 0, 0, 0])
    return observation.student(observation.task(command, points, heading), history)


def test_metadata_travels_with_the_file(exported):
    info = load_bundle(exported[1]).info
    assert info == g1_info("test", "abc", "none")


def change(path, target, key, value):
    model = onnx.load(str(path))
    for item in model.metadata_props:
        if item.key == key:
            item.value = value
    onnx.save(model, str(target))
    return target


@pytest.mark.parametrize(
    ("key", "value", "message"),
    [
        ("layout", '"other-layout"', "layout is 'other-layout'"),
        ("history", "5", "history is 5"),
        ("history", "2.5", "history is 2.5"),
        ("history", "100000", "history is 100000"),
        ("observation_size", "100", "observation_size must be 2388"),
        ("joint_names", '["a", "b"]', "joint_names"),
        ("kp", "[1.0, 2.0]", "kp must be 29"),
        ("format", '"nothing"', "metadata"),
        ("default_pose", "not json", "metadata"),
    ],
)
def test_mismatching_bundles_are_refused(exported, tmp_path, key, value, message):
    path = change(exported[1], tmp_path / "changed.onnx", key, value)
    with pytest.raises(InputError, match=message) as caught:
        load_bundle(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_missing_and_damaged_files(tmp_path):
    with pytest.raises(InputError, match="no such policy bundle"):
        load_bundle(tmp_path / "nothing.onnx")
    damaged = tmp_path / "damaged.onnx"
    damaged.write_bytes(b"x" * 100)
    with pytest.raises(InputError, match="not a readable ONNX file"):
        load_bundle(damaged)


def test_a_bundle_tells_nothing_about_the_machine(exported):
    _, path = exported
    for file in (path, packaged_bundle()):
        content = file.read_bytes()
        assert b"site-packages" not in content
        assert b"stack_trace" not in content
