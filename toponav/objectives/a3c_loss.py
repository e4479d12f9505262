"""`A3CLoss`: the advantage actor-critic over recurrent slices of experience."""

from dataclasses import dataclass
from typing import Literal, get_args

from tensordict import NestedKey, TensorDict, TensorDictBase
from tensordict.nn import dispatch
from torch import Tensor
from torch.nn import functional as F  # noqa: N812
from torchrl.objectives import LossModule

from toponav.keys import ACTION, DONE, IS_INIT, LOGITS, REWARD, STATE_VALUE, TERMINATED
from toponav.objectives.bootstrapped_gae import (
    RecurrentActorCritic,
    bootstrapped_gae,
    check_share,
)

Reduction = Literal["unroll", "mean", "sum", "none"]


class A3CLoss(LossModule):
    """Policy gradient, critic and entropy of one slice, in one pass of the network.

    ``loss_objective`` is ``-log pi(a|s) A``, ``loss_critic`` is
    ``critic_coeff * (R - V)^2`` and ``loss_entropy`` is ``-entropy_coeff`` times the
    policy's entropy; their sum is to be minimised. ``entropy`` is the mean entropy in
    nats, without gradient. ``R`` is the n-step return over the slice and ``A = R - V``,
    both without gradient, see `bootstrapped_gae`; ``lmbda`` below 1 gives the
    generalised advantage instead.

    The slice is what a collector yields: ``[*B, T]`` decisions, time last, the LSTM's
    state stored with the first one. The network stays an ordinary submodule, there is
    no target network, and no value estimator to make: the returns come from the values
    of this very pass, which an estimator with its own pass would compute again.

    Reference:
        Mnih et al., "Asynchronous Methods for Deep Reinforcement Learning" (2016);
        the paper, eqs. 1 and 2.

    Args:
        actor_critic: see `RecurrentActorCritic`.
        gamma: discount per decision.
        lmbda: 1 for n-step returns.
        entropy_coeff: weight of the entropy bonus; can be assigned while training.
        critic_coeff: weight of the critic.
        reduction: ``"unroll"`` sums over the slice and takes the mean over its rows, as
            A3C does, so that the constant inside the optimiser's root and a bound on
            the gradient's norm mean what they mean there; ``"mean"`` and ``"sum"`` over
            everything; ``"none"``.

    Raises:
        ValueError: if an argument is out of range; from ``forward``, if reward or ends
            differ in shape from the values.

    Examples:
        >>> import torch
        >>> from toponav.modules import ActorCritic
        >>> network = ActorCritic(input="embedding", embedding_dim=8)
        >>> state = {
        ...     "embedding": torch.randn(4, 20, 8),
        ...     "previous_action": torch.randint(7, (4, 20, 1)),
        ...     "previous_reward": torch.zeros(4, 20, 1),
        ...     "recurrent_state": network.initial_state(4, 20),
        ... }
        >>> false = torch.zeros(4, 20, 1, dtype=torch.bool)
        >>> following = {**state, "intrinsic_reward": torch.ones(4, 20, 1)}
        >>> following |= {"done": false, "terminated": false}
        >>> batch = TensorDict({**state, "is_init": false, "next": following}, [4, 20])
        >>> batch["action"] = torch.randint(6, (4, 20))
        >>> loss = A3CLoss(network)
        >>> loss.set_keys(reward="intrinsic_reward")
        >>> loss(batch)["entropy"].round(decimals=2)  # log 6: it knows nothing yet
        tensor(1.7900)

    Shape notation:
        B: batch of envs.  T: decisions in the slice.
    """

    @dataclass
    class _AcceptedKeys:
        """Keys that ``set_keys`` can change.

        Attributes:
            action: int64 ``[*B, T]``; the action taken.
            reward: float ``[*B, T, 1]`` under ``"next"``.
            done: bool ``[*B, T, 1]`` under ``"next"``.
            terminated: bool ``[*B, T, 1]`` under ``"next"``.
        """

        action: NestedKey = ACTION
        reward: NestedKey = REWARD
        done: NestedKey = DONE
        terminated: NestedKey = TERMINATED

    default_keys = _AcceptedKeys
    tensor_keys: _AcceptedKeys

    out_keys = ["loss_objective", "loss_critic", "loss_entropy", "entropy"]
    _schedulable_buffers = frozenset({"entropy_coeff", "critic_coeff"})
    entropy_coeff: Tensor
    critic_coeff: Tensor

    def __init__(
        self,
        actor_critic: RecurrentActorCritic,
        *,
        gamma: float = 0.99,
        lmbda: float = 1.0,
        entropy_coeff: float = 0.01,
        critic_coeff: float = 0.5,
        reduction: Reduction = "unroll",
    ) -> None:
        super().__init__()
        if reduction not in get_args(Reduction):
            raise ValueError(
                f"reduction must be one of {get_args(Reduction)}, got {reduction!r}."
            )
        self.actor_critic = actor_critic
        self.gamma = check_share("gamma", gamma)
        self.lmbda = check_share("lmbda", lmbda)
        self.register_coeff_buffer("entropy_coeff", entropy_coeff)
        self.register_coeff_buffer("critic_coeff", critic_coeff)
        self.reduction = reduction

    @property
    def functional(self) -> bool:
        return False

    @property
    def in_keys(self) -> list[NestedKey]:
        """What the network reads now and where it bootstraps, the action and ends."""
        network, keys = self.actor_critic.in_keys, self.tensor_keys
        following = [key for key in network if key != IS_INIT]
        following += [keys.reward, keys.done, keys.terminated]
        return [*network, keys.action, *(under_next(key) for key in following)]

    def _forward_value_estimator_keys(self, **kwargs: NestedKey) -> None:
        pass

    @dispatch  # type: ignore[untyped-decorator]
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        keys = self.tensor_keys
        unrolled = self.actor_critic.unroll(tensordict)
        state_value = unrolled.get(STATE_VALUE).float()
        advantage, value_target = bootstrapped_gae(
            tensordict,
            state_value,
            self.actor_critic,
            gamma=self.gamma,
            lmbda=self.lmbda,
            reward=keys.reward,
            done=keys.done,
            terminated=keys.terminated,
        )
        log_probs = F.log_softmax(unrolled.get(LOGITS).float(), -1)
        action = tensordict.get(keys.action).unsqueeze(-1)
        log_prob = log_probs.gather(-1, action)
        entropy = -(log_probs.exp() * log_probs).sum(-1)
        objective = -(log_prob * advantage).squeeze(-1)
        critic = F.mse_loss(state_value, value_target, reduction="none").squeeze(-1)
        mean_entropy = entropy.detach()
        if self.reduction != "none":
            mean_entropy = mean_entropy.mean()
        return TensorDict(
            {
                "loss_objective": self._reduce(objective),
                "loss_critic": self._reduce(self.critic_coeff * critic),
                "loss_entropy": self._reduce(-self.entropy_coeff * entropy),
                "entropy": mean_entropy,
            }
        )

    def _reduce(self, loss: Tensor) -> Tensor:
        """Reduce ``[*B, T]`` as ``reduction`` says."""
        if self.reduction == "unroll":
            return loss.sum(-1).mean()
        reduced: Tensor = self._reduce_loss(loss)
        return reduced


def under_next(key: NestedKey) -> NestedKey:
    """The key under ``"next"``."""
    return ("next", key) if isinstance(key, str) else ("next", *key)
