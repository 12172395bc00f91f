"""The mean of several students."""

import math

import numpy as np
import onnx
import pytest
import torch
from onnx import numpy_helper

from openclone.cli.facts import policy_mean
from openclone.errors import InputError
from openclone.policy import observation
from openclone.policy.bundle import g1_info, load_bundle
from openclone.policy.mean import mean_bundle
from openclone.policy.moe import MoeConfig
from openclone.policy.student import StudentModel, export_bundle

WIDTH = 16


def student(path, seed, width=WIDTH, history=observation.HISTORY):
    torch.manual_seed(seed)
    model = StudentModel(MoeConfig(width=width), history)
    with torch.no_grad():
        model.network.head.weight.normal_()
    seen = torch.randn(64, observation.student_size(history)) * (2 + seed) + seed
    model.obs_normalizer.update(seen)
    export_bundle(model, g1_info("test", "abc", f"seed {seed}", history), path)
    return path


@pytest.fixture(scope="module")
def pair(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bundles")
    return [student(folder / f"{seed}.onnx", seed) for seed in (0, 1)]


def weights(path):
    items = onnx.load(str(path)).graph.initializer
    return {item.name: numpy_helper.to_array(item) for item in items}


def test_every_weight_is_the_weighted_mean(pair, tmp_path):
    policy_mean(bundles=tuple(pair), out=tmp_path / "new" / "m.onnx", shares=(3.0, 1.0))
    a, b = (weights(path) for path in pair)
    differ = 0
    for name, got in weights(tmp_path / "new" / "m.onnx").items():
        if got.dtype.kind != "f":
            np.testing.assert_array_equal(got, a[name])
            continue
        np.testing.assert_allclose(got, 0.75 * a[name] + 0.25 * b[name], atol=1e-5)
        differ += not np.array_equal(a[name], b[name])
    assert differ > 10
    info = load_bundle(tmp_path / "new" / "m.onnx").info
    assert info.training == "mean of 0.75 x (seed 0); 0.25 x (seed 1)"


def test_the_mean_of_one_student_with_itself_is_that_student(pair, tmp_path):
    policy_mean(bundles=(pair[0], pair[0]), out=tmp_path / "m.onnx")
    inputs = np.random.default_rng(0).standard_normal((5, observation.student_size()))
    wanted = load_bundle(pair[0]).act(inputs)
    got = load_bundle(tmp_path / "m.onnx").act(inputs)
    np.testing.assert_allclose(got, wanted, atol=1e-5)


def test_bundles_of_another_kind_are_refused(pair, tmp_path):
    out = tmp_path / "m.onnx"
    for other in (
        student(tmp_path / "wide.onnx", 2, width=24),
        student(tmp_path / "long.onnx", 2, history=30),
    ):
        with pytest.raises(InputError, match="same kind") as caught:
            mean_bundle([pair[0], other], [1.0, 1.0], out)
        assert str(other) in str(caught.value)
    assert not out.exists()


@pytest.mark.parametrize("shares", [[1.0], [1.0, 0.0], [1.0, math.nan], [1, math.inf]])
def test_shares_must_be_positive_and_one_each(pair, tmp_path, shares):
    with pytest.raises(InputError, match="shares"):
        mean_bundle(pair, shares, tmp_path / "m.onnx")


def test_one_bundle_is_no_mean(pair, tmp_path):
    with pytest.raises(InputError, match="two bundles"):
        policy_mean(bundles=(pair[0],), out=tmp_path / "m.onnx")
