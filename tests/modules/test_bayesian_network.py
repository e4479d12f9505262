"""Divergences and information gains against numbers worked out and exact steps."""

import copy
import math

import pytest
import torch
from torch import Tensor

from toponav.modules import BayesianNetwork
from toponav.modules.bayesian_network import GaussianLinear, gaussian_divergence


def make_network(seed: int = 0) -> BayesianNetwork:
    torch.manual_seed(seed)
    return BayesianNetwork(3, 2, hidden=8, noise_deviation=1.0, draws=4)


def draw_outcomes(num: int = 6) -> tuple[Tensor, Tensor]:
    generator = torch.Generator().manual_seed(0)
    inputs = torch.randn(num, 3, generator=generator)
    return inputs, torch.randn(num, 2, generator=generator)


def test_divergence_of_two_gaussians() -> None:
    # KL(N(1, 0.5^2) || N(3, 2^2)) = log(2 / 0.5) + (0.5^2 + 2^2) / (2 * 2^2) - 1/2
    #                              = 1.386294 + 0.53125 - 0.5 = 1.417544
    found = gaussian_divergence(*torch.tensor([1.0, 0.5, 3.0, 2.0]))
    assert float(found) == pytest.approx(1.417544, abs=1e-6)
    # The other way round: log(0.5 / 2) + (2^2 + 2^2) / (2 * 0.5^2) - 1/2 = 14.113706
    found = gaussian_divergence(*torch.tensor([3.0, 2.0, 1.0, 0.5]))
    assert float(found) == pytest.approx(14.113706, abs=1e-6)


def test_a_layer_starts_at_the_priors_deviation() -> None:
    layer = GaussianLinear(3, 2)
    torch.testing.assert_close(layer.deviation, torch.full((2, 4), 0.5))
    # Of each weight its mean alone: mean^2 / (2 * 0.5^2).
    expected = (layer.mean.square() / 0.5).sum()
    torch.testing.assert_close(layer.divergence(), expected)


def test_local_reparametrisation_has_the_spread_of_drawn_weights() -> None:
    torch.manual_seed(0)
    layer = GaussianLinear(2, 1).requires_grad_(False)
    inputs = torch.tensor([[[3.0, 4.0, 1.0]]])
    # 0.5 * sqrt(3^2 + 4^2 + 1)
    assert float(layer.spread(inputs)) == pytest.approx(0.5 * math.sqrt(26))
    drawn = layer.mean + layer.deviation * torch.randn(20_000, 3)
    spread = float((drawn @ inputs[0, 0]).std())
    assert float(layer.spread(inputs)) == pytest.approx(spread, rel=0.02)


def take_step(network: BayesianNetwork, one: slice, step: float, seed: int) -> Tensor:
    """The exact KL of the weights after one natural gradient step on one outcome."""
    inputs, outcomes = draw_outcomes()
    moved = copy.deepcopy(network)
    torch.manual_seed(seed)
    moved.loss(moved(inputs[one]), outcomes[one], prior_weight=0.0).backward()
    total = torch.zeros(())
    for new, old in zip(moved.layers, network.layers, strict=True):
        deviation = old.deviation.detach()
        # d softplus / d rho
        slope = torch.sigmoid(old.rho.detach())
        with torch.no_grad():
            new.mean -= step * deviation**2 * new.mean.grad
            new.rho -= step * deviation**2 / (2 * slope**2) * new.rho.grad
            total += gaussian_divergence(
                new.mean, new.deviation, old.mean, deviation
            ).sum()
    return total


def test_the_fast_form_is_the_exact_divergence_of_a_small_step() -> None:
    network = make_network()
    inputs, outcomes = draw_outcomes()
    for number in range(len(inputs)):
        one = slice(number, number + 1)
        torch.manual_seed(7)
        fast = network.information_gain(inputs[one], outcomes[one], step=1e-3)
        exact = take_step(network, one, 1e-3, seed=7)
        torch.testing.assert_close(fast[0], exact, rtol=0.02, atol=0)


def test_each_outcome_is_judged_alone_and_nothing_moves() -> None:
    network = make_network()
    before = copy.deepcopy(network.state_dict())
    inputs, outcomes = draw_outcomes()
    torch.manual_seed(3)
    together = network.information_gain(inputs, outcomes, step=0.01)
    torch.manual_seed(3)
    alone = network.information_gain(inputs[2:3], outcomes[2:3], step=0.01)
    torch.testing.assert_close(together[2:3], alone)
    assert not together.requires_grad
    assert all(
        torch.equal(before[key], now) for key, now in network.state_dict().items()
    )
    # Quadratic in the step.
    torch.manual_seed(3)
    double = network.information_gain(inputs, outcomes, step=0.02)
    torch.testing.assert_close(double, 4 * together)


def test_what_was_learned_teaches_less() -> None:
    network = make_network()
    inputs, outcomes = draw_outcomes(64)
    outcomes = torch.stack([inputs.sum(-1), inputs[:, 0]], -1)
    before = network.information_gain(inputs, outcomes, step=0.01).median()
    optimizer = torch.optim.Adam(network.parameters(), lr=0.02)
    for _ in range(150):
        optimizer.zero_grad()
        network.loss(network(inputs), outcomes, prior_weight=0.1).backward()
        optimizer.step()
    after = network.information_gain(inputs, outcomes, step=0.01).median()
    strange = network.information_gain(inputs, outcomes + 5, step=0.01).median()
    assert after < 0.5 * before
    assert strange > 5 * after
