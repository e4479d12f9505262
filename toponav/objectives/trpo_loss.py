"""`TRPOLoss`: the surrogate of a policy, and its divergence from an earlier one."""

from dataclasses import dataclass
from typing import Any, cast

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from tensordict.nn import (
    ProbabilisticTensorDictSequential,
    TensorDictModule,
    TensorDictModuleBase,
    dispatch,
)
from torch import Tensor, nn
from torch.distributions import Categorical, kl_divergence
from torchrl.modules import ProbabilisticActor
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
    padding_masks,
    read_entry,
    require_critic,
    require_recurrent,
    require_slices,
    valid_decisions,
)

#: Where a recurrent network's outputs are for its two heads.
_OUTPUT = "lstm_output"


class TRPOLoss(GAEMixin, LossModule):
    """Surrogate and divergence of a policy, and its critic, over slices ``[*B, T]``.

    ``loss_objective`` is ``-A pi(a|s) / pi_b(a|s)``, where ``pi_b`` is the policy that
    acted, ``loss_entropy`` is ``-entropy_coeff`` times the entropy, ``loss_critic`` is
    ``critic_coeff * (R - V)^2``, all means, without padding, by TorchRL's masks;
    ``entropy`` is in nats. ``kl`` is the mean divergence KL(old || new) from the policy
    whose parameters (such as ``logits``) are in the batch, and has gradients. `prepare`
    writes those of the policy as it is now.

    Their sum is not to be minimised: a `TrustRegion` moves `policy_parameters` by
    `policy_terms`, and an optimiser `critic_parameters` by `critic_loss`. Names and
    keys are those of TorchRL's ``KLPENPPOLoss(functional=False)``.

    Reference:
        Schulman et al., "Trust Region Policy Optimization" (2015), eq. 14; advantages
        as in their "High-Dimensional Continuous Control Using Generalized Advantage
        Estimation" (2015).

    Args:
        actor_network: a ``ProbabilisticActor``; or, alone, a `RecurrentActorCritic`,
            whose trunk belongs to the policy: its critic is the head alone.
        critic_network: the value operator.
        entropy_coeff, critic_coeff: weights that can be assigned while training.

    Examples:
        >>> from toponav.modules import ActorCritic
        >>> network = ActorCritic(num_actions=4, input="embedding", embedding_dim=8)
        >>> loss = TRPOLoss(network).make_value_estimator(gamma=0.9, lmbda=0.95)
        >>> len(loss.policy_parameters()), len(loss.critic_parameters())
        (8, 2)
    """

    @dataclass
    class _AcceptedKeys:
        action: NestedKey = keys.ACTION
        sample_log_prob: NestedKey = keys.ACTION_LOG_PROB
        reward: NestedKey = keys.REWARD
        done: NestedKey = keys.DONE
        terminated: NestedKey = keys.TERMINATED
        value: NestedKey = keys.STATE_VALUE
        advantage: NestedKey = keys.ADVANTAGE
        value_target: NestedKey = keys.VALUE_TARGET

    default_keys = _AcceptedKeys
    default_value_estimator = ValueEstimators.GAE
    functional = False
    out_keys = ["loss_objective", "loss_critic", "loss_entropy", "entropy", "kl"]
    _schedulable_buffers = frozenset({"entropy_coeff", "critic_coeff"})
    entropy_coeff: Tensor
    critic_coeff: Tensor

    def __init__(
        self,
        actor_network: ProbabilisticTensorDictSequential | RecurrentActorCritic,
        critic_network: TensorDictModuleBase | None = None,
        *,
        entropy_coeff: float = 0.0,
        critic_coeff: float = 1.0,
    ) -> None:
        super().__init__()
        network: Any = actor_network
        self.actor_critic = None
        if critic_network is None:
            name = "actor_network without a critic_network"
            parts = ("in_keys", "unroll_lstm", "actor", "critic", "next_values")
            require_recurrent(network, name, *parts)
            self.actor_critic = network
            critic_network = TensorDictModule(
                network.critic, [_OUTPUT], [keys.STATE_VALUE]
            )
            network = ProbabilisticActor(
                TensorDictModule(network.actor, [_OUTPUT], [keys.LOGITS]),
                in_keys=[keys.LOGITS],
                out_keys=[keys.ACTION],
                distribution_class=Categorical,
                distribution_kwargs={"validate_args": False},
            )
        require_one_action(network)
        require_critic(critic_network)
        self.actor_network = network
        self.critic_network = critic_network
        self.register_coeff_buffer("entropy_coeff", entropy_coeff)
        self.register_coeff_buffer("critic_coeff", critic_coeff)

    @property
    def in_keys(self) -> list[NestedKey]:
        named = self.tensor_keys
        return self._keys_of_slices(named.action, named.sample_log_prob)

    def policy_parameters(self) -> list[nn.Parameter]:
        """What the policy depends on: with a recurrent network all but its critic."""
        if self.actor_critic is None:
            return list(self.actor_network.parameters())
        own = {id(weight) for weight in self.critic_network.parameters()}
        return [one for one in self.actor_critic.parameters() if id(one) not in own]

    def critic_parameters(self) -> list[nn.Parameter]:
        """What the critic alone depends on."""
        shared = {id(weight) for weight in self.policy_parameters()}
        weights = self.critic_network.parameters()
        return [one for one in weights if id(one) not in shared]

    @torch.no_grad()
    def prepare(
        self, batch: TensorDictBase, *, normalize: bool = True
    ) -> TensorDictBase:
        """A shallow copy with advantages, value targets and the policy's parameters.

        Advantages, ``[*B, T, 1]``, get mean 0 and deviation 1 unless told otherwise.
        """
        require_slices(batch)
        batch = batch.copy()
        inputs = self._inputs(batch)
        batch = self._write_advantage(batch, self._judge(inputs), normalize=normalize)
        old = self.actor_network.get_dist_params(inputs)
        for key in self.actor_network.dist_params_keys:
            batch.set(key, old.get(key))
        return batch

    @dispatch  # type: ignore[untyped-decorator]
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        if tensordict.get(self.tensor_keys.advantage, None) is None:
            tensordict = self.prepare(tensordict, normalize=False)
        inputs = self.critic_inputs(tensordict)
        terms = self.policy_terms(tensordict)
        return terms.set("loss_critic", self.critic_loss(inputs))

    def policy_terms(self, batch: TensorDictBase) -> TensorDict:
        """All but ``loss_critic``, of a batch from `prepare`."""
        named = self.tensor_keys
        policy = self.actor_network.get_dist(self._inputs(batch))
        action = read_entry(batch, named.action, "action")
        if self.actor_critic is not None:
            number = self.actor_critic.num_actions
            valid = valid_decisions(self, batch)
            action = action_numbers(action, number, batch.batch_size, valid=valid)
        log_prob = action_log_prob(policy, action, batch.batch_size)
        name = "sample_log_prob"
        before = read_entry(batch, named.sample_log_prob, name, log_prob.shape)
        advantage = read_entry(batch, named.advantage, "advantage").squeeze(-1)
        entropy = self._mean(policy.entropy(), batch)
        old = self.actor_network.build_dist_from_params(batch)
        objective = -((log_prob - before).exp() * advantage)
        terms = {
            "loss_objective": self._mean(objective, batch),
            "loss_entropy": -self.entropy_coeff * entropy,
            "entropy": entropy.detach(),
            "kl": self._mean(kl_divergence(old, policy), batch),
        }
        return TensorDict(terms)

    @torch.no_grad()
    def critic_inputs(self, batch: TensorDictBase) -> TensorDictBase:
        """What `critic_loss` reads of a batch from `prepare`, for several passes."""
        target = self.tensor_keys.value_target
        value_target = read_entry(batch, target, "value_target")
        inputs = self._inputs(batch).update(padding_masks(self, batch))
        return inputs.set(target, value_target)

    def critic_loss(self, inputs: TensorDictBase) -> Tensor:
        """The critic's loss over what `critic_inputs` returns, or a part of it."""
        target = read_entry(inputs, self.tensor_keys.value_target, "value_target")
        error = distance_loss(target, self._judge(inputs), "l2")
        return self.critic_coeff * self._mean(error, inputs)

    def _mean(self, each: Tensor, batch: TensorDictBase) -> Tensor:
        return cast(Tensor, self._reduce_loss(each, batch, reduction="mean"))

    def _inputs(self, batch: TensorDictBase) -> TensorDictBase:
        """What both networks read, in a tensordict of its own."""
        if self.actor_critic is None:
            seen = [*self.actor_network.in_keys, *self.critic_network.in_keys]
            return batch.select(*seen)
        require_slices(batch)
        return TensorDict({_OUTPUT: self.actor_critic.unroll_lstm(batch)}, batch.shape)
