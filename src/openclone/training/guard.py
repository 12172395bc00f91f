"""Stop at the first number that is not finite, and keep what is needed to see why."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

import numpy as np
import torch
from torch import nn

from openclone.errors import OpenCloneError
from openclone.training.task import TrackingTask

DUMP = "nan-dump.npz"
Tensors = dict[str, torch.Tensor]


class TrainingStopped(OpenCloneError):
    """Training met a value that is not finite and wrote a dump."""


class NanGuard:
    """Watches losses, observations and networks of one run.

    ``dump`` names the tensors of the last batch; robots and networks are added.
    """

    def __init__(
        self,
        folder: Path,
        task: TrackingTask,
        networks: Mapping[str, nn.Module],
        dump: Callable[[], Tensors],
    ) -> None:
        """Write to ``folder`` if something goes wrong."""
        self._folder, self._task = folder, task
        self._networks, self._dump = networks, dump

    def check(self, values: dict[str, float], steps: int) -> None:
        """Refuse losses and network parameters that are not finite.

        Raises:
            TrainingStopped: the first offender, and the file with the evidence.
        """
        for name, value in values.items():
            if not math.isfinite(value):
                self._stop(f"{name} is {value}", values, steps)
        for name, network in self._networks.items():
            if not _finite(network.parameters()):
                self._stop(f"a weight of the {name} is not finite", values, steps)

    def check_observations(
        self, observations: Iterable[torch.Tensor], steps: int
    ) -> None:
        """Refuse observations that are not finite; see `check`."""
        if not _finite(observations):
            self._stop("an observation is not finite", {}, steps)

    def _stop(self, what: str, values: dict[str, float], steps: int) -> None:
        tensors: Tensors = {f"batch/{k}": v for k, v in self._dump().items()}
        names = ("qpos", "qvel", "sensordata")
        for name, part in zip(names, self._task.physics.read(), strict=True):
            tensors[f"robots/{name}"] = part
        tensors["robots/reference_frame"] = self._task.frame
        for name, network in self._networks.items():
            for key, value in network.state_dict().items():
                tensors[f"network/{name}/{key}"] = value
        for name, value in values.items():
            tensors[f"values/{name}"] = torch.tensor(value)
        self._folder.mkdir(parents=True, exist_ok=True)
        path = self._folder / DUMP
        arrays = {k: v.detach().cpu().numpy() for k, v in tensors.items()}
        np.savez(path, allow_pickle=False, **arrays)
        raise TrainingStopped(
            f"training stopped after {steps} steps: {what}; the last batch, the robots "
            f"and the networks are in {path}; go on from the last checkpoint with "
            "--resume and another --seed"
        )


def _finite(tensors: Iterable[torch.Tensor]) -> bool:
    return all(bool(torch.isfinite(tensor).all()) for tensor in tensors)
