"""What PPO collects between two updates."""

from __future__ import annotations

from collections.abc import Generator

import torch
from rsl_rl.storage import RolloutStorage
from tensordict import TensorDict

from openclone.robot import g1


class Rollouts(RolloutStorage):
    """rsl_rl's storage, which shuffles once an update instead of once a minibatch.

    rsl_rl visits the same minibatches in every epoch, but puts them together anew each
    time.
    """

    def __init__(self, example: TensorDict, steps: int) -> None:
        """Room for ``steps`` control steps of observations like ``example (n,)``."""
        device = str(next(iter(example.values())).device)
        robots = example.batch_size[0]
        super().__init__("rl", robots, steps, example, [g1.NUM_JOINTS], device)

    def mini_batch_generator(
        self, num_mini_batches: int, num_epochs: int = 8
    ) -> Generator[RolloutStorage.Batch, None, None]:
        """Yield the shuffled minibatches, the same ones in every epoch."""
        size = self.num_envs * self.num_transitions_per_env // num_mini_batches
        order = torch.randperm(num_mini_batches * size, device=self.device)

        def shuffled(tensor: torch.Tensor) -> tuple[torch.Tensor, ...]:
            return tensor.flatten(0, 1).index_select(0, order).split(size)

        observations = {k: shuffled(v) for k, v in self.observations.to_dict().items()}
        parts = [
            shuffled(tensor)
            for tensor in (
                self.actions,
                self.values,
                self.advantages,
                self.returns,
                self.actions_log_prob,
            )
        ]
        parameters = [shuffled(p) for p in self.distribution_params or ()]
        batches = []
        for index in range(num_mini_batches):
            actions, values, advantages, returns, log_prob = (p[index] for p in parts)
            groups = {name: group[index] for name, group in observations.items()}
            batches.append(
                RolloutStorage.Batch(
                    observations=TensorDict(groups, batch_size=[size]),
                    actions=actions,
                    values=values,
                    advantages=advantages,
                    returns=returns,
                    old_actions_log_prob=log_prob,
                    old_distribution_params=tuple(p[index] for p in parameters),
                )
            )
        for _ in range(num_epochs):
            yield from batches
