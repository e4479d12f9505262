"""`A3CLoss`: the advantage actor-critic over slices of experience."""

from dataclasses import dataclass
from typing import Any, Literal, cast, get_args

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from tensordict.nn import (
    ProbabilisticTensorDictSequential,
    TensorDictModuleBase,
    dispatch,
)
from torch import Tensor
from torch.nn import functional as F  # noqa: N812
from torchrl.objectives import A2CLoss, LossModule, ValueEstimators
from torchrl.objectives.utils import distance_loss

from toponav.keys import IS_INIT, LOGITS
from toponav.objectives.actor_critic_loss import (
    GAEMixin,
    RecurrentActorCritic,
    action_numbers,
    bootstrapped_advantage,
    read_entry,
    under_next,
)

Reduction = Literal["unroll", "mean", "sum", "none"]


class A3CLoss(GAEMixin, LossModule):
    """Policy gradient, critic and entropy of one slice of experience, ``[*B, T]``.

    ``loss_objective`` is ``-log pi(a|s) A``, ``loss_critic`` is ``critic_coeff * (R -
    V)^2`` and ``loss_entropy`` is ``-entropy_coeff`` times the entropy; their sum is to
    be minimised. ``entropy`` is the mean entropy in nats. ``R`` is the n-step return
    and ``A = R - V`` unless ``make_value_estimator`` chooses another estimator (see
    `bootstrapped_advantage`); an advantage and a value target in the batch are used as
    they are.

    Reference:
        Mnih et al., "Asynchronous Methods for Deep Reinforcement Learning" (2016);
        the paper, eqs. 1 and 2.

    Args:
        actor_network: a ``ProbabilisticActor``; or, alone, a `RecurrentActorCritic`.
        critic_network: the value operator.
        entropy_coeff: weight of the entropy bonus; can be assigned while training.
        critic_coeff: weight of the critic's squared error.
        reduction: ``"unroll"`` sums over the slice and takes the mean over its rows, as
            A3C does; or TorchRL's ``"mean"``, ``"sum"`` or ``"none"``.

    Examples:
        >>> from toponav.modules import ActorCritic
        >>> network = ActorCritic(num_actions=4, input="embedding", embedding_dim=8)
        >>> loss = A3CLoss(network).make_value_estimator(gamma=0.9)
        >>> loss.set_keys(reward="intrinsic_reward")
    """

    @dataclass
    class _AcceptedKeys(A2CLoss._AcceptedKeys):
        logits: NestedKey = LOGITS
        is_init: NestedKey = IS_INIT

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
        if reduction not in get_args(Reduction):
            raise ValueError(
                f"reduction must be one of {get_args(Reduction)}, got {reduction!r}."
            )
        if critic_network is None and not hasattr(actor_network, "unroll"):
            raise ValueError(
                "critic_network must be given with an actor_network without unroll(), "
                f"got {type(actor_network).__name__} alone."
            )
        network: Any = actor_network
        self.actor_network = network
        self.critic_network = critic_network
        self.reduction = reduction
        self.register_coeff_buffer("entropy_coeff", entropy_coeff)
        self.register_coeff_buffer("critic_coeff", critic_coeff)
        if critic_network is not None:
            (action,) = network.dist_sample_keys
            self.set_keys(action=action)

    @property
    def in_keys(self) -> list[NestedKey]:
        keys = self.tensor_keys
        actor, judge = self.actor_network, self.critic_network
        judge = actor if judge is None else judge
        now = dict.fromkeys([*actor.in_keys, *judge.in_keys])
        # What a network reads of decisions but not under "next".
        following = [key for key in judge.in_keys if key != keys.is_init]
        following += [keys.reward, keys.done, keys.terminated]
        return [*now, keys.action, *(under_next(key) for key in following)]

    @dispatch  # type: ignore[untyped-decorator]
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        keys = self.tensor_keys
        log_prob, entropy, state_value = self._evaluate(tensordict)
        advantage = tensordict.get(keys.advantage, None)
        if advantage is None:
            advantage, value_target = bootstrapped_advantage(
                self, tensordict, state_value, self._next_values
            )
        else:
            value_target = read_entry(tensordict, keys.value_target, "value_target")
        critic = distance_loss(value_target, state_value, "l2")
        losses = {
            "loss_objective": -(log_prob * advantage.squeeze(-1)),
            "loss_critic": self.critic_coeff * critic.squeeze(-1),
            "loss_entropy": -self.entropy_coeff * entropy,
        }
        reduced = {name: self._reduce(one, tensordict) for name, one in losses.items()}
        entropy = entropy.detach()
        entropy = entropy if self.reduction == "none" else entropy.mean()
        return TensorDict({**reduced, "entropy": entropy})

    def _evaluate(self, tensordict: TensorDictBase) -> tuple[Tensor, Tensor, Tensor]:
        keys = self.tensor_keys
        action = read_entry(tensordict, keys.action, "action")
        if self.critic_network is None:
            unrolled = self.actor_network.unroll(tensordict)
            log_probs = F.log_softmax(unrolled.get(keys.logits).float(), -1)
            *shape, num_actions = log_probs.shape
            numbers = action_numbers(action, num_actions, torch.Size(shape))
            log_prob = log_probs.gather(-1, numbers.unsqueeze(-1)).squeeze(-1)
            entropy = -(log_probs.exp() * log_probs).sum(-1)
            return log_prob, entropy, unrolled.get(keys.value).float()
        # Shallow copies, so that the caller's batch is left alone.
        policy = self.actor_network.get_dist(tensordict.copy())
        # Not batch_shape and event_shape: TorchRL's one-hot policies have no latter.
        expected = policy.mode.shape
        if action.shape != expected:
            raise ValueError(
                f"action must have the shape {list(expected)} of the policy's "
                f"{type(policy).__name__}, got {list(action.shape)}."
            )
        state_value = self.critic_network(tensordict.copy()).get(keys.value)
        return policy.log_prob(action), policy.entropy(), state_value

    def _next_values(self, tensordict: TensorDictBase) -> Tensor:
        if self.critic_network is None:
            return cast(Tensor, self.actor_network.next_values(tensordict))
        following = self.critic_network(tensordict.get("next").copy())
        return cast(Tensor, following.get(self.tensor_keys.value))

    def _reduce(self, loss: Tensor, tensordict: TensorDictBase) -> Any:
        if self.reduction == "unroll":
            kept = self._reduce_loss(loss, tensordict, reduction="none")
            return kept.sum(-1).mean()
        return self._reduce_loss(loss, tensordict)
