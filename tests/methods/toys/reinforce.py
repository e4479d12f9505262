"""A toy learner, as docs/extending.md has it."""

from collections.abc import Iterable
from dataclasses import dataclass

import torch
from tensordict import TensorDictBase
from torchrl.objectives import LossModule

from toponav.methods.learners.actor_critic import ActorCriticConfig, ActorCriticLearner
from toponav.objectives import A3CLoss


@dataclass
class ReinforceConfig(ActorCriticConfig):
    """Settings of ``loss=reinforce``."""


class ReinforceLearner(ActorCriticLearner):
    """One plain gradient step a batch."""

    schema = ReinforceConfig

    def make_loss(self) -> LossModule:
        return A3CLoss(self.policy)

    def make_optimizer(self) -> torch.optim.Optimizer:
        return torch.optim.SGD(self.policy.parameters(), lr=self.config.lr)

    def minibatches(self, batch: TensorDictBase) -> Iterable[TensorDictBase]:
        return [batch]
