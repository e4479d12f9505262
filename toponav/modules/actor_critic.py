"""`ActorCritic`: the explorer's recurrent policy and value, and its `EpisodicLSTM`."""

from typing import Any, Literal, get_args

import torch
from tensordict import NestedKey, TensorDict, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812
from torchrl.data import Composite, OneHot, Unbounded
from torchrl.envs.transforms import TensorDictPrimer
from torchrl.envs.utils import ExplorationType, exploration_type

from toponav import keys
from toponav.actions import count_actions
from toponav.keys import read_entry
from toponav.modules.encoders import start_orthogonal
from toponav.modules.policy_trunks import EmbeddingTrunk, PixelTrunk
from toponav.views import ChannelOrder

Input = Literal["pixels", "embedding"]
#: Hidden and cell state, each ``[N, H]``.
State = tuple[Tensor, Tensor]
NEXT_HIDDEN: NestedKey = ("next", *keys.HIDDEN)
NEXT_MEMORY_CELL: NestedKey = ("next", *keys.MEMORY_CELL)


class EpisodicLSTM(nn.Module):
    """LSTM layers over slices, their state zeroed where ``is_init`` is set.

    Acting calls `step`, training the module, for torch's fused kernel: what follows the
    start of an episode within a slice is a row of its own there. The states of all
    layers lie in one tensor, the first layer's first; the output is the last one's.

    Args:
        input_dim: length D of what is read.
        hidden_dim: length H of a layer's state.
        layers: how many layers, each of which reads the outputs of the one before.

    Examples:
        >>> lstm = EpisodicLSTM(8, 16)
        >>> state = (torch.zeros(4, 16), torch.zeros(4, 16))
        >>> is_init = torch.zeros(4, 20, dtype=torch.bool)
        >>> lstm(torch.zeros(4, 20, 8), state, is_init).shape
        torch.Size([4, 20, 16])
    """

    def __init__(
        self, input_dim: int, hidden_dim: int = 256, *, layers: int = 1
    ) -> None:
        super().__init__()
        self.layers = layers
        #: Length of the states of all layers together, S.
        self.state_dim = layers * hidden_dim
        self.lstm = nn.LSTM(input_dim, hidden_dim, layers, batch_first=True)

    def step(self, inputs: Tensor, state: State, is_init: Tensor) -> State:
        """One decision: ``[N, D]``, the state before it, ``[N]`` to the state after."""
        after, kept = [], _restart(state, is_init)
        states = zip(*(one.chunk(self.layers, -1) for one in kept), strict=True)
        # Its order: weights of the inputs and the state, biases of both.
        for weights, before in zip(self.lstm.all_weights, states, strict=True):
            after.append(torch.lstm_cell(inputs, before, *weights))
            inputs = after[-1][0]
        hidden, cell = (torch.cat(parts, -1) for parts in zip(*after, strict=True))
        return hidden, cell

    def forward(self, inputs: Tensor, state: State, is_init: Tensor) -> Tensor:
        """Outputs ``[N, T, H]`` of a slice ``[N, T, D]``, from the state before it."""
        rows, starts = is_init[:, 1:].nonzero().unbind(1)
        starts = starts + 1
        hidden, cell = _restart(state, is_init[:, 0])
        if len(rows) == 0:
            return self._run(inputs, hidden, cell)
        num, length = is_init.shape
        steps = torch.arange(length, device=is_init.device)
        # What is read past the slice's end is repeated, and what it brings not used.
        read = (starts.unsqueeze(1) + steps).clamp_(max=length - 1)
        later = _pick(inputs, rows.unsqueeze(1) * length + read)
        zeros = hidden.new_zeros(len(rows), self.state_dim)
        hidden, cell = torch.cat([hidden, zeros]), torch.cat([cell, zeros])
        outputs = self._run(torch.cat([inputs, later]), hidden, cell)
        # The row that a decision is in now, and where it began.
        row, begun = torch.zeros(2, num, length, dtype=torch.int64, device=rows.device)
        row[:, 0] = torch.arange(num, device=rows.device)
        row[rows, starts] = torch.arange(num, num + len(rows), device=rows.device)
        begun[rows, starts] = starts
        # Both grow along a slice.
        row, begun = row.cummax(1).values, begun.cummax(1).values
        return _pick(outputs, row * length + steps - begun)

    def _run(self, inputs: Tensor, hidden: Tensor, cell: Tensor) -> Tensor:
        states = (torch.stack(one.chunk(self.layers, -1)) for one in (hidden, cell))
        outputs: Tensor = self.lstm(inputs, tuple(states))[0]
        return outputs


