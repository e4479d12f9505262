import pytest
import torch
from hypothesis import given, settings, strategies as st
from torch import Tensor

from toponav.modules import EpisodicLSTM


def unrolled(
    lstm: EpisodicLSTM, inputs: Tensor, state: tuple[Tensor, Tensor], is_init: Tensor
) -> Tensor:
    """The reference: the equations of an LSTM, one decision after the other."""
    states = list(zip(*(one.split(5, -1) for one in state), strict=True))
    outputs = []
    for step in range(inputs.shape[1]):
        keep = 1 - is_init[:, step].float().unsqueeze(-1)
        read = inputs[:, step]
        for number, (hidden, cell) in enumerate(states):
            names = "weight_ih", "weight_hh", "bias_ih", "bias_hh"
            of_inputs, of_state, bias, other = (
                getattr(lstm.lstm, f"{name}_l{number}") for name in names
            )
            gates = read @ of_inputs.T + bias + hidden * keep @ of_state.T + other
            enter, forget, value, leave = gates.chunk(4, -1)
            now = forget.sigmoid() * cell * keep + enter.sigmoid() * value.tanh()
            read = leave.sigmoid() * now.tanh()
            states[number] = read, now
        outputs.append(read)
    return torch.stack(outputs, 1)


@settings(max_examples=30, deadline=None)
@given(
    seed=st.integers(0, 1000),
    rows=st.integers(1, 4),
    steps=st.integers(1, 7),
    share=st.sampled_from([0.0, 0.2, 1.0]),
    layers=st.integers(1, 3),
)
def test_slices_equal_the_equations(
    seed: int, rows: int, steps: int, share: float, layers: int
) -> None:
    torch.manual_seed(seed)
    lstm = EpisodicLSTM(3, 5, layers=layers)
    inputs = torch.randn(rows, steps, 3)
    state = (torch.randn(rows, layers * 5), torch.randn(rows, layers * 5))
    is_init = torch.rand(rows, steps) < share
    outputs = lstm(inputs, state, is_init)
    torch.testing.assert_close(outputs, unrolled(lstm, inputs, state, is_init))


def test_gradients_equal_those_of_the_equations_across_an_episode_s_start() -> None:
    torch.manual_seed(0)
    lstm = EpisodicLSTM(3, 5)
    state = (torch.randn(2, 5), torch.randn(2, 5))
    is_init = torch.zeros(2, 6, dtype=torch.bool)
    is_init[1, 3] = True
    inputs = torch.randn(2, 6, 3)
    gradients = []
    for run in (lstm, lambda *a: unrolled(lstm, *a)):
        given_inputs = inputs.clone().requires_grad_()
        outputs = run(given_inputs, state, is_init)
        outputs[:, -1].sum().backward()
        gradients.append([given_inputs.grad, *(p.grad for p in lstm.parameters())])
        lstm.zero_grad()
    torch.testing.assert_close(gradients[0], gradients[1])
    # The last output depends on the first input, unless an episode began between.
    assert gradients[0][0][0, 0].any()
    assert not gradients[0][0][1, :3].any()


@pytest.mark.parametrize("layers", [1, 2])
def test_steps_equal_slices(layers: int) -> None:
    torch.manual_seed(0)
    lstm = EpisodicLSTM(3, 5, layers=layers)
    inputs, is_init = torch.randn(4, 6, 3), torch.rand(4, 6) < 0.3
    state = start = (torch.randn(4, layers * 5), torch.randn(4, layers * 5))
    hiddens = []
    for step in range(6):
        state = lstm.step(inputs[:, step], state, is_init[:, step])
        hiddens.append(state[0][:, -5:])
    outputs = lstm(inputs, start, is_init)
    torch.testing.assert_close(torch.stack(hiddens, 1), outputs)


def test_a_nan_does_not_outlive_its_episode() -> None:
    lstm = EpisodicLSTM(3, 5)
    state = (torch.full((1, 5), torch.nan), torch.full((1, 5), torch.nan))
    true = torch.ones(1, 1, dtype=torch.bool)
    assert lstm.step(torch.zeros(1, 3), state, true[0])[0].isfinite().all()
    assert lstm(torch.zeros(1, 1, 3), state, true).isfinite().all()


def test_lengths_below_one_are_refused() -> None:
    with pytest.raises(ValueError, match="must be greater than zero"):
        EpisodicLSTM(0, 5)
