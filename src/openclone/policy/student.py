"""The student network and its export as a bundle."""

from __future__ import annotations

from pathlib import Path

import torch
from rsl_rl.models import MLPModel
from tensordict import TensorDict
from torch import nn

from openclone.policy import observation
from openclone.policy.bundle import BundleInfo, write_metadata
from openclone.policy.moe import MoeConfig, MoeNetwork
from openclone.robot import g1

GROUP = "student"
"""Name of the student's observation in a TensorDict."""


class StudentModel(MLPModel):
    """Normalized observation -> MoE network -> action mean.

    A model of rsl_rl, so that its PPO can fine-tune what DAgger has taught; the
    Gaussian's standard deviation is used only there.
    """

    mlp: nn.Module

    def __init__(self, moe: MoeConfig, initial_std: float, history: int) -> None:
        size = observation.student_size(history)
        example = TensorDict({GROUP: torch.zeros(1, size)}, batch_size=[1])
        super().__init__(
            example,
            {"actor": [GROUP]},
            "actor",
            g1.NUM_JOINTS,
            hidden_dims=(1,),
            obs_normalization=True,
            distribution_cfg={
                "class_name": "GaussianDistribution",
                "init_std": initial_std,
                "std_type": "log",
            },
        )
        self.mlp = MoeNetwork(size, g1.NUM_JOINTS, moe)
        nn.init.uniform_(self.mlp.head.weight, -0.01, 0.01)

    @property
    def network(self) -> MoeNetwork:
        """The MoE network."""
        assert isinstance(self.mlp, MoeNetwork)
        return self.mlp

    def with_routing(
        self, observations: torch.Tensor
    ) -> tuple[torch.Tensor, list[torch.Tensor]]:
        """As `mean_action`, and the routing weights of each MoE layer."""
        return self.network.with_routing(self.obs_normalizer(observations))

    def mean_action(self, observations: torch.Tensor) -> torch.Tensor:
        """Actions without noise, ``(n, 2376) -> (n, 29)``."""
        return self.mlp(self.obs_normalizer(observations))

    def freeze_routing(self) -> None:
        """Keep routers and input normalization as DAgger left them."""
        for layer in self.network.layers:
            layer.router.requires_grad_(False)
        self.obs_normalization = False


class _Exported(nn.Module):
    """The deterministic part, as ONNX sees it."""

    def __init__(self, model: StudentModel) -> None:
        super().__init__()
        self.normalizer, self.network = model.obs_normalizer, model.mlp

    def forward(self, inputs: torch.Tensor) -> torch.Tensor:
        return self.network(self.normalizer(inputs))


def export_bundle(model: StudentModel, info: BundleInfo, path: Path) -> None:
    """Write ``model`` as one ONNX file with ``info`` inside."""
    path.parent.mkdir(parents=True, exist_ok=True)
    module = _Exported(model).eval()
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
