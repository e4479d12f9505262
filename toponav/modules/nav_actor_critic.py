"""`NavActorCritic`: the policy of Nav A3C, with a stacked LSTM and the velocity."""

from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor, nn
from torch.nn import functional as F  # noqa: N812

from toponav import keys
from toponav.keys import read_entry
from toponav.modules.actor_critic import ActorCritic, EpisodicLSTM, State

# Entries of a velocity: along three axes, and turns around them.
_VELOCITY = 6


class StackedLSTM(nn.Module):
    """Two LSTM layers: one remembers code and reward, the other all there is.

    The first is fed the code of the view and the previous reward; the second the code,
    the first one's output, the previous action and the velocity. Both states lie in one
    tensor, the first one's first; the output is the second one's.

    Args:
        code_dim: length C of the view's code.
        other_dim: length of the previous action and the velocity together.
        first_dim, hidden_dim: lengths of the two states.

    Examples:
        >>> lstm = StackedLSTM(8, other_dim=3, first_dim=4, hidden_dim=16)
        >>> state = (torch.zeros(5, 20), torch.zeros(5, 20))
        >>> inputs, is_init = torch.zeros(5, 7, 8 + 1 + 3), torch.zeros(5, 7).bool()
        >>> lstm(inputs, state, is_init).shape
        torch.Size([5, 7, 16])
    """

    def __init__(
        self, code_dim: int, *, other_dim: int, first_dim: int, hidden_dim: int
    ) -> None:
        super().__init__()
        self.code_dim = code_dim
        self.sizes = [first_dim, hidden_dim]
        self.state_dim = sum(self.sizes)
        self.first = EpisodicLSTM(code_dim + 1, first_dim)
        self.second = EpisodicLSTM(code_dim + first_dim + other_dim, hidden_dim)

    def step(self, inputs: Tensor, state: State, is_init: Tensor) -> State:
        """One decision: code, reward, action and velocity ``[N, D]``, and the state."""
        earlier, later = self._split(state)
        first = self.first.step(inputs[..., : self.code_dim + 1], earlier, is_init)
        second = self.second.step(self._join(inputs, first[0]), later, is_init)
        return torch.cat([first[0], second[0]], -1), torch.cat([first[1], second[1]], 1)

    def forward(self, inputs: Tensor, state: State, is_init: Tensor) -> Tensor:
        """Outputs ``[N, T, H]`` of a slice ``[N, T, D]``, from the state before it."""
        earlier, later = self._split(state)
        first = self.first(inputs[..., : self.code_dim + 1], earlier, is_init)
        outputs: Tensor = self.second(self._join(inputs, first), later, is_init)
        return outputs

    def _split(self, state: State) -> tuple[State, State]:
        (hidden, *other), (cell, *rest) = (one.split(self.sizes, -1) for one in state)
        return (hidden, cell), (other[0], rest[0])

    def _join(self, inputs: Tensor, first: Tensor) -> Tensor:
        code, others = inputs[..., : self.code_dim], inputs[..., self.code_dim + 1 :]
        return torch.cat([code, first, others], -1)


class NavActorCritic(ActorCritic):
    """`ActorCritic` of pixels with a `StackedLSTM` that also feels its velocity.

    Envs need ``MazeEnv(velocity=True)`` beside the transforms of `ActorCritic`.

    Reference:
        Mirowski et al., "Learning to Navigate in Complex Environments" (2016); the
        paper, "Nav A3C model" (Fig. 3).

    Args:
        step: map units of the fastest action, by which velocities are divided.
        turn: degrees of the fastest turn, likewise.
        first_dim: length of the first LSTM's state.
        kwargs: those of `ActorCritic` but for ``layers``; ``hidden_dim`` is of the
            second LSTM.

    Examples:
        >>> policy = NavActorCritic(step=33.0, turn=20.0, num_actions=6)
        >>> policy.initial_state(5)["hidden"].shape
        torch.Size([5, 320])
    """

    velocity_scale: Tensor

    def __init__(
        self, *, step: float, turn: float, first_dim: int = 64, **kwargs: Any
    ) -> None:
        self.first_dim = first_dim
        super().__init__(**kwargs)
        if self.layers != 1:
            # Its own two are of different sizes, and read different things.
            raise ValueError(f"layers must be 1, got {self.layers}.")
        scale = torch.tensor([step] * 3 + [turn] * 3).reciprocal()
        self.register_buffer("velocity_scale", scale, persistent=False)
        self.in_keys = [*self.in_keys, keys.VELOCITY]

    def make_lstm(self) -> nn.Module:
        return StackedLSTM(
            self.code_dim,
            other_dim=self.num_actions + 1 + _VELOCITY,
            first_dim=self.first_dim,
            hidden_dim=self.hidden_dim,
        )

    def _lstm_inputs(self, tensordict: TensorDictBase) -> Tensor:
        code: Tensor = self.trunk(read_entry(tensordict, self.view_key))
        reward = read_entry(tensordict, keys.PREVIOUS_REWARD).to(code.dtype)
        action = read_entry(tensordict, keys.PREVIOUS_ACTION).squeeze(-1)
        one_hot = F.one_hot(action, self.num_actions + 1).to(code.dtype)
        velocity = read_entry(tensordict, keys.VELOCITY) * self.velocity_scale
        inputs = torch.cat([code, reward, one_hot, velocity.to(code.dtype)], -1)
        return inputs.reshape(-1, inputs.shape[-1])
