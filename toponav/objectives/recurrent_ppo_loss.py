"""`RecurrentPPOLoss`: TorchRL's clipped loss over one pass of a recurrent network."""

from typing import Literal, get_args

import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModule, dispatch
from torch.distributions import Categorical
from torchrl.modules import ProbabilisticActor
from torchrl.objectives import ClipPPOLoss

from toponav.keys import ACTION, ACTION_LOG_PROB, HIDDEN, LOGITS, STATE_VALUE
from toponav.objectives.bootstrapped_gae import (
    RecurrentActorCritic,
    bootstrapped_gae,
    check_share,
)

Reduction = Literal["mean", "sum"]
#: The LSTM's output after a decision is its next hidden state: the heads read it.
_OUTPUT: NestedKey = ("next", *HIDDEN)


class RecurrentPPOLoss(ClipPPOLoss):
    """Clipped policy loss over sequences with a state of the LSTM at their start.

    The trunk and the LSTM run once over the sequences; ``ClipPPOLoss`` then sees two
    linear heads on their outputs, through which its gradients reach the whole network.
    Call `estimate_advantage` once on a collected batch, before the passes over its
    minibatches: the advantage rests on the values stored at collection. A batch without
    an advantage gets one in ``forward``, without normalisation.

    Its ``out_keys`` and ``set_keys`` are those of ``ClipPPOLoss``: the losses
    ``loss_objective``, ``loss_critic`` and ``loss_entropy``, and among others
    ``entropy``, ``kl_approx`` and ``clip_fraction`` for the log.

    Reference:
        Schulman et al., "Proximal Policy Optimization Algorithms" (2017).

    Args:
        actor_critic: see `RecurrentActorCritic`.
        gamma: discount per decision.
        lmbda: trade-off of bias and variance in the advantage.
        clip_epsilon: bound on the change of an action's probability.
        entropy_coeff: weight of the entropy bonus; can be assigned while training.
        critic_coeff: weight of the critic's squared error.
        reduction: ``"mean"`` or ``"sum"``.

    Raises:
        ValueError: if an argument is out of range; from ``estimate_advantage``, if
            reward or ends differ in shape from the values.

    Examples:
        >>> import torch
        >>> from tensordict import TensorDict
        >>> from toponav.modules import ActorCritic
        >>> network = ActorCritic(input="embedding", embedding_dim=8)
        >>> state = {  # four episodes of a single decision
        ...     "embedding": torch.randn(4, 1, 8),
        ...     "previous_action": torch.full((4, 1, 1), 6),
        ...     "previous_reward": torch.zeros(4, 1, 1),
        ...     "recurrent_state": network.initial_state(4, 1),
        ... }
        >>> true = torch.ones(4, 1, 1, dtype=torch.bool)
        >>> following = {**state, "intrinsic_reward": torch.ones(4, 1, 1)}
        >>> following |= {"done": true, "terminated": ~true}
        >>> batch = TensorDict({**state, "is_init": true, "next": following}, [4, 1])
        >>> with torch.no_grad():
        ...     batch = network(batch)
        >>> loss = RecurrentPPOLoss(network)
        >>> loss.set_keys(reward="intrinsic_reward")
        >>> batch = loss.estimate_advantage(batch)
        >>> loss(batch)["kl_approx"].abs() < 1e-6  # the policy has not changed yet
        tensor(True)

    Shape notation:
        B: batch of envs or sequences.  T: decisions in the slice.
    """

    def __init__(
        self,
        actor_critic: RecurrentActorCritic,
        *,
        gamma: float = 0.99,
        lmbda: float = 0.95,
        clip_epsilon: float = 0.2,
        entropy_coeff: float = 0.01,
        critic_coeff: float = 0.5,
        reduction: Reduction = "mean",
    ) -> None:
        if reduction not in get_args(Reduction):
            raise ValueError(
                f"reduction must be one of {get_args(Reduction)}, got {reduction!r}."
            )
        actor = ProbabilisticActor(
            TensorDictModule(actor_critic.actor, in_keys=[_OUTPUT], out_keys=[LOGITS]),
            in_keys=[LOGITS],
            out_keys=[ACTION],
            distribution_class=Categorical,
            distribution_kwargs={"validate_args": False},
            return_log_prob=True,
            log_prob_key=ACTION_LOG_PROB,
        )
        critic = TensorDictModule(
            actor_critic.critic, in_keys=[_OUTPUT], out_keys=[STATE_VALUE]
        )
        super().__init__(
            actor,
            critic,
            clip_epsilon=clip_epsilon,
            entropy_coeff=entropy_coeff,
            critic_coeff=critic_coeff,
            loss_critic_type="l2",
            reduction=reduction,
            functional=False,
        )
        self.actor_critic = actor_critic
        self.gamma = check_share("gamma", gamma)
        self.lmbda = check_share("lmbda", lmbda)

    @property
    def in_keys(self) -> list[NestedKey]:
        """What the network reads, the action, its log-probability and the advantage."""
        keys = self.tensor_keys
        network: list[NestedKey] = list(self.actor_critic.in_keys)
        own = (keys.action, keys.sample_log_prob, keys.advantage, keys.value_target)
        return [*network, *own]

    @torch.no_grad()
    def estimate_advantage(
        self, batch: TensorDictBase, *, normalize: bool = True
    ) -> TensorDictBase:
        """Write the advantage and the value target into a collected batch.

        Args:
            batch: ``[*B, T]`` decisions, time last, with the values that the network
                gave at collection; see `bootstrapped_gae`.
            normalize: give the batch's advantages the mean 0 and the deviation 1.

        Returns:
            The batch with ``advantage`` and ``value_target``, ``[*B, T, 1]``.
        """
        keys = self.tensor_keys
        advantage, value_target = bootstrapped_gae(
            batch,
            batch.get(keys.value),
            self.actor_critic,
            gamma=self.gamma,
            lmbda=self.lmbda,
            reward=keys.reward,
            done=keys.done,
            terminated=keys.terminated,
        )
        if normalize:
            deviation = advantage.std(correction=0).clamp_min(1e-6)
            advantage = (advantage - advantage.mean()) / deviation
        batch.set(keys.advantage, advantage)
        return batch.set(keys.value_target, value_target)

    @dispatch  # type: ignore[untyped-decorator]
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        keys = self.tensor_keys
        if tensordict.get(keys.advantage, None) is None:
            tensordict = self.estimate_advantage(tensordict.copy(), normalize=False)
        decisions = tensordict.select(
            keys.action, keys.sample_log_prob, keys.advantage, keys.value_target
        )
        decisions.set(_OUTPUT, self.actor_critic.unroll_lstm(tensordict))
        # Flat, because its statistics for the log are taken over the first dimension.
        return super().forward(decisions.reshape(-1))