def _pick(slices: Tensor, places: Tensor) -> Tensor:
    """Decisions of slices ``[N, T, D]``, by places ``[M, T]`` among all N T of them."""
    picked: Tensor = slices.flatten(0, 1).index_select(0, places.flatten())
    return picked.reshape(*places.shape, -1)


def _restart(state: State, is_init: Tensor) -> State:
    # Filled, not multiplied: a NaN of the last episode must not survive.
    rows = is_init.unsqueeze(-1)
    return state[0].masked_fill(rows, 0), state[1].masked_fill(rows, 0)


class StatePrimer(TensorDictPrimer):
    """Start a policy's state at zero, in an env of the same actions only.

    Args:
        states: spec of each entry of the state, without the batch of the env.
        num_actions: number A of the policy's actions.
        one_hot: whether it writes them as ``[*B, A]``.
    """

    def __init__(self, states: Composite, *, num_actions: int, one_hot: bool) -> None:
        super().__init__(states, expand_specs=True)
        self.num_actions = num_actions
        self.one_hot = one_hot

    def transform_observation_spec(self, observation_spec: Composite) -> Composite:
        specs = self.parent.full_action_spec
        if keys.ACTION not in specs.keys(True, True):
            found = list(specs.keys(True, True))
            raise ValueError(f"the env must have {keys.ACTION!r}, got {found}.")
        spec = specs[keys.ACTION]
        wanted = count_actions(spec, keys.ACTION), isinstance(spec, OneHot)
        if (self.num_actions, self.one_hot) != wanted:
            # TorchRL's GymEnv takes numbers only if it is told so.
            hint = " (or categorical_action_encoding=True of the env)"
            raise ValueError(
                f"num_actions and one_hot must be {wanted} for the env's actions, "
                f"{type(spec).__name__}{hint if wanted[1] else ''}, got "
                f"{(self.num_actions, self.one_hot)}."
            )
        if not self.one_hot and spec.shape != self.parent.batch_size:
            rule = f"the env's actions must be numbers {list(self.parent.batch_size)}"
            raise ValueError(f"{rule}, got {list(spec.shape)}.")
        return super().transform_observation_spec(observation_spec)


