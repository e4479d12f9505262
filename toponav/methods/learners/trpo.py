"""TRPO: natural gradient steps within a trust region, the critic apart."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn

from toponav.builders import World
from toponav.config import ExploreConfig, above, at_least, between, require
from toponav.methods.learners.actor_critic import ActorCriticConfig, ActorCriticLearner
from toponav.modules import ActorCritic
from toponav.objectives import SequenceMinibatches, TRPOLoss, TrustRegion


@dataclass
class TRPOConfig(ActorCriticConfig):
    """Settings of ``loss=trpo``."""

    max_kl: float = above(0)
    cg_iterations: int = at_least(1)
    damping: float = at_least(0)
    backtracks: int = at_least(1)
    fisher_fraction: float = between(0.001, 1)
    critic_epochs: int = at_least(1)
    critic_minibatches: int = at_least(1)

    def check(self, num_envs: int) -> None:
        """Refuse settings that cut a batch into more minibatches than decisions."""
        most = num_envs * self.rollout
        rule = f"loss.critic_minibatches must be at most {most}, a batch's decisions"
        require(self.critic_minibatches <= most, rule, self.critic_minibatches)


class TRPOLearner(ActorCriticLearner):
    """One step of the policy over each batch, then several passes of the critic.

    Trunk and LSTM belong to the policy: the critic is a linear head on what they were
    trained for, and the optimiser is its own. It begins at 0 everywhere, so that the
    policy stays as it is until there is a reward.
    """

    schema = TRPOConfig
    saved = (*ActorCriticLearner.saved, "passes")
    config: TRPOConfig
    loss: TRPOLoss

    def __init__(self, settings: ExploreConfig, world: World, **given: Any) -> None:
        super().__init__(settings, world, **given)
        config = self.config
        self.region = TrustRegion(
            self.loss.policy_parameters(),
            max_kl=config.max_kl,
            iterations=config.cg_iterations,
            damping=config.damping,
            backtracks=config.backtracks,
        )
        self.passes = SequenceMinibatches(
            1, num_minibatches=config.critic_minibatches, seed=settings.seed
        )

    @staticmethod
    def make_policy(settings: ExploreConfig, world: World) -> ActorCritic:
        policy = ActorCriticLearner.make_policy(settings, world)
        # The errors of a critic with other weights would be advantages where nothing is
        # paid, and normalised they are as large as those of a reward: the policy would
        # take a whole step into a random direction with each batch.
        nn.init.zeros_(policy.critic.weight)
        nn.init.zeros_(policy.critic.bias)
        return policy

    def make_loss(self) -> TRPOLoss:
        return TRPOLoss(self.policy)

    def make_optimizer(self) -> torch.optim.Optimizer:
        return torch.optim.Adam(self.loss.critic_parameters(), lr=self.config.lr)

    def minibatches(self, batch: TensorDictBase) -> Iterator[TensorDictBase]:
        """The critic's; the LSTM's outputs are computed once for all passes."""
        inputs = self.loss.critic_inputs(batch)
        for _ in range(self.config.critic_epochs):
            yield from self.passes(inputs)

    def extend(self, batch: TensorDictBase) -> Mapping[str, float]:
        """Learn from a batch ``[E, T]``, which gets the scaled reward.

        Returns:
            Losses, entropy and divergence after the policy's step, the share of the
            longest step that was taken, and the critic's learning rate.
        """
        lr = self.schedule()
        batch = self.loss.prepare(self.scale(batch).to(self.device))
        # The Fisher matrix of every n-th environment.
        few = batch[:: max(round(1 / self.config.fisher_fraction), 1)]

        def evaluate() -> tuple[Tensor, Tensor]:
            terms = self.loss.policy_terms(batch)
            return terms["loss_objective"] + terms["loss_entropy"], terms["kl"]

        def curvature() -> Tensor:
            kl: Tensor = self.loss.policy_terms(few)["kl"]
            return kl

        taken = self.region.step(evaluate, curvature)
        measured = {"kl": taken["kl"], "step_share": taken["step"]}
        with torch.no_grad():
            terms = self.loss.policy_terms(batch)
        for name in ("loss_objective", "loss_entropy", "entropy"):
            measured[name] = float(terms[name])
        self.check(measured, self.updates)
        losses = [self._fit_critic(piece) for piece in self.minibatches(batch)]
        return measured | {"loss_critic": sum(losses) / len(losses), "lr": lr}

    def _fit_critic(self, piece: TensorDictBase) -> float:
        loss = self.loss.critic_loss(piece)
        self.descend(loss, {"loss_critic": float(loss.detach())})
        return float(loss.detach())
