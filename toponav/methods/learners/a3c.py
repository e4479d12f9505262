"""A3C: the paper's learner."""

from collections.abc import Iterable
from dataclasses import dataclass

import torch
from tensordict import TensorDictBase

from toponav.config import above, between
from toponav.methods.learners.actor_critic import ActorCriticConfig, ActorCriticLearner
from toponav.objectives import A3CLoss, SharedRMSProp


@dataclass
class A3CConfig(ActorCriticConfig):
    """Settings of ``loss=a3c``."""

    decay: float = between(0, 1)
    eps: float = above(0)


class A3CLearner(ActorCriticLearner):
    """One step over each batch, n-step returns, RMSProp (eqs. 1 to 4)."""

    schema = A3CConfig
    config: A3CConfig

    def make_loss(self) -> A3CLoss:
        return A3CLoss(self.policy)

    def make_optimizer(self) -> torch.optim.Optimizer:
        config, weights = self.config, self.parameters()
        return SharedRMSProp(weights, lr=config.lr, decay=config.decay, eps=config.eps)

    def minibatches(self, batch: TensorDictBase) -> Iterable[TensorDictBase]:
        return [batch]
