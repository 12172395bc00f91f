"""Robots that begin a roll-out alike and show what their actions brought.

Without any exploration the advantages of PPO vary as much as with it: nearly all of
their variance is what the critic cannot foresee of a motion, and has nothing to do with
the actions. Robots that begin a roll-out in one state share it. The mean advantage of
the others is a baseline which takes most of it away and, as their noise is their own,
adds no bias (the "vine" of TRPO, Schulman et al. 2015, section 5.2; leave one out, as
in Kool et al. 2019).
"""

from __future__ import annotations

import torch

from openclone.errors import InputError

_BOUND = 1.0
"""Standard deviations beyond which advantages count no more: few large ones, mostly of
falls, would outweigh all others."""


def leaders(count: int, size: int, device: torch.device | None = None) -> torch.Tensor:
    """``(count,)``: for each robot the one that its group of ``size`` begins like.

    Raises:
        InputError: the groups would differ in size.
    """
    if size < 2 or count % size:
        raise InputError(
            f"{count} robots cannot form groups of {size} twins",
            remedy="use a number of robots that is a multiple of `twins`, 2 or more",
        )
    return torch.arange(count // size, device=device).repeat(size)


def compared(advantages: torch.Tensor, done: torch.Tensor, size: int) -> torch.Tensor:
    """Advantages beyond those of the group's others.

    Args:
        advantages: (T, n), not normalized; robots in the order of `leaders`.
        done: (T, n) bool, an episode ended in the step: the robot is no twin any more.
        size: of the groups.

    Returns:
        (T, n). After its end a robot's advantage stands as it was, and the others are
        compared with those that are left.
    """
    steps, count = advantages.shape
    groups = advantages.view(steps, size, count // size)
    ended = done.view_as(groups).cumsum(0) - done.view_as(groups).long()
    alike = (ended == 0).to(groups)
    others = alike.sum(1, keepdim=True) - alike
    total = (groups * alike).sum(1, keepdim=True) - groups * alike
    return (groups - alike * total / others.clamp(min=1)).view(steps, count)


def bounded(advantages: torch.Tensor) -> torch.Tensor:
    """The same within `_BOUND`, then with mean 0 and standard deviation 1, ``(T, n)``.

    Unlike the comparison this is not free of bias: falls count for less than they cost.
    """
    bound = _BOUND * advantages.std()
    advantages = advantages.clamp(-bound, bound)
    return (advantages - advantages.mean()) / (advantages.std() + 1e-8)
