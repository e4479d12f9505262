import copy

import pytest
import torch
from torch import nn

from toponav.modules import ConcatComparator, DifferenceComparator

Comparator = ConcatComparator | DifferenceComparator


def make_comparators() -> list[Comparator]:
    torch.manual_seed(0)
    return [ConcatComparator(64), DifferenceComparator(64)]


@pytest.fixture(params=[0, 1], ids=["concat", "difference"])
def comparator(request: pytest.FixtureRequest) -> Comparator:
    return make_comparators()[request.param]


def test_concat_has_the_paper_s_layers() -> None:
    widths = [(m.in_features, m.out_features) for m in linears(ConcatComparator(512))]
    assert widths == [(1024, 512), (512, 512), (512, 512), (512, 512), (512, 1)]


def linears(module: nn.Module) -> list[nn.Linear]:
    return [m for m in module.modules() if isinstance(m, nn.Linear)]


def test_split_form_equals_the_perceptron_on_the_concatenation() -> None:
    comparator = ConcatComparator(64, hidden=(32, 16))
    plain = nn.Sequential(
        nn.Linear(128, 32), nn.ReLU(), nn.Linear(32, 16), nn.ReLU(), nn.Linear(16, 1)
    )
    for ours, theirs in zip(linears(comparator), linears(plain), strict=True):
        theirs.load_state_dict(ours.state_dict())
    embedding, memory = torch.randn(3, 64), torch.randn(3, 50, 64)
    both = torch.cat([embedding.unsqueeze(1).expand(3, 50, 64), memory], dim=-1)
    split = comparator.compare(embedding, comparator.prepare(memory))
    # Equal to the rounding of float32: only the order of the sum differs.
    torch.testing.assert_close(split, plain(both).squeeze(-1), rtol=1e-5, atol=1e-6)


def test_difference_by_hand() -> None:
    comparator = DifferenceComparator(2, projection_dim=2, hidden=(1,))
    weights = [torch.eye(2), torch.ones(1, 4), torch.ones(1, 1)]
    for layer, weight in zip(linears(comparator), weights, strict=True):
        layer.weight.data = weight
        layer.bias.data.zero_()
    anchor, other = torch.tensor([1.0, 2.0]), torch.tensor([3.0, -1.0])
    # |1-3| + |2+1| + 1*3 + 2*(-1) = 6
    assert comparator(anchor, other).item() == pytest.approx(6)


def test_difference_is_symmetric_and_concat_is_not() -> None:
    concat, difference = make_comparators()
    a, b = torch.randn(2, 10, 64)
    assert torch.equal(difference(a, b), difference(b, a))
    assert not torch.allclose(concat(a, b), concat(b, a))


@pytest.mark.parametrize("batch", [(), (3,), (2, 3)])
def test_memory_form_equals_the_pair_call(
    comparator: Comparator, batch: tuple[int, ...]
) -> None:
    embedding, memory = torch.randn(*batch, 64), torch.randn(*batch, 7, 64)
    logit = comparator.compare(embedding, comparator.prepare(memory))
    pairs = comparator(embedding.unsqueeze(-2).expand_as(memory), memory)
    assert logit.shape == (*batch, 7)
    torch.testing.assert_close(logit, pairs, rtol=1e-5, atol=1e-6)


def test_bfloat16_agrees_at_the_thresholds(comparator: Comparator) -> None:
    # Spread the logits over the thresholds in use, as a trained network does.
    embedding, memory = torch.randn(8, 64), torch.randn(8, 200, 64)
    logit = comparator.compare(embedding, comparator.prepare(memory))
    last = linears(comparator)[-1]
    last.weight.data *= 3 / logit.std()
    last.bias.data -= logit.mean() * 3 / logit.std()
    exact = comparator.compare(embedding, comparator.prepare(memory)).sigmoid()
    rough_comparator = copy.deepcopy(comparator).to(torch.bfloat16)
    half = torch.bfloat16
    prepared = rough_comparator.prepare(memory.to(half))
    rough = rough_comparator.compare(embedding.to(half), prepared).float().sigmoid()
    for threshold in (0.5, 0.7, 0.9):
        agree = (exact > threshold) == (rough > threshold)
        assert agree.float().mean() > 0.98
        # Where they disagree, the exact value was at the threshold anyway.
        assert bool(((exact[~agree] - threshold).abs() < 0.05).all())


def test_gradients_reach_every_parameter(comparator: Comparator) -> None:
    comparator(torch.randn(32, 64), torch.randn(32, 64)).sum().backward()
    for name, parameter in comparator.named_parameters():
        assert parameter.grad is not None, name
        assert parameter.grad.abs().sum() > 0, name


@pytest.mark.parametrize("kind", [ConcatComparator, DifferenceComparator])
@pytest.mark.parametrize("hidden", [(), (16, 0)])
def test_widths_are_checked(kind: type[Comparator], hidden: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match="at least one width >= 1, got"):
        kind(8, hidden=hidden)
