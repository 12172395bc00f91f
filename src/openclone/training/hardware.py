"""What a run computes on: back-end of the physics, device of everything else."""

from __future__ import annotations

import contextlib
import ctypes
import functools
import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import ParamSpec, TypeVar

import mujoco
import torch

from openclone.errors import InputError
from openclone.training.distributed import team, threads_per_process
from openclone.training.lane_physics import LanePhysics
from openclone.training.physics import Physics, ThreadedPhysics

Parameters = ParamSpec("Parameters")
Result = TypeVar("Result")


def on_one_thread(
    work: Callable[Parameters, Result],
) -> Callable[Parameters, Result]:
    """Let PyTorch do ``work`` on one core, and then use as many as before.

    Hundreds of small operations lose more by waking other threads than those save.
    """

    @functools.wraps(work)
    def quicker(*args: Parameters.args, **kwargs: Parameters.kwargs) -> Result:
        before = torch.get_num_threads()
        torch.set_num_threads(1)
        try:
            return work(*args, **kwargs)
        finally:
            torch.set_num_threads(before)

    return quicker


_TRIM_THRESHOLD, _TOP_PAD, _MMAP_THRESHOLD = -1, -2, -3
"""glibc's names of what `mallopt` sets, as in its malloc.h."""


def keep_memory() -> None:
    """Let the C library keep the memory of tensors that are gone; on glibc alone.

    It would give blocks of megabytes back to the system at once and get them again,
    page by page, for the next tensor: drawing a batch of students' inputs took 17
    instead of 3 ms.
    """
    with contextlib.suppress(OSError, AttributeError):
        libc = ctypes.CDLL(None)
        libc.mallopt(_MMAP_THRESHOLD, 32 << 20)
        libc.mallopt(_TRIM_THRESHOLD, 2**31 - 1)
        libc.mallopt(_TOP_PAD, 64 << 20)


PHYSICS = ("auto", "lanes", "threaded", "warp")


@dataclass(frozen=True)
class Hardware:
    """Where a run computes.

    Attributes:
        physics: "lanes" (`lane_physics` on the cores), "threaded" (MuJoCo on the
            cores), "warp" (MuJoCo Warp on `device`), or "auto": lanes where they are
            possible, else threaded.
        device: PyTorch's name of the device of task, networks and data: "cpu", "cuda"
            or "cuda:1". Under torchrun, "cuda" is the process's own GPU.
        model: the robot as a file of `openclone train model`; None: assembled from
            mjlab's.
    """

    physics: str = "auto"
    device: str = "cpu"
    model: Path | None = None

    def torch_device(self) -> torch.device:
        """The device, checked.

        Raises:
            InputError: it is unknown, or there is none of its kind.
        """
        if self.physics not in PHYSICS:
            raise InputError(
                f"unknown physics {self.physics!r}",
                remedy="use " + ", ".join(PHYSICS[:-1]) + f" or {PHYSICS[-1]}",
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

        ``threads`` step the robots on the cores; by default as many as are this
        process's share of them.

        Raises:
            InputError: "lanes" are wanted and not possible.
        """
        device = self.torch_device()
        if self.physics == "warp":
            # Warp takes seconds to import and is not wanted otherwise.
            from openclone.training.warp_physics import WarpPhysics

            return WarpPhysics(model, num_envs, str(device))
        threads = threads or threads_per_process()
        if self.physics == "lanes" or (self.physics == "auto" and device.type == "cpu"):
            try:
                return LanePhysics(model, num_envs, threads, device)
            except InputError as error:
                if self.physics == "lanes":
                    raise
                if team().leads:
                    print(f"training on MuJoCo's own threads: {error}")
        return ThreadedPhysics(model, num_envs, threads, device=device)
