"""What a run computes on: back-end of the physics, device of everything else."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

import mujoco
import torch

from openclone.errors import InputError
from openclone.training.distributed import threads_per_process
from openclone.training.physics import Physics, ThreadedPhysics


@dataclass(frozen=True)
class Hardware:
    """Where a run computes.

    Attributes:
        physics: "threaded" (MuJoCo on the cores) or "warp" (MuJoCo Warp on `device`).
        device: PyTorch's name of the device of task, networks and data: "cpu", "cuda"
            or "cuda:1". Under torchrun, "cuda" is the process's own GPU.
        model: the robot as a file of `openclone train model`; None: assembled from
            mjlab's.
    """

    physics: str = "threaded"
    device: str = "cpu"
    model: Path | None = None

    def torch_device(self) -> torch.device:
        """The device, checked.

        Raises:
            InputError: it is unknown, or there is none of its kind.
        """
        if self.physics not in ("threaded", "warp"):
            raise InputError(
                f"unknown physics {self.physics!r}", remedy="use threaded or warp"
            )
        try:
            device = torch.device(self.device)
        except RuntimeError:
            device = None
        if device is None or device.type not in ("cpu", "cuda"):
            raise InputError(
                f"unknown device {self.device!r}",
                remedy="use cpu, cuda, cuda:1 ...",
            )
        if device.type == "cpu":
            return torch.device("cpu")
        index = device.index
        if index is None:
            index = int(os.environ.get("LOCAL_RANK", "0"))
        if not torch.cuda.is_available() or index >= torch.cuda.device_count():
            raise InputError(
                f"--device {self.device}: PyTorch {torch.__version__} finds "
                f"{torch.cuda.device_count()} CUDA devices",
                remedy="use --device cpu, or install a CUDA build (docs/gpu.md)",
            )
        return torch.device("cuda", index)

    def make_physics(
        self, model: mujoco.MjModel, num_envs: int, threads: int | None
    ) -> Physics:
        """``num_envs`` robots of ``model`` on the chosen back-end.

        ``threads`` step the robots of "threaded"; by default as many as are this
        process's share of the cores.
        """
        device = self.torch_device()
        if self.physics == "warp":
            # Warp takes seconds to import and is not wanted otherwise.
            from openclone.training.warp_physics import WarpPhysics

            return WarpPhysics(model, num_envs, str(device))
        threads = threads or threads_per_process()
        return ThreadedPhysics(model, num_envs, threads, device=device)
