"""`ActorCritic`: the explorer's recurrent policy and value."""

from typing import Literal, get_args

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812
from torchrl.data import Unbounded
from torchrl.envs.transforms import TensorDictPrimer
from torchrl.envs.utils import ExplorationType, exploration_type

from toponav.keys import (
    ACTION,
    ACTION_LOG_PROB,
    EMBEDDING,
    HIDDEN,
    IS_INIT,
    LOGITS,
    MEMORY_CELL,
    POLICY_PIXELS,
    PREVIOUS_ACTION,
    PREVIOUS_REWARD,
    STATE_VALUE,
)
from toponav.modules.episodic_lstm import EpisodicLSTM, State
from toponav.modules.policy_trunks import EmbeddingTrunk, PixelTrunk, start_orthogonal

Input = Literal["pixels", "embedding"]
NEXT_HIDDEN: NestedKey = ("next", *HIDDEN)
NEXT_MEMORY_CELL: NestedKey = ("next", *MEMORY_CELL)


class ActorCritic(TensorDictModuleBase):
    """Choose actions and judge states from views, with a memory.

    A trunk encodes the view, an LSTM reads the code, the previous action (one-hot, with
    one place more for "none") and the previous reward, and two linear heads give the
    logits of the actions and the state's value.

    There are three ways in. Calling the module makes one decision for a batch of envs,
    as collectors want it; everything runs in one pass, because a stack of TorchRL
    modules costs twice as much here. `unroll` recomputes a slice of experience with
    gradients, the trunk once over all views, then the LSTM over time. `next_values`
    judges the states that decisions led to, for bootstrapping.

    The LSTM's state travels in the tensordict: put `make_tensordict_primer` and
    TorchRL's ``InitTracker`` into the env, and it is carried from decision to decision
    and from batch to batch, and starts from zero with every episode.

    ``set_exploration_type`` is honoured: actions are sampled unless it asks for a
    deterministic policy, which takes the most probable action.

    Reference:
        The paper, "Learning model"; the sizes are those of Jaderberg et al.,
        "Reinforcement Learning with Unsupervised Auxiliary Tasks" (2016).

    Args:
        input: ``"pixels"`` for views of the policy, encoded by a `PixelTrunk`;
            ``"embedding"`` for ready embeddings, encoded by an `EmbeddingTrunk`.
        embedding_dim: length of the embedding; needed for it, not used for pixels.
        image_size: height and width of the views in pixels.
        num_actions: number A of actions.
        code_dim: length of the trunk's code.
        hidden_dim: length H of the LSTM's state.
        view_key: where the view is, ``policy_pixels`` or ``embedding`` unless given.

    Raises:
        ValueError: if ``input`` is another word, ``num_actions`` is below 2, or an
            embedding comes without its length.
        KeyError: from a call, if the tensordict has no state of the LSTM.

    Examples:
        >>> policy = ActorCritic(input="embedding", embedding_dim=8, num_actions=6)
        >>> decision = TensorDict(
        ...     {
        ...         "embedding": torch.zeros(4, 8),
        ...         "previous_action": torch.full((4, 1), 6),  # none yet
        ...         "previous_reward": torch.zeros(4, 1),
        ...         "is_init": torch.ones(4, 1, dtype=torch.bool),
        ...         "recurrent_state": policy.initial_state(4),
        ...     },
        ...     [4],
        ... )
        >>> policy(decision)["action"].shape
        torch.Size([4])
        >>> policy.unroll(decision.unsqueeze(-1))["logits"].shape
        torch.Size([4, 1, 6])

    Shape notation:
        B: batch of envs.  T: decisions in a slice.  A: actions.  H: LSTM state.
    """

    out_keys = [
        ACTION,
        ACTION_LOG_PROB,
        LOGITS,
        STATE_VALUE,
        NEXT_HIDDEN,
        NEXT_MEMORY_CELL,
    ]

    def __init__(
        self,
        *,
        input: Input = "pixels",
        embedding_dim: int | None = None,
        image_size: tuple[int, int] = (84, 84),
        num_actions: int = 6,
        code_dim: int = 256,
        hidden_dim: int = 256,
        view_key: NestedKey | None = None,
    ) -> None:
        super().__init__()
        if input not in get_args(Input):
            raise ValueError(f"input must be one of {get_args(Input)}, got {input!r}.")
        if num_actions < 2:
            raise ValueError(f"num_actions must be at least 2, got {num_actions}.")
        self.num_actions = num_actions
        self.hidden_dim = hidden_dim
        self.trunk: nn.Module
        if input == "pixels":
            self.trunk = PixelTrunk(code_dim, image_size=image_size)
            self.view_key = view_key or POLICY_PIXELS
        elif embedding_dim is None:
            raise ValueError('embedding_dim must be given with input="embedding".')
        else:
            self.trunk = EmbeddingTrunk(embedding_dim, code_dim)
            self.view_key = view_key or EMBEDDING
        self.lstm = EpisodicLSTM(code_dim + num_actions + 2, hidden_dim)
        self.actor = nn.Linear(hidden_dim, num_actions)
        self.critic = nn.Linear(hidden_dim, 1)
        # Small logits: the first policy is close to uniform whatever it sees.
        start_orthogonal(self.actor, gain=0.01)
        start_orthogonal(self.critic, gain=1.0)
        self.in_keys = [
            self.view_key,
            PREVIOUS_ACTION,
            PREVIOUS_REWARD,
            IS_INIT,
            HIDDEN,
            MEMORY_CELL,
        ]

    def make_tensordict_primer(self) -> TensorDictPrimer:
        """The transform that starts the LSTM's state at zero when an env resets."""
        state = Unbounded((self.hidden_dim,))
        return TensorDictPrimer(
            {HIDDEN: state, MEMORY_CELL: state.clone()}, expand_specs=True
        )

    def initial_state(self, *batch_size: int) -> TensorDict:
        """Zero states of the LSTM, ``hidden`` and ``memory_cell``, ``[*B, H]``."""
        device = self.actor.weight.device
        zeros = torch.zeros(*batch_size, self.hidden_dim, device=device)
        return TensorDict(
            {"hidden": zeros, "memory_cell": zeros.clone()}, batch_size, device=device
        )

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        """Decide for every env of the batch; the results are written into it.

        Args:
            tensordict: ``[*B]`` with ``in_keys``.

        Returns:
            The tensordict with ``out_keys``.
        """
        shape = tensordict.batch_size
        hidden, cell = self._step(tensordict)
        logits = self.actor(hidden)
        log_probs = F.log_softmax(logits.float(), -1)
        if exploration_type() in (None, ExplorationType.RANDOM):
            action = torch.multinomial(log_probs.exp(), 1)
        else:
            action = log_probs.argmax(-1, keepdim=True)
        log_prob = log_probs.gather(-1, action)
        tensordict.set(ACTION, action.reshape(shape))
        tensordict.set(ACTION_LOG_PROB, log_prob.reshape(shape))
        tensordict.set(LOGITS, logits.reshape(*shape, -1))
        tensordict.set(STATE_VALUE, self.critic(hidden).reshape(*shape, 1))
        tensordict.set(NEXT_HIDDEN, hidden.reshape(*shape, -1))
        tensordict.set(NEXT_MEMORY_CELL, cell.reshape(*shape, -1))
        return tensordict

    def unroll(self, tensordict: TensorDictBase) -> TensorDict:
        """Recompute a slice of experience, with gradients through time.

        Starts from the state stored with the slice's first decision; states stored
        with later ones are not read.

        Args:
            tensordict: ``[*B, T]`` with ``in_keys``, time last; it is left alone.

        Returns:
            A new tensordict ``[*B, T]`` with ``logits``, ``state_value`` and
            ``("next", hidden)``, the LSTM's outputs from which the heads computed them.
        """
        outputs = self.unroll_lstm(tensordict)
        return TensorDict(
            {
                LOGITS: self.actor(outputs),
                STATE_VALUE: self.critic(outputs),
                NEXT_HIDDEN: outputs,
            },
            tensordict.batch_size,
        )

    def unroll_lstm(self, tensordict: TensorDictBase) -> Tensor:
        """`unroll` without the heads: the LSTM's outputs, ``[*B, T, H]``."""
        shape = tensordict.batch_size
        inputs = self._lstm_inputs(tensordict)
        state = self._state(tensordict[..., 0].select(HIDDEN, MEMORY_CELL))
        is_init = tensordict.get(IS_INIT).reshape(-1, shape[-1])
        rows = inputs.reshape(-1, shape[-1], inputs.shape[-1])
        outputs: Tensor = self.lstm(rows, state, is_init)[0]
        return outputs.reshape(*shape, -1)

    @torch.no_grad()
    def next_values(self, tensordict: TensorDictBase) -> Tensor:
        """Judge the states that decisions led to, without gradients.

        Args:
            tensordict: ``[*B]`` decisions whose ``"next"`` entry has the view, the
                previous action and reward, and the LSTM's state after the decision. At
                an episode's end that is the episode's own last view.

        Returns:
            ``[*B, 1]``.
        """
        following = tensordict.get("next")
        inputs = self._lstm_inputs(following)
        inputs = inputs.reshape(-1, inputs.shape[-1])
        is_init = inputs.new_zeros(len(inputs), dtype=torch.bool)
        hidden, _ = self.lstm.step(inputs, self._state(following), is_init)
        value: Tensor = self.critic(hidden)
        return value.reshape(*tensordict.batch_size, 1)

    def _step(self, tensordict: TensorDictBase) -> State:
        inputs = self._lstm_inputs(tensordict)
        return self.lstm.step(
            inputs.reshape(-1, inputs.shape[-1]),
            self._state(tensordict),
            tensordict.get(IS_INIT).reshape(-1),
        )

    def _lstm_inputs(self, tensordict: TensorDictBase) -> Tensor:
        code: Tensor = self.trunk(tensordict.get(self.view_key))
        action = tensordict.get(PREVIOUS_ACTION).squeeze(-1)
        one_hot = F.one_hot(action, self.num_actions + 1).to(code.dtype)
        reward = tensordict.get(PREVIOUS_REWARD).to(code.dtype)
        return torch.cat([code, one_hot, reward], -1)

    def _state(self, tensordict: TensorDictBase) -> State:
        hidden, cell = tensordict.get(HIDDEN, None), tensordict.get(MEMORY_CELL, None)
        if hidden is None or cell is None:
            raise KeyError(
                f"the tensordict must have {HIDDEN} and {MEMORY_CELL}, the LSTM's "
                "state: add make_tensordict_primer() to the env's transforms."
            )
        return hidden.reshape(-1, self.hidden_dim), cell.reshape(-1, self.hidden_dim)
