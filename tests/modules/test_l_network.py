import copy

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule
from torch import nn

from toponav.modules import (
    DifferenceComparator,
    LNetwork,
    LocomotionHead,
    SmallEncoder,
    TCNetwork,
)


def make_network() -> LNetwork:
    torch.manual_seed(0)
    return LNetwork(
        SmallEncoder(32, image_size=(24, 32)), LocomotionHead(32, num_actions=6)
    )


def pixels(*batch: int) -> torch.Tensor:
    return torch.randint(0, 256, (*batch, 24, 32, 3), dtype=torch.uint8)


def test_the_head_has_the_paper_s_layers() -> None:
    widths = [
        (layer.in_features, layer.out_features)
        for layer in LocomotionHead(num_actions=6).modules()
        if isinstance(layer, nn.Linear)
    ]
    assert widths == [(1024, 512), (512, 512), (512, 6)]


@pytest.mark.parametrize("batch", [(), (2,), (2, 3)])
def test_views_give_the_logits_of_their_embeddings(batch: tuple[int, ...]) -> None:
    network = make_network().eval()
    here, there = pixels(*batch), pixels(*batch)
    logits = network(here, there)
    assert logits.shape == (*batch, 6)
    expected = network.head(network.encoder(here), network.encoder(there))
    torch.testing.assert_close(logits, expected, rtol=1e-5, atol=1e-6)


def test_the_order_of_the_views_matters() -> None:
    network = make_network().eval()
    here, there = pixels(2, 3)
    assert not torch.allclose(network(here, there), network(there, here))


def test_an_encoder_can_be_shared_with_the_tc_network() -> None:
    network = make_network()
    tc_network = TCNetwork(network.encoder, DifferenceComparator(32))
    network(pixels(4), pixels(4)).sum().backward()
    gradients = [p.grad is not None for p in tc_network.encoder.parameters()]
    assert all(gradients)
    # A copy of both at once keeps them together.
    both = copy.deepcopy(nn.ModuleList([network, tc_network]))
    assert both[0].encoder is both[1].encoder


def test_it_and_its_head_are_tensordict_modules() -> None:
    network = make_network().eval()
    keys = {"in_keys": ["anchor", "other"], "out_keys": ["logits"]}
    views = TensorDict({"anchor": pixels(3), "other": pixels(3)}, [3])
    embeddings = views.apply(network.encoder)
    on_views = TensorDictModule(network, **keys)(views)
    on_embeddings = TensorDictModule(network.head, **keys)(embeddings)
    torch.testing.assert_close(on_views["logits"], on_embeddings["logits"])


def test_it_overfits_one_batch() -> None:
    network = make_network()
    here, there, action = pixels(12), pixels(12), torch.arange(12) % 6
    optimizer = torch.optim.Adam(network.parameters(), lr=1e-3)
    for _ in range(40):
        loss = nn.functional.cross_entropy(network(here, there), action)
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    # From log 6 = 1.79.
    assert loss.item() < 0.1


def test_sizes_are_checked() -> None:
    with pytest.raises(ValueError, match="widths >= 1, got"):
        LocomotionHead(8, num_actions=6, hidden=(4, 0))
    with pytest.raises(ValueError, match="at least 2, got 1"):
        LocomotionHead(8, num_actions=1)
