import copy
from pathlib import Path

import pytest
import torch
from tensordict import TensorDict
from tensordict.nn import TensorDictModule

from toponav.modules import (
    ConcatComparator,
    DifferenceComparator,
    SmallEncoder,
    TCNetwork,
)


def make_network(kind: type = ConcatComparator) -> TCNetwork:
    torch.manual_seed(0)
    return TCNetwork(SmallEncoder(32, image_size=(24, 32)), kind(32))


def pixels(*batch: int) -> torch.Tensor:
    return torch.randint(0, 256, (*batch, 24, 32, 3), dtype=torch.uint8)


@pytest.mark.parametrize("kind", [ConcatComparator, DifferenceComparator])
def test_the_three_entry_points_agree(kind: type) -> None:
    network = make_network(kind).eval()
    current, stored = pixels(2), pixels(2, 5)
    pairs = network(current.unsqueeze(1).expand_as(stored), stored).sigmoid()
    embedding, memory = network.embed(current), network.embed(stored)
    prepared = network.prepare_memory(memory)
    torch.testing.assert_close(network.compare(embedding, memory), pairs)
    torch.testing.assert_close(network.compare_prepared(embedding, prepared), pairs)


def test_comparing_gives_probabilities_in_float32_from_bfloat16() -> None:
    network = make_network().eval().to(torch.bfloat16)
    embedding = network.embed(pixels(2))
    tc = network.compare(embedding, network.embed(pixels(2, 5)))
    assert embedding.dtype == torch.bfloat16
    assert tc.dtype == torch.float32
    assert bool(((tc > 0) & (tc < 1)).all())


def test_batch_norm_sees_both_views_of_a_pair_at_once() -> None:
    network = make_network().train()
    calls: list[torch.Size] = []
    network.encoder.register_forward_pre_hook(
        lambda module, args: calls.append(args[0].shape)
    )
    network(pixels(4), pixels(4))
    assert calls == [torch.Size([2, 4, 24, 32, 3])]


def test_it_is_a_tensordict_module() -> None:
    module = TensorDictModule(
        make_network().eval(), in_keys=["anchor", "other"], out_keys=["logit"]
    )
    pairs = TensorDict({"anchor": pixels(3), "other": pixels(3)}, [3])
    assert module(pairs)["logit"].shape == (3,)


def test_it_overfits_one_batch() -> None:
    network = make_network()
    anchor, other = pixels(8), pixels(8)
    label = torch.tensor([0.0, 1.0]).repeat(4)
    optimizer = torch.optim.Adam(network.parameters(), lr=1e-3)
    for _ in range(40):
        loss = torch.nn.functional.binary_cross_entropy_with_logits(
            network(anchor, other), label
        )
        optimizer.zero_grad()
        loss.backward()
        optimizer.step()
    # From log 2 = 0.69.
    assert loss.item() < 0.05


def test_a_copy_and_a_loaded_network_give_the_same(tmp_path: Path) -> None:
    network, loaded = make_network().eval(), make_network().eval()
    torch.save(network.state_dict(), tmp_path / "tc.pt")
    loaded.load_state_dict(torch.load(tmp_path / "tc.pt", weights_only=True))
    a, b = pixels(2, 3)
    assert torch.equal(loaded(a, b), network(a, b))
    assert torch.equal(copy.deepcopy(network)(a, b), network(a, b))


def test_a_comparator_of_another_kind_is_refused() -> None:
    with pytest.raises(TypeError, match="got Linear without prepare, compare"):
        TCNetwork(torch.nn.Identity(), torch.nn.Linear(2, 2))  # type: ignore[arg-type]
