"""PPO: TorchRL's clipped loss over sequences."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import torch
from tensordict import TensorDictBase

from toponav.builders import World
from toponav.config import ExploreConfig, at_least, between, require, require_multiple
from toponav.methods.learners.actor_critic import ActorCriticConfig, ActorCriticLearner
from toponav.objectives import RecurrentPPOLoss, SequenceMinibatches


@dataclass
class PPOConfig(ActorCriticConfig):
    """Settings of ``loss=ppo``."""

    clip_epsilon: float = between(0.001, 1)
    epochs: int = at_least(1)
    minibatches: int = at_least(1)
    sequence: int = at_least(1)

    def __post_init__(self) -> None:
        super().__post_init__()
        require_multiple("loss.rollout", self.rollout, "loss.sequence", self.sequence)

    def check(self, num_envs: int) -> None:
        """Refuse settings that cut a batch into more minibatches than sequences."""
        most = num_envs * self.rollout // self.sequence
        rule = f"loss.minibatches must be at most {most}, the sequences of a batch"
        require(self.minibatches <= most, rule, self.minibatches)


class PPOLearner(ActorCriticLearner):
    """Several passes over a batch in minibatches of sequences, with Adam."""

    schema = PPOConfig
    saved = (*ActorCriticLearner.saved, "sequences")
    config: PPOConfig
    loss: RecurrentPPOLoss

    def __init__(self, settings: ExploreConfig, world: World, **kwargs: Any) -> None:
        super().__init__(settings, world, **kwargs)
        config = self.config
        self.sequences = SequenceMinibatches(
            config.sequence, num_minibatches=config.minibatches, seed=settings.seed
        )

    def make_loss(self) -> RecurrentPPOLoss:
        return RecurrentPPOLoss(self.policy, clip_epsilon=self.config.clip_epsilon)

    def make_optimizer(self) -> torch.optim.Optimizer:
        return torch.optim.Adam(self.policy.parameters(), lr=self.config.lr, eps=1e-5)

    def minibatches(self, batch: TensorDictBase) -> Iterator[TensorDictBase]:
        # Each pass copies what it cuts.
        batch = self.loss.estimate_advantage(batch).select(*self.loss.in_keys)
        for _ in range(self.config.epochs):
            yield from self.sequences(batch)
