"""`EpisodicLSTM`: an LSTM whose state starts from zero with every episode."""

from itertools import pairwise

import torch
from torch import Tensor, nn

#: Hidden and cell state, each ``[N, H]``.
State = tuple[Tensor, Tensor]


class EpisodicLSTM(nn.Module):
    """One LSTM layer over slices, its state zeroed where ``is_init`` is set.

    Acting calls `step`, training the module, which splits a slice where any of its rows
    begins an episode, for torch's fused kernel.

    Examples:
        >>> lstm = EpisodicLSTM(8, 16)
        >>> state = (torch.zeros(4, 16), torch.zeros(4, 16))
        >>> is_init = torch.zeros(4, 20, dtype=torch.bool)
        >>> outputs, state = lstm(torch.zeros(4, 20, 8), state, is_init)
        >>> outputs.shape, state[0].shape
        (torch.Size([4, 20, 16]), torch.Size([4, 16]))
    """

    def __init__(self, input_dim: int, hidden_dim: int = 256) -> None:
        super().__init__()
        if min(input_dim, hidden_dim) < 1:
            raise ValueError(
                "input_dim and hidden_dim must be at least 1, got "
                f"{input_dim} and {hidden_dim}."
            )
        self.hidden_dim = hidden_dim
        self.lstm = nn.LSTM(input_dim, hidden_dim, batch_first=True)

    def step(self, inputs: Tensor, state: State, is_init: Tensor) -> State:
        """One decision: ``[N, D]``, the state before it, ``[N]`` to the state after."""
        # Its order: weights of the inputs and the state, biases of both.
        (weights,) = self.lstm.all_weights
        hidden, cell = torch.lstm_cell(inputs, _restart(state, is_init), *weights)
        return hidden, cell

    def forward(
        self, inputs: Tensor, state: State, is_init: Tensor
    ) -> tuple[Tensor, State]:
        """Outputs ``[N, T, H]`` of a slice, ``[N, T, D]``, and the state after it."""
        inner = is_init[:, 1:].any(0).nonzero().flatten().add(1).tolist()
        bounds = [0, *inner, inputs.shape[1]]
        outputs = []
        for start, stop in pairwise(bounds):
            hidden, cell = _restart(state, is_init[:, start])
            piece, (hidden, cell) = self.lstm(
                inputs[:, start:stop], (hidden.unsqueeze(0), cell.unsqueeze(0))
            )
            state = hidden.squeeze(0), cell.squeeze(0)
            outputs.append(piece)
        return outputs[0] if len(outputs) == 1 else torch.cat(outputs, 1), state


def _restart(state: State, is_init: Tensor) -> State:
    # Filled, not multiplied: a NaN of the last episode must not survive.
    rows = is_init.unsqueeze(-1)
    return state[0].masked_fill(rows, 0), state[1].masked_fill(rows, 0)
