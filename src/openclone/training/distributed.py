"""Training in several processes, on one machine or more.

    openclone train teacher --processes 2
    torchrun --nproc-per-node 2 -m openclone.cli train teacher

Every process simulates the preset's robots and collects its own data; rsl_rl averages
the gradients. Process 0 decides when to stop, and it alone prints and writes.
"""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass

import torch
from rsl_rl.algorithms import PPO
from torch import distributed, nn
from torch.distributed.elastic.multiprocessing.errors import ChildFailedError
from torch.distributed.launcher.api import LaunchConfig, elastic_launch

_SEEDS_APART = 1009


@dataclass(frozen=True)
class Team:
    """The processes that train together.

    Attributes:
        rank: number of this process, 0 for the one that writes.
        size: number of processes.
    """

    rank: int = 0
    size: int = 1

    @property
    def leads(self) -> bool:
        """Whether this process prints and writes."""
        return self.rank == 0

    @property
    def ppo_settings(self) -> dict[str, int] | None:
        """What rsl_rl's PPO wants to know of the team; None if there is none."""
        if self.size == 1:
            return None
        return {"global_rank": self.rank, "world_size": self.size}

    def own_seed(self, seed: int) -> int:
        """A seed for each process: not all may collect the same data."""
        return seed + self.rank * _SEEDS_APART

    def agree(self, decision: bool) -> bool:
        """The decision of process 0, in all processes."""
        if self.size == 1:
            return decision
        shared = torch.tensor(decision)
        distributed.broadcast(shared, src=0)
        return bool(shared)

    def same(self, value: float) -> float:
        """The value of process 0, in all processes."""
        if self.size == 1:
            return value
        shared = torch.tensor(value, dtype=torch.float64)
        distributed.broadcast(shared, src=0)
        return float(shared)

    def share_networks(self, ppo: PPO) -> None:
        """Give all processes the networks of process 0."""
        if self.size > 1:
            ppo.broadcast_parameters()

    def share(self, module: nn.Module) -> None:
        """Give all processes the parameters and buffers of process 0."""
        if self.size > 1:
            for tensor in module.state_dict().values():
                distributed.broadcast(tensor, src=0)

    @torch.inference_mode()
    def average(self, tensors: Iterable[torch.Tensor]) -> None:
        """Replace each floating-point tensor by its mean over the processes."""
        if self.size == 1:
            return
        for tensor in tensors:
            if tensor.is_floating_point():
                distributed.all_reduce(tensor)
                tensor /= self.size

    def average_gradients(self, module: nn.Module) -> None:
        """Replace gradients by their mean over the processes."""
        gradients = (p.grad for p in module.parameters() if p.grad is not None)
        self.average(gradients)

    def average_buffers(self, *modules: nn.Module) -> None:
        """Average what modules count themselves: means and spreads of observations.

        rsl_rl averages gradients alone; without this each process would normalize its
        observations in its own way and so play its own policy.
        """
        for module in modules:
            self.average(module.buffers())


def team() -> Team:
    """The team that this process has joined; alone by default."""
    if not (distributed.is_available() and distributed.is_initialized()):
        return Team()
    return Team(distributed.get_rank(), distributed.get_world_size())


@contextmanager
def joined(device: torch.device | None = None) -> Iterator[Team]:
    """Join the processes that torchrun has started; alone without torchrun."""
    if int(os.environ.get("WORLD_SIZE", "1")) == 1 or distributed.is_initialized():
        yield team()
        return
    backend = "gloo"
    if device is not None and device.type == "cuda":
        torch.cuda.set_device(device)
        backend = "cpu:gloo,cuda:nccl"
    distributed.init_process_group(backend)
    try:
        yield team()
    finally:
        distributed.destroy_process_group()


def in_processes(count: int, command: Sequence[str]) -> int:
    """Run ``command`` in ``count`` processes that join each other; the exit status.

    torchrun without its command line, which takes options like --start for its own.
    When one process fails, the others are stopped.
    """
    os.environ["OMP_NUM_THREADS"] = str(max(1, (os.cpu_count() or 1) // count))
    config = LaunchConfig(
        min_nodes=1,
        max_nodes=1,
        nproc_per_node=count,
        rdzv_backend="c10d",
        rdzv_endpoint="localhost:0",
        max_restarts=0,
    )
    try:
        elastic_launch(config, command[0])(*command[1:])
    except ChildFailedError as error:
        return error.get_first_failure()[1].exitcode
    return 0


def threads_per_process() -> int:
    """Cores of this machine for each of its processes, at least one."""
    processes = int(os.environ.get("LOCAL_WORLD_SIZE", "1"))
    return max(1, (os.cpu_count() or 1) // processes)
