"""Weights in files are compared with those of a network before it takes memory."""

import pytest
import torch
from torch import nn

from tests.damaged import OTHER_SIZES
from toponav.modules.scaled_mlp import ScaledMLP
from toponav.runs import load_weights, read_counts, require_like
from toponav.runs.weights import not_finite


def make() -> nn.Module:
    return nn.Sequential(nn.Linear(3, 2), nn.BatchNorm1d(2))


def test_weights_are_taken_as_they_are() -> None:
    weights = make().state_dict()
    before = torch.get_rng_state()
    like = make().state_dict()
    drawn = torch.get_rng_state()
    torch.set_rng_state(before)
    found = load_weights(make, weights)
    assert not found.training
    for name, one in found.state_dict().items():
        assert torch.equal(one, weights[name]), name
    assert like.keys() == weights.keys()
    # Where it has no memory, nothing is drawn: later draws are those of one network.
    assert torch.equal(torch.get_rng_state(), drawn)


def test_one_that_is_missing_or_more_is_named() -> None:
    like = make().state_dict()
    less = {name: one for name, one in like.items() if name != "1.bias"}
    for weights in (less, {**like, "0.more": torch.zeros(1)}):
        (name,) = like.keys() ^ weights.keys()
        with pytest.raises(ValueError, match=f"^{name} is there or is missing"):
            require_like(weights, like)


def test_half_will_do_where_it_is_asked_for() -> None:
    like = make().state_dict()
    half = make().half().state_dict()
    require_like(half, like, rounded=True)
    with pytest.raises(ValueError, match=r"^0.weight is torch.float16 .*not torch.fl"):
        require_like(half, like)
    # A count of batches is none that could be rounded.
    half["1.num_batches_tracked"] = torch.tensor(3.0).half()
    with pytest.raises(ValueError, match=r"_tracked is .*.float16 .*not torch.int64"):
        require_like(half, like, rounded=True)


def test_what_inputs_are_scaled_by_is_above_zero() -> None:
    like = make().state_dict()
    weights = like | {"1.running_var": torch.tensor([0.5, -0.1])}
    with pytest.raises(ValueError, match=r"^1.running_var has a number below 0$"):
        require_like(weights, like)
    # Where an input was always the same, batches leave a variance of zero.
    require_like(like | {"1.running_var": torch.zeros(2)}, like)
    scaled = ScaledMLP(2, 3, [4]).state_dict()
    with pytest.raises(ValueError, match=r"^spread has a number below 1e-06$"):
        require_like(scaled | {"spread": torch.tensor([1.0, 0.0])}, scaled)


def test_numbers_are_those_of_float32() -> None:
    # The greatest is 3.4e38.
    found = {"optimizer": {"step": torch.tensor(1e39, dtype=torch.float64)}}
    assert list(not_finite(found)) == ["NaN or infinity in optimizer.step"]


@pytest.mark.parametrize("bad", [*OTHER_SIZES, 0], ids=lambda bad: str(bad)[:9])
def test_sizes_are_counts(bad: object) -> None:
    rule = f"^hidden must be a count below 2147483648, got {type(bad).__name__}$"
    with pytest.raises(ValueError, match=rule):
        read_counts({"hidden": bad}, ["hidden"])
    with pytest.raises(ValueError, match=r"^sizes must have names, got "):
        read_counts(bad, ["hidden"])  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "name", ["weights", "policy", "optimizer", "head", "reward", "offsets", "ground"]
)
def test_what_is_trained_is_finite(name: str) -> None:
    bad = {"a": {"mean": torch.tensor([1.0, torch.nan])}}
    assert list(not_finite({name: bad})) == [f"NaN or infinity in {name}.a.mean"]
    # What nobody trains may be none, such as the similarity of an edge by time.
    assert list(not_finite({"edges": bad})) == []
