"""`RecurrentPPOLoss`: TorchRL's clipped loss over one pass of a recurrent network."""

from collections.abc import Iterator

import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModule, dispatch
from torch import Tensor
from torch.distributions import Categorical
from torchrl.modules import ProbabilisticActor
from torchrl.objectives import ClipPPOLoss

from toponav.keys import ACTION, ACTION_LOG_PROB, HIDDEN, LOGITS, STATE_VALUE
from toponav.objectives.actions import action_numbers
from toponav.objectives.actor_critic_loss import (
    GAEMixin,
    RecurrentActorCritic,
    padding_masks,
    read_entry,
    require_recurrent,
    require_slices,
    valid_decisions,
)

#: The LSTM's output after a decision is its next hidden state: the heads read it.
_OUTPUT: NestedKey = ("next", *HIDDEN)


class RecurrentPPOLoss(GAEMixin, ClipPPOLoss):
    """Clipped policy loss over sequences with a state of the LSTM at their start.

    The trunk and the LSTM run once; ``ClipPPOLoss`` sees two linear heads on their
    outputs, without what TorchRL's masks call padding. Call `estimate_advantage` on a
    collected batch, before the passes over it. The critic's loss grows with the square
    of the returns: put `ReturnScale` before it where rewards are not small.

    Reference:
        Schulman et al., "Proximal Policy Optimization Algorithms" (2017).

    Args:
        actor_critic: see `RecurrentActorCritic`; actions are numbers or one-hot.
        clip_epsilon: bound on the change of an action's probability.
        entropy_coeff, critic_coeff: weights that can be assigned while training.

    Raises:
        FloatingPointError: in `forward`, if the LSTM's outputs are not finite.

    Examples:
        >>> from toponav.modules import ActorCritic
        >>> network = ActorCritic(num_actions=4, input="embedding", embedding_dim=8)
        >>> loss = RecurrentPPOLoss(network, clip_epsilon=0.1)
        >>> loss = loss.make_value_estimator(gamma=0.9, lmbda=0.95)
    """

    def __init__(
        self,
        actor_critic: RecurrentActorCritic,
        *,
        clip_epsilon: float = 0.2,
        entropy_coeff: float = 0.01,
        critic_coeff: float = 0.5,
    ) -> None:
        own = ("in_keys", "num_actions", "actor", "critic")
        both = ("unroll_lstm", "next_values")
        require_recurrent(actor_critic, "actor_critic", *own, *both)
        actor = ProbabilisticActor(
            TensorDictModule(actor_critic.actor, [_OUTPUT], [LOGITS]),
            in_keys=[LOGITS],
            out_keys=[ACTION],
            distribution_class=Categorical,
            distribution_kwargs={"validate_args": False},
            return_log_prob=True,
            log_prob_key=ACTION_LOG_PROB,
        )
        super().__init__(
            actor,
            TensorDictModule(actor_critic.critic, [_OUTPUT], [STATE_VALUE]),
            clip_epsilon=clip_epsilon,
            entropy_coeff=entropy_coeff,
            critic_coeff=critic_coeff,
            loss_critic_type="l2",
            reduction="mean",
            functional=False,
        )
        self.actor_critic = actor_critic

    @property
    def in_keys(self) -> list[NestedKey]:
        keys = self.tensor_keys
        own = [keys.action, keys.sample_log_prob, keys.advantage, keys.value_target]
        return [*self.actor_critic.in_keys, *own]

    @torch.no_grad()
    def estimate_advantage(
        self, batch: TensorDictBase, *, normalize: bool = True
    ) -> TensorDictBase:
        """Write advantage, mean 0 and deviation 1, and value target ``[*B, T, 1]``."""
        require_slices(batch)
        state_value = read_entry(batch, self.tensor_keys.value, "value")
        return self._write_advantage(batch, state_value, normalize=normalize)

    @dispatch  # type: ignore[untyped-decorator]
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        require_slices(tensordict)
        keys = self.tensor_keys
        if tensordict.get(keys.advantage, None) is None:
            tensordict = self.estimate_advantage(tensordict.copy(), normalize=False)
        valid = valid_decisions(self, tensordict)
        decisions = padding_masks(self, tensordict)
        for name in ("sample_log_prob", "advantage", "value_target"):
            key = getattr(keys, name)
            decisions.set(key, read_entry(tensordict, key, name))
        action = read_entry(tensordict, keys.action, "action")
        num_actions = self.actor_critic.num_actions
        numbers = action_numbers(action, num_actions, decisions.shape, valid=valid)
        decisions.set(keys.action, numbers)
        output = self.actor_critic.unroll_lstm(tensordict)
        if not output.isfinite().all():
            # TorchRL would sample from such a policy, which is an error of torch.
            rule = "the policy's hidden state must be finite"
            raise FloatingPointError(f"{rule}, got NaN or infinity")
        decisions.set(_OUTPUT, output)
        # Flat and, unless there is nothing else, without padding, because its
        # statistics for the log are taken over the first dimension, whatever a mask is.
        some = valid is not None and valid.any()
        return super().forward(decisions[valid] if some else decisions.reshape(-1))


class SequenceMinibatches:
    """Cut slices into sequences and yield them in a new order each time.

    ``[*B, T]`` becomes ``*B T / L`` sequences of L decisions, each with the LSTM's
    state stored with its first decision. Entries under ``"next"`` are left out.

    Args:
        sequence_length: decisions L of a sequence; must divide T.
        num_minibatches: minibatches of one pass; at most the number of sequences.
        seed: of the order; ``None`` takes one from the operating system.

    Examples:
        >>> minibatches = SequenceMinibatches(40, num_minibatches=3, seed=0)
        >>> batch = TensorDict({"action": torch.zeros(16, 120)}, [16, 120])
        >>> [minibatch.shape for minibatch in minibatches(batch)]
        [torch.Size([16, 40]), torch.Size([16, 40]), torch.Size([16, 40])]
    """

    def __init__(
        self, sequence_length: int, *, num_minibatches: int, seed: int | None = None
    ) -> None:
        if min(sequence_length, num_minibatches) < 1:
            raise ValueError(
                "sequence_length and num_minibatches must be at least 1, got "
                f"{sequence_length} and {num_minibatches}."
            )
        self.sequence_length = sequence_length
        self.num_minibatches = num_minibatches
        self.generator = torch.Generator()
        self.generator.manual_seed(self.generator.seed() if seed is None else seed)

    def __call__(self, batch: TensorDictBase) -> Iterator[TensorDictBase]:
        """One pass over a batch ``[*B, T]``, time last, in minibatches ``[N, L]``."""
        require_slices(batch)
        length, total = self.sequence_length, batch.batch_size[-1]
        if total % length:
            rule = f"sequence_length must divide the slice's {total} decisions"
            raise ValueError(f"{rule}, got {length}.")
        sequences = batch.exclude("next").reshape(-1, length)
        if len(sequences) < self.num_minibatches:
            most = f"the batch's {len(sequences)} sequences, got {self.num_minibatches}"
            raise ValueError(f"num_minibatches must be at most {most}.")
        order = torch.randperm(len(sequences), generator=self.generator)
        if batch.device is not None:
            order = order.to(batch.device)
        for part in order.tensor_split(self.num_minibatches):
            # Indexing copies bytes one at a time: seven times slower for images.
            yield sequences.apply(
                lambda entry, rows=part: entry.index_select(0, rows.to(entry.device)),
                batch_size=[len(part), length],
            )

    def state_dict(self) -> dict[str, Tensor]:
        return {"generator": self.generator.get_state()}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        self.generator.set_state(state["generator"].cpu())
