import math

import pytest
import torch
from torch import nn

from toponav.objectives import SharedRMSProp


def make_pair(seed: int = 0) -> tuple[nn.Linear, SharedRMSProp]:
    torch.manual_seed(seed)
    layer = nn.Linear(3, 2)
    return layer, SharedRMSProp(layer.parameters(), lr=0.1)


def take_steps(layer: nn.Linear, optimizer: torch.optim.Optimizer, num: int) -> None:
    generator = torch.Generator().manual_seed(0)
    for _ in range(num):
        optimizer.zero_grad()
        layer(torch.randn(4, 3, generator=generator)).square().sum().backward()
        optimizer.step()


def test_worked_numbers_of_two_updates() -> None:
    weight = nn.Parameter(torch.tensor([1.0]))
    optimizer = SharedRMSProp([weight], lr=0.5, decay=0.9, eps=0.1)
    for gradient in (2.0, 1.0):
        weight.grad = torch.tensor([gradient])
        optimizer.step()
    # g = 0.1 * 4 = 0.4, so 1 - 0.5 * 2 / sqrt(0.5); then g = 0.9 * 0.4 + 0.1 = 0.46.
    first = 1 - 1 / math.sqrt(0.5)
    assert weight.item() == pytest.approx(first - 0.5 / math.sqrt(0.56))


def test_the_constant_is_inside_the_root() -> None:
    """Equal to torch's rule for a constant of nearly nothing, far from it for 0.1."""
    moved = {}
    for eps in (1e-12, 0.1):
        for kind in (SharedRMSProp, torch.optim.RMSprop):
            weight = nn.Parameter(torch.tensor([1.0]))
            weight.grad = torch.tensor([0.01])
            name = "decay" if kind is SharedRMSProp else "alpha"
            kind([weight], lr=0.1, eps=eps, **{name: 0.99}).step()  # type: ignore[arg-type]
            moved[kind, eps] = 1 - weight.item()
    ours, theirs = SharedRMSProp, torch.optim.RMSprop
    assert moved[ours, 1e-12] == pytest.approx(moved[theirs, 1e-12], rel=1e-3)
    # 0.1 * 0.01 / sqrt(1e-6 + 0.1) against 0.1 * 0.01 / (1e-3 + 0.1)
    assert moved[ours, 0.1] == pytest.approx(0.00316, rel=0.01)
    assert moved[theirs, 0.1] == pytest.approx(0.0099, rel=0.01)


def test_parameters_without_a_gradient_stay() -> None:
    layer, optimizer = make_pair()
    bias = layer.bias.clone()
    layer.weight.grad = torch.ones_like(layer.weight)
    optimizer.step()
    assert torch.equal(layer.bias, bias)
    optimizer.zero_grad()
    optimizer.step()


def test_groups_have_their_own_settings() -> None:
    still, moving = nn.Parameter(torch.ones(1)), nn.Parameter(torch.ones(1))
    groups = [{"params": [still], "lr": 0.0}, {"params": [moving]}]
    optimizer = SharedRMSProp(groups, lr=0.1)
    still.grad = moving.grad = torch.ones(1)
    optimizer.step()
    assert still == 1
    assert moving < 1


def test_a_group_that_is_added_learns_as_the_first_ones_do() -> None:
    first, added = nn.Parameter(torch.ones(1)), nn.Parameter(torch.ones(1))
    optimizer = SharedRMSProp([first], lr=0.1)
    optimizer.add_param_group({"params": added})
    first.grad = added.grad = torch.ones(1)
    optimizer.step()
    assert added == first < 1
    assert optimizer.state[added] == optimizer.state[first]


def test_it_goes_on_from_its_state_dict() -> None:
    layer, optimizer = make_pair()
    take_steps(layer, optimizer, 3)
    other_layer, other = make_pair(1)
    other_layer.load_state_dict(layer.state_dict())
    other.load_state_dict(optimizer.state_dict())
    for pair in ((layer, optimizer), (other_layer, other)):
        take_steps(*pair, 3)
    assert torch.equal(layer.weight, other_layer.weight)


def test_mean_squares_stay_shared_through_loading() -> None:
    layer, optimizer = make_pair()
    mean_square = optimizer.share_memory().state[layer.weight]["mean_square"]
    assert mean_square.is_shared()
    other_layer, other = make_pair(1)
    take_steps(other_layer, other, 2)
    optimizer.load_state_dict(other.state_dict())
    assert optimizer.state[layer.weight]["mean_square"] is mean_square
    expected = other.state[other_layer.weight]["mean_square"]
    assert torch.equal(mean_square, expected)


def update_elsewhere(layer: nn.Linear, mean_square: torch.Tensor) -> None:
    optimizer = SharedRMSProp([layer.weight], lr=0.1)
    optimizer.state[layer.weight]["mean_square"] = mean_square
    layer.weight.grad = torch.ones_like(layer.weight)
    optimizer.step()


@pytest.mark.slow
def test_an_update_of_another_process_is_seen() -> None:
    layer, optimizer = make_pair()
    layer.share_memory()
    optimizer.share_memory()
    before = layer.weight.clone()
    mean_square = optimizer.state[layer.weight]["mean_square"]
    process = torch.multiprocessing.get_context("spawn").Process(
        target=update_elsewhere, args=(layer, mean_square)
    )
    process.start()
    process.join(60)
    assert process.exitcode == 0
    torch.testing.assert_close(mean_square, torch.full_like(mean_square, 0.01))
    assert (layer.weight < before).all()


def test_a_closure_gives_the_loss() -> None:
    weight = nn.Parameter(torch.tensor([2.0]))
    optimizer = SharedRMSProp([weight], lr=0.1)

    def closure() -> float:
        loss = weight.square().sum()
        loss.backward()
        return loss.item()

    assert optimizer.step(closure) == 4
    assert weight < 2


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"lr": -1.0}, "lr must not be negative, got -1.0"),
        ({"decay": 1.0}, "decay must be at least 0 and below 1, got 1.0"),
        ({"eps": 0.0}, "eps must be above 0, got 0.0"),
    ],
)
def test_arguments_out_of_range_are_refused(
    settings: dict[str, float], sentence: str
) -> None:
    with pytest.raises(ValueError, match=sentence):
        SharedRMSProp([nn.Parameter(torch.ones(1))], **settings)  # type: ignore[arg-type]
