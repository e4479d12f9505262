"""`Learner`: from a batch to better weights, by PPO or A3C."""

from typing import Protocol

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn
from torch.nn.utils import clip_grad_norm_

from toponav.builders.explore_env import reward_key
from toponav.config import ExploreConfig, LossConfig
from toponav.keys import SCALED_REWARD
from toponav.modules import ActorCritic
from toponav.objectives import (
    A3CLoss,
    RecurrentPPOLoss,
    ReturnScale,
    SequenceMinibatches,
    SharedRMSProp,
)

_LOSSES = ("loss_objective", "loss_critic", "loss_entropy")
_LOGGED = (*_LOSSES, "entropy")


class Check(Protocol):
    """Refuses figures that are no numbers."""

    def __call__(self, figures: dict[str, float], update: int) -> None: ...


def falling(share: float, progress: float) -> float:
    """What is left of a coefficient: from 1 in a line to ``share`` at the end.

    Examples:
        >>> falling(0.2, 0.5)
        0.6
    """
    return 1 - (1 - share) * min(max(progress, 0.0), 1.0)


class Learner:
    """An explorer's network, its loss, its optimiser and the scale of its rewards.

    Args:
        config: settings of the run.
        policy: the network; it is trained in place.
        check: called before every step of the optimiser with the losses and the
            number of the update; raises if one is no number.

    Shape notation:
        E: environments of a batch.  T: decisions of a rollout.
    """

    def __init__(
        self, config: ExploreConfig, policy: ActorCritic, *, check: Check
    ) -> None:
        loss = config.loss
        self.config = loss
        self.policy = policy
        self.check = check
        self.updates = 0
        self.scale = ReturnScale(
            config.collect.envs,
            gamma=loss.gamma,
            enabled=loss.normalize_returns,
            reward=reward_key(config),
        )
        self.minibatches = SequenceMinibatches(
            loss.sequence, num_minibatches=loss.minibatches, seed=config.seed
        )
        self.loss = make_policy_loss(loss, policy)
        self.optimizer = make_policy_optimizer(loss, policy)

    @property
    def lr(self) -> float:
        """The learning rate of the last update."""
        return float(self.optimizer.param_groups[0]["lr"])

    def learn(self, batch: TensorDictBase, progress: float) -> dict[str, float]:
        """Learn from a batch ``[E, T]``, which gets the scaled reward.

        Args:
            batch: what a collector handed over.
            progress: how much of the run is over, in [0, 1].

        Returns:
            Means of the losses and of the policy's entropy over the batch's updates.
        """
        loss = self.config
        for group in self.optimizer.param_groups:
            group["lr"] = loss.lr * falling(loss.final_lr, progress)
        share = falling(loss.final_entropy, progress)
        self.loss.entropy_coeff.fill_(loss.entropy_coeff * share)
        device = next(self.policy.parameters()).device
        batch = self.scale(batch).to(device)
        if isinstance(self.loss, A3CLoss):
            return self._step(batch)
        batch = self.loss.estimate_advantage(batch)
        measured = [
            self._step(minibatch)
            for _ in range(loss.epochs)
            for minibatch in self.minibatches(batch)
        ]
        return {
            name: sum(one[name] for one in measured) / len(measured)
            for name in measured[0]
        }

    def _step(self, batch: TensorDictBase) -> dict[str, float]:
        losses = self.loss(batch)
        total: Tensor = sum(losses[name] for name in _LOSSES)
        measured = {name: float(losses[name].detach()) for name in _LOGGED}
        self.check(measured, self.updates)
        self.optimizer.zero_grad()
        total.backward()
        norm = clip_grad_norm_(self.policy.parameters(), self.config.max_grad_norm)
        self.check({"gradient_norm": float(norm)}, self.updates)
        self.optimizer.step()
        self.updates += 1
        return measured

    def state_dict(self) -> dict[str, object]:
        """Everything that another learner needs to go on, the network included."""
        return {
            "policy": self.policy.state_dict(),
            "optimizer": self.optimizer.state_dict(),
            "scale": self.scale.state_dict(),
            "minibatches": self.minibatches.state_dict(),
            "updates": self.updates,
        }

    def load_state_dict(self, state: dict[str, object]) -> None:
        """Go on where `state_dict` was taken."""
        for name in ("policy", "optimizer", "scale", "minibatches"):
            getattr(self, name).load_state_dict(state[name])
        self.updates = int(state["updates"])  # type: ignore[call-overload]


def make_policy_loss(
    config: LossConfig, policy: ActorCritic
) -> A3CLoss | RecurrentPPOLoss:
    """The loss that the settings name, over the scaled reward."""
    loss: A3CLoss | RecurrentPPOLoss
    if config.kind == "a3c":
        loss = A3CLoss(policy, gamma=config.gamma, lmbda=config.lmbda)
    else:
        loss = RecurrentPPOLoss(
            policy,
            gamma=config.gamma,
            lmbda=config.lmbda,
            clip_epsilon=config.clip_epsilon,
        )
    loss.entropy_coeff.fill_(config.entropy_coeff)
    loss.critic_coeff.fill_(config.critic_coeff)
    loss.set_keys(reward=SCALED_REWARD)
    return loss


def make_policy_optimizer(
    config: LossConfig, policy: nn.Module
) -> torch.optim.Optimizer:
    """RMSProp as in A3C (eqs. 3 and 4), or Adam for PPO."""
    if config.kind == "a3c":
        return SharedRMSProp(
            policy.parameters(), lr=config.lr, decay=config.decay, eps=config.eps
        )
    return torch.optim.Adam(policy.parameters(), lr=config.lr, eps=1e-5)
