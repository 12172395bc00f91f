"""The student network and its export as a bundle."""

from __future__ import annotations

import copy
from pathlib import Path

import torch
from torch import nn

from openclone.policy import observation
from openclone.policy.bundle import BundleInfo, load_bundle, write_metadata
from openclone.policy.mlp import MlpConfig, MlpNetwork
from openclone.policy.moe import MoeConfig, MoeNetwork
from openclone.policy.normalization import Normalization
from openclone.robot import g1


class StudentModel(nn.Module):
    """Normalized observation -> network -> action.

    The network is the paper's Mixture of Experts, or the MLP of its baseline.
    """

    mlp: nn.Module

    def __init__(self, network: MoeConfig | MlpConfig, history: int) -> None:
        super().__init__()
        size = observation.student_size(history)
        if isinstance(network, MoeConfig):
            built = MoeNetwork(size, g1.NUM_JOINTS, network)
        else:
            built = MlpNetwork(size, g1.NUM_JOINTS, network)
        nn.init.uniform_(built.head.weight, -0.01, 0.01)
        self.mlp = built
        self.obs_normalizer = Normalization(size)

    @property
    def network(self) -> MoeNetwork | MlpNetwork:
        """The network behind the normalization."""
        assert isinstance(self.mlp, (MoeNetwork, MlpNetwork))
        return self.mlp

    def with_routing(
        self, observations: torch.Tensor
    ) -> tuple[torch.Tensor, list[torch.Tensor]]:
        """As `mean_action`, and the routing weights of each MoE layer."""
        return self.network.with_routing(self.obs_normalizer(observations))

    def mean_action(self, observations: torch.Tensor) -> torch.Tensor:
        """Actions ``(n, d) -> (n, 29)``."""
        return self.mlp(self.obs_normalizer(observations))

    def freeze_routing(self) -> None:
        """Keep routers as DAgger left them."""
        if isinstance(self.network, MoeNetwork):
            for layer in self.network.layers:
                layer.router.requires_grad_(False)


class _Exported(nn.Module):
    """The deterministic part, as ONNX sees it."""

    mean: torch.Tensor
    spread: torch.Tensor

    def __init__(self, model: StudentModel) -> None:
        super().__init__()
        normalizer = model.obs_normalizer
        assert isinstance(normalizer, Normalization)
        self.network = model.mlp
        self.register_buffer("mean", normalizer.mean[None])
        self.register_buffer("spread", normalizer.std[None] + normalizer.eps)

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        return self.network((inputs - self.mean) / self.spread)


def export_bundle(model: StudentModel, info: BundleInfo, path: Path) -> None:
    """Write ``model`` as one ONNX file with ``info`` inside."""
    path.parent.mkdir(parents=True, exist_ok=True)
    # A copy, as the network may live on a GPU.
    module = copy.deepcopy(_Exported(model)).cpu().eval()
    torch.onnx.export(
        module,
        (torch.zeros(2, info.observation_size),),
        str(path),
        input_names=["observation"],
        output_names=["action"],
        dynamic_shapes={"inputs": {0: torch.export.Dim("batch")}},
        external_data=False,
        verbose=False,
    )
    write_metadata(path, info)


_SEEN = 10_000_000
"""Observations that the normalization of a bundle counts as seen."""


def import_bundle(model: StudentModel, path: Path) -> None:
    """Give ``model`` the weights of a bundle written by `export_bundle`.

    Raises:
        InputError: not a bundle, or one of another robot or observation layout.
        KeyError, RuntimeError: a bundle of another network than the model's.
    """
    import onnx
    from onnx import numpy_helper

    load_bundle(path)
    graph = onnx.load(str(path), load_external_data=False).graph
    values = {
        value.name: torch.from_numpy(numpy_helper.to_array(value).copy())
        for value in graph.initializer
    }
    prefix = "network."
    weights = {
        name.removeprefix(prefix): value
        for name, value in values.items()
        if name.startswith(prefix)
    }
    model.network.load_state_dict(weights)
    normalizer = model.obs_normalizer
    assert isinstance(normalizer, Normalization)
    normalizer.assume(values["mean"], values["spread"], _SEEN)