class ActorCritic(TensorDictModuleBase):
    """Choose actions and judge states from views, with a memory.

    An LSTM reads a trunk's code of the view, the previous action (one-hot, one place
    more for "none") and the previous reward; two linear heads give logits and value.
    Envs need what writes the view (`PolicyPixels`, or `EmbedViews` or `WaypointMemory`)
    and the reward, and after it what `make_policy_inputs` lists: TorchRL's
    ``InitTracker``, `PreviousAction`, `PreviousReward` of that reward, and
    `make_tensordict_primer`.

    Reference:
        The paper, "Learning model"; sizes of Jaderberg et al., "Reinforcement Learning
        with Unsupervised Auxiliary Tasks" (2016).

    Args:
        num_actions: number A of actions, at least 2.
        input: ``"pixels"`` for a `PixelTrunk`, ``"embedding"`` for an `EmbeddingTrunk`;
            by default the latter if an ``embedding_dim`` is given.
        embedding_dim: length of the embedding, needed for it alone.
        image_size: height and width of the policy's views in pixels.
        channels: ``"HWC"``, or ``"CHW"`` for views ``[*B, 3, H, W]``.
        code_dim, hidden_dim: lengths of the trunk's code and, H, of the LSTM's state.
        layers: of the LSTM; with more than one its state is as much longer.
        view_key: where the view is, ``policy_pixels`` or ``embedding`` unless given.
        one_hot: write actions as int64 ``[*B, A]`` instead of ``[*B]``.

    Examples:
        >>> policy = ActorCritic(num_actions=4, embedding_dim=8)
        >>> views = {"embedding": torch.zeros(5, 8), "is_init": torch.ones(5, 1).bool()}
        >>> views["previous_action"] = torch.full((5, 1), 4)  # none yet
        >>> views["previous_reward"] = torch.zeros(5, 1)
        >>> views["recurrent_state"] = policy.initial_state(5)
        >>> policy(TensorDict(views, [5]))["action"].shape
        torch.Size([5])
    """

    #: An `EpisodicLSTM`, or what is used like one.
    lstm: Any
    out_keys = [keys.ACTION, keys.ACTION_LOG_PROB, keys.LOGITS, keys.STATE_VALUE]
    out_keys += [NEXT_HIDDEN, NEXT_MEMORY_CELL]

    def __init__(
        self,
        *,
        num_actions: int,
        input: Input | None = None,
        embedding_dim: int | None = None,
        image_size: tuple[int, int] = (84, 84),
        channels: ChannelOrder = "HWC",
        code_dim: int = 256,
        hidden_dim: int = 256,
        layers: int = 1,
        view_key: NestedKey | None = None,
        one_hot: bool = False,
    ) -> None:
        super().__init__()
        if input is None:
            input = "pixels" if embedding_dim is None else "embedding"
        if input not in get_args(Input):
            raise ValueError(f"input must be one of {get_args(Input)}, got {input!r}.")
        if num_actions < 2:
            raise ValueError(f"num_actions must be at least 2, got {num_actions}.")
        self.num_actions = num_actions
        if layers < 1:
            raise ValueError(f"layers must be at least 1, got {layers}.")
        self.hidden_dim = hidden_dim
        self.layers = layers
        self.one_hot = one_hot
        self.trunk: nn.Module
        if input == "pixels":
            self.trunk = PixelTrunk(code_dim, image_size=image_size, channels=channels)
        elif embedding_dim is None:
            raise ValueError('embedding_dim must be given with input="embedding".')
        else:
            self.trunk = EmbeddingTrunk(embedding_dim, code_dim)
        usual_keys = {"pixels": keys.POLICY_PIXELS, "embedding": keys.EMBEDDING}
        self.view_key = view_key or usual_keys[input]
        self.code_dim = code_dim
        self.lstm = self.make_lstm()
        self.actor = nn.Linear(hidden_dim, num_actions)
        self.critic = nn.Linear(hidden_dim, 1)
        # Small logits: the first policy is close to uniform whatever it sees.
        start_orthogonal(self.actor, gain=0.01)
        start_orthogonal(self.critic, gain=1.0)
        self.in_keys = [self.view_key, keys.PREVIOUS_ACTION, keys.PREVIOUS_REWARD]
        self.in_keys += [keys.IS_INIT, keys.HIDDEN, keys.MEMORY_CELL]

    def make_lstm(self) -> nn.Module:
        """The memory; acting calls `EpisodicLSTM.step`, training the module.

        The last ``hidden_dim`` entries of its hidden state are its output.
        """
        inputs = self.code_dim + self.num_actions + 2
        return EpisodicLSTM(inputs, self.hidden_dim, layers=self.layers)

    def make_tensordict_primer(self) -> StatePrimer:
        """What starts ``hidden`` and ``memory_cell`` in an env at zero, ``[*B, S]``."""
        state = Unbounded((self.lstm.state_dim,))
        return StatePrimer(
            Composite({keys.HIDDEN: state, keys.MEMORY_CELL: state.clone()}),
            num_actions=self.num_actions,
            one_hot=self.one_hot,
        )

    def initial_state(self, *batch_size: int) -> TensorDict:
        """Zero states of the LSTM, ``hidden`` and ``memory_cell``, ``[*B, S]``."""
        zeros = self.actor.weight.new_zeros(*batch_size, self.lstm.state_dim)
        state = {"hidden": zeros, "memory_cell": zeros.clone()}
        return TensorDict(state, batch_size, device=zeros.device)

    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        shape = tensordict.batch_size
        inputs, state = self._lstm_inputs(tensordict), self._state(tensordict)
        is_init = read_entry(tensordict, keys.IS_INIT).reshape(-1)
        hidden, cell = self.lstm.step(inputs, state, is_init)
        output = hidden[..., -self.hidden_dim :]
        logits = self.actor(output)
        log_probs = F.log_softmax(logits.float(), -1)
        if exploration_type() in (None, ExplorationType.RANDOM):
            # What torch.multinomial does, which first waits for a GPU to look at them.
            waits = torch.empty_like(log_probs).exponential_()
            action = (log_probs.exp() / waits).argmax(-1, keepdim=True)
        else:
            action = log_probs.argmax(-1, keepdim=True)
        log_prob = log_probs.gather(-1, action)
        action = action.reshape(shape)
        if self.one_hot:
            action = F.one_hot(action, self.num_actions)
        tensordict.set(keys.ACTION, action)
        tensordict.set(keys.ACTION_LOG_PROB, log_prob.reshape(shape))
        tensordict.set(keys.LOGITS, logits.reshape(*shape, -1))
        tensordict.set(keys.STATE_VALUE, self.critic(output).reshape(*shape, 1))
        tensordict.set(NEXT_HIDDEN, hidden.reshape(*shape, -1))
        return tensordict.set(NEXT_MEMORY_CELL, cell.reshape(*shape, -1))

    def unroll(self, tensordict: TensorDictBase) -> TensorDict:
        """Logits and values of a slice ``[*B, T]``, from its first decision's state."""
        outputs = self.unroll_lstm(tensordict)
        results = {keys.LOGITS: self.actor(outputs), NEXT_HIDDEN: outputs}
        results[keys.STATE_VALUE] = self.critic(outputs)
        return TensorDict(results, tensordict.batch_size)

    def unroll_lstm(self, tensordict: TensorDictBase) -> Tensor:
        """The LSTM's outputs over a slice, ``[*B, T, H]``."""
        shape = tensordict.batch_size
        inputs = self._lstm_inputs(tensordict).unflatten(0, (-1, shape[-1]))
        state = self._state(tensordict[..., 0])
        is_init = read_entry(tensordict, keys.IS_INIT).reshape(-1, shape[-1])
        outputs: Tensor = self.lstm(inputs, state, is_init)
        return outputs.reshape(*shape, -1)

    @torch.no_grad()
    def next_values(self, tensordict: TensorDictBase) -> Tensor:
        """Values ``[*B, 1]`` of the states under ``"next"``, without gradients."""
        following = tensordict.get("next")
        inputs = self._lstm_inputs(following)
        is_init = inputs.new_zeros(len(inputs), dtype=torch.bool)
        hidden, _ = self.lstm.step(inputs, self._state(following), is_init)
        value: Tensor = self.critic(hidden[..., -self.hidden_dim :])
        return value.reshape(*tensordict.batch_size, 1)

    def _lstm_inputs(self, tensordict: TensorDictBase) -> Tensor:
        """One row a decision, ``[N, D]``."""
        code: Tensor = self.trunk(read_entry(tensordict, self.view_key))
        action = read_entry(tensordict, keys.PREVIOUS_ACTION).squeeze(-1)
        one_hot = F.one_hot(action, self.num_actions + 1).to(code.dtype)
        reward = read_entry(tensordict, keys.PREVIOUS_REWARD).to(code.dtype)
        inputs = torch.cat([code, one_hot, reward], -1)
        return inputs.reshape(-1, inputs.shape[-1])

    def _state(self, tensordict: TensorDictBase) -> State:
        wanted = (keys.HIDDEN, keys.MEMORY_CELL)
        state = [read_entry(tensordict, key) for key in wanted]
        hidden, cell = (entry.reshape(-1, self.lstm.state_dim) for entry in state)
        return hidden, cell
