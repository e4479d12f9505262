"""`A3CLoss`: the advantage actor-critic over slices of experience."""

from dataclasses import dataclass
from typing import Any, Literal, get_args

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from tensordict.nn import (
    ProbabilisticTensorDictSequential,
    TensorDictModuleBase,
    dispatch,
)
from torch import Tensor
from torch.nn import functional as F  # noqa: N812
from torchrl.objectives import LossModule, ValueEstimators
from torchrl.objectives.utils import distance_loss

from toponav import keys
from toponav.objectives.actions import (
    action_log_prob,
    action_numbers,
    require_one_action,
)
from toponav.objectives.actor_critic_loss import (
    GAEMixin,
    RecurrentActorCritic,
    bootstrapped_advantage,
    read_entry,
    require_critic,
    require_recurrent,
    require_slices,
    valid_decisions,
)

Reduction = Literal["unroll", "mean", "sum", "none"]


class A3CLoss(GAEMixin, LossModule):
    """Policy gradient, critic and entropy of slices of experience, ``[*B, T]``.

    ``loss_objective`` is ``-log pi(a|s) A``, ``loss_critic`` is ``critic_coeff * (R -
    V)^2`` and ``loss_entropy`` is ``-entropy_coeff`` times the entropy; their sum is to
    be minimised. ``entropy`` is the mean entropy in nats. ``R`` is the n-step return
    and ``A = R - V`` unless ``make_value_estimator`` chooses another estimator (see
    `bootstrapped_advantage`); an advantage and a value target in the batch are used as
    they are, ``[*B, T, 1]`` both. Padding, by TorchRL's masks, counts for nothing.

    Names, keys and state dict are those of TorchRL's ``A2CLoss(functional=False)``, but
    the last dimension is time, because each row bootstraps once, from the state after
    it; one action, and an entropy in closed form, are needed.

    Reference:
        Mnih et al., "Asynchronous Methods for Deep Reinforcement Learning" (2016);
        the paper, eqs. 1 and 2.

    Args:
        actor_network: a ``ProbabilisticActor``; or, alone, a `RecurrentActorCritic`.
        critic_network: the value operator.
        entropy_coeff, critic_coeff: weights that can be assigned while training.
        reduction: ``"unroll"`` sums over the slice and takes the mean over its rows, as
            A3C does; or TorchRL's ``"mean"``, ``"sum"`` or ``"none"``.

    Examples:
        >>> from toponav.modules import ActorCritic
        >>> network = ActorCritic(num_actions=4, input="embedding", embedding_dim=8)
        >>> loss = A3CLoss(network).make_value_estimator(gamma=0.9)
        >>> loss.set_keys(reward="intrinsic_reward")
    """

    @dataclass
    class _AcceptedKeys:
        action: NestedKey = keys.ACTION
        reward: NestedKey = keys.REWARD
        done: NestedKey = keys.DONE
        terminated: NestedKey = keys.TERMINATED
        value: NestedKey = keys.STATE_VALUE
        advantage: NestedKey = keys.ADVANTAGE
        value_target: NestedKey = keys.VALUE_TARGET
        # What a RecurrentActorCritic unrolls.
        logits: NestedKey = keys.LOGITS

    default_keys = _AcceptedKeys
    #: The n-step return.
    default_value_estimator = ValueEstimators.TD1
    functional = False
    out_keys = ["loss_objective", "loss_critic", "loss_entropy", "entropy"]
    _schedulable_buffers = frozenset({"entropy_coeff", "critic_coeff"})
    entropy_coeff: Tensor
    critic_coeff: Tensor

    def __init__(
        self,
        actor_network: ProbabilisticTensorDictSequential | RecurrentActorCritic,
        critic_network: TensorDictModuleBase | None = None,
        *,
        entropy_coeff: float = 0.01,
        critic_coeff: float = 0.5,
        reduction: Reduction = "unroll",
    ) -> None:
        super().__init__()
        if reduction not in (choices := get_args(Reduction)):
            raise ValueError(f"reduction must be one of {choices}, got {reduction!r}.")
        if critic_network is None:
            name = "actor_network without a critic_network"
            require_recurrent(actor_network, name, "in_keys", "unroll", "next_values")
        network: Any = actor_network
        self.actor_network = network
        self.critic_network = critic_network
        self.reduction = reduction
        self.register_coeff_buffer("entropy_coeff", entropy_coeff)
        self.register_coeff_buffer("critic_coeff", critic_coeff)
        if critic_network is not None:
            self.set_keys(action=require_one_action(network))
            require_critic(critic_network)

    @property
    def actor_critic(self) -> Any:
        """The network that is actor and critic; ``None`` if there is one for each."""
        return self.actor_network if self.critic_network is None else None

    @property
    def in_keys(self) -> list[NestedKey]:
        return self._keys_of_slices(self.tensor_keys.action)

    @dispatch  # type: ignore[untyped-decorator]
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        require_slices(tensordict)
        return self._losses(tensordict, *self._evaluate(tensordict))

    def _losses(
        self,
        tensordict: TensorDictBase,
        log_prob: Tensor,
        entropy: Tensor,
        state_value: Tensor,
    ) -> TensorDict:
        named = self.tensor_keys
        if tensordict.get(named.advantage, None) is None:
            advantage, value_target = bootstrapped_advantage(
                self, tensordict, state_value, self._next_values
            )
        else:
            advantage, value_target = (
                read_entry(tensordict, getattr(named, name), name, state_value.shape)
                for name in ("advantage", "value_target")
            )
        critic = distance_loss(value_target, state_value, "l2")
        losses = {
            "loss_objective": -(log_prob * advantage.squeeze(-1)),
            "loss_critic": self.critic_coeff * critic.squeeze(-1),
            "loss_entropy": -self.entropy_coeff * entropy,
        }
        reduced = {name: self._reduce(one, tensordict) for name, one in losses.items()}
        reduction = "none" if self.reduction == "none" else "mean"
        entropy = self._reduce_loss(entropy.detach(), tensordict, reduction=reduction)
        return TensorDict({**reduced, "entropy": entropy})

    def _evaluate(self, tensordict: TensorDictBase) -> tuple[Tensor, Tensor, Tensor]:
        if self.critic_network is None:
            unrolled = self.actor_network.unroll(tensordict)
            return self._evaluate_unrolled(tensordict, unrolled)
        action = read_entry(tensordict, self.tensor_keys.action, "action")
        # A shallow copy, so that the caller's batch is left alone.
        policy = self.actor_network.get_dist(tensordict.copy())
        log_prob = action_log_prob(policy, action, tensordict.batch_size)
        return log_prob, policy.entropy(), self._judge(tensordict)

    def _evaluate_unrolled(
        self, tensordict: TensorDictBase, unrolled: TensorDictBase
    ) -> tuple[Tensor, Tensor, Tensor]:
        named = self.tensor_keys
        action = read_entry(tensordict, named.action, "action")
        logits = read_entry(unrolled, named.logits, "logits")
        state_value = read_entry(unrolled, named.value, "value").float()
        log_probs = F.log_softmax(logits.float(), -1)
        *shape, num_actions = log_probs.shape
        valid = valid_decisions(self, tensordict)
        numbers = action_numbers(action, num_actions, torch.Size(shape), valid=valid)
        log_prob = log_probs.gather(-1, numbers.unsqueeze(-1)).squeeze(-1)
        entropy = -(log_probs.exp() * log_probs).sum(-1)
        return log_prob, entropy, state_value

    def _reduce(self, loss: Tensor, tensordict: TensorDictBase) -> Any:
        if self.reduction != "unroll":
            return self._reduce_loss(loss, tensordict)
        sums = self._reduce_loss(loss, tensordict, reduction="none").sum(-1)
        valid = valid_decisions(self, tensordict)
        if valid is None:
            return sums.mean()
        # A row of padding alone is none.
        return sums.sum() / valid.any(-1).sum().clamp_min(1)
