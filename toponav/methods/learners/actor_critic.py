"""`ActorCriticLearner`: what PPO and A3C have in common."""

import math
from abc import abstractmethod
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from omegaconf import MISSING
from tensordict import TensorDictBase
from torch import Tensor, nn
from torch.nn.utils import clip_grad_norm_
from torchrl.objectives import LossModule, ValueEstimators

from toponav import keys
from toponav.builders import Learner, World
from toponav.config import ExploreConfig, LearnerConfig, at_least, between, require
from toponav.modules import ActorCritic
from toponav.objectives import ReturnScale


@dataclass
class ActorCriticConfig(LearnerConfig):
    """Settings that PPO and A3C share."""

    entropy_coeff: float = at_least(0)
    final_entropy: float = between(0, 1)
    critic_coeff: float = at_least(0)
    gamma: float = between(0, 1)
    lmbda: float = between(0, 1)
    normalize_returns: bool = MISSING

    def __post_init__(self) -> None:
        super().__post_init__()
        rule = "loss.gamma must be below 1 with loss.normalize_returns"
        require(self.gamma < 1 or not self.normalize_returns, rule, f"{self.gamma:g}")


def linear_decay(share: float, progress: float) -> float:
    """What is left of a coefficient: from 1 in a line to ``share`` at the end.

    Examples:
        >>> linear_decay(0.2, 0.5)
        0.6
    """
    return 1 - (1 - share) * min(max(progress, 0.0), 1.0)


class ActorCriticLearner(Learner):
    """A policy, its loss, its optimiser and the scale of its rewards."""

    schema = ActorCriticConfig
    config: ActorCriticConfig
    policy: ActorCritic
    #: What of its loss is minimised, as a sum, and what else is logged.
    losses: Sequence[str] = ("loss_objective", "loss_critic", "loss_entropy")
    logged: Sequence[str] = ("entropy",)
    saved: Sequence[str] = ("policy", "optimizer", "scale", "updates")

    def __init__(self, settings: ExploreConfig, world: World, **given: Any) -> None:
        super().__init__(settings, world, **given)
        config, self.updates = self.config, 0
        self.scale = ReturnScale(
            settings.collect.envs,
            gamma=config.gamma,
            enabled=config.normalize_returns,
            reward=self.reward,
        )
        self.loss = self.make_loss()
        self.loss.make_value_estimator(
            ValueEstimators.GAE, gamma=config.gamma, lmbda=config.lmbda
        )
        self.loss.critic_coeff.fill_(config.critic_coeff)
        self.loss.set_keys(reward=keys.SCALED_REWARD)
        self.optimizer = self.make_optimizer()
        seen = self.policy.in_keys
        later = [key for key in seen if key != keys.IS_INIT]
        later += [keys.DONE, keys.TERMINATED, self.reward]
        now = [*seen, keys.ACTION, keys.ACTION_LOG_PROB, keys.STATE_VALUE]
        self.in_keys = [*now, *(("next", key) for key in later)]

    @staticmethod
    def make_policy(settings: ExploreConfig, world: World) -> ActorCritic:
        policy = settings.policy
        return ActorCritic(
            input=policy.input,  # type: ignore[arg-type]
            embedding_dim=settings.model.embedding_dim,
            image_size=(policy.view_size, policy.view_size),
            num_actions=world.spec.num_actions,
            code_dim=policy.hidden,
            hidden_dim=policy.hidden,
            layers=policy.layers,
        )

    def parameters(self) -> list[nn.Parameter]:
        """All that is trained."""
        return list(self.policy.parameters())

    @abstractmethod
    def make_loss(self) -> LossModule:
        """The loss of `policy`."""

    @abstractmethod
    def make_optimizer(self) -> torch.optim.Optimizer:
        """The optimiser of `policy`."""

    @abstractmethod
    def minibatches(self, batch: TensorDictBase) -> Iterable[TensorDictBase]:
        """The pieces of a batch ``[E, T]``, one for each step of the optimiser."""

    def extend(self, batch: TensorDictBase) -> Mapping[str, float]:
        """Learn from a batch ``[E, T]``, which gets the scaled reward.

        Returns:
            Means of the losses and of the policy's entropy over the batch's updates,
            and the learning rate.
        """
        lr = self.schedule()
        # Nothing but what it reads goes to its device.
        wanted = [*self.in_keys, ("next", keys.SCALED_REWARD)]
        pieces = self.minibatches(self.scale(batch).select(*wanted).to(self.device))
        measured = [self._step(piece) for piece in pieces]
        means = {
            name: sum(one[name] for one in measured) / len(measured)
            for name in measured[0]
        }
        return means | {"lr": lr}

    def schedule(self) -> float:
        """Set what falls over the run; returns the learning rate."""
        config, progress = self.config, self.progress()
        lr = config.lr * linear_decay(config.final_lr, progress)
        for group in self.optimizer.param_groups:
            group["lr"] = lr
        share = linear_decay(config.final_entropy, progress)
        self.loss.entropy_coeff.fill_(config.entropy_coeff * share)
        return lr

    def descend(self, loss: Tensor, measured: Mapping[str, float]) -> None:
        """One step of the optimiser, unless a number of it is not finite."""
        self.check(measured, self.updates)
        self.optimizer.zero_grad()
        loss.backward()
        norm = clip_grad_norm_(self.parameters(), self.config.max_grad_norm)
        self.check({"gradient_norm": float(norm)}, self.updates)
        self.optimizer.step()
        self.updates += 1

    def _step(self, batch: TensorDictBase) -> dict[str, float]:
        try:
            losses = self.loss(batch)
        except FloatingPointError:
            self.check({"hidden_state": math.nan}, self.updates)
            raise
        total: Tensor = sum(losses[name] for name in self.losses)
        names = (*self.losses, *self.logged)
        # Read at once: a GPU is waited for each time.
        numbers = torch.stack([losses[name].detach() for name in names]).tolist()
        measured = dict(zip(names, numbers, strict=True))
        # What is only logged may be a share of none.
        self.descend(total, {name: measured[name] for name in self.losses})
        return measured
