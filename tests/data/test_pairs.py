import pytest
import torch
from tensordict import TensorDict

from toponav.data import Episodes
from toponav.data.pair_rules import (
    distance_weights,
    draw_below,
    draw_near,
    gather_pairs,
)


def test_every_distance_weighs_the_same() -> None:
    weight = distance_weights(torch.tensor([1, 1, 1, 2, 4, 4]), 4)
    # Three distances occur, so a third each: 3 * 1/9, 1 * 1/3, 2 * 1/6.
    expected = torch.tensor([1 / 9, 1 / 9, 1 / 9, 1 / 3, 1 / 6, 1 / 6])
    torch.testing.assert_close(weight, expected)


def test_no_pairs_no_weights() -> None:
    assert distance_weights(torch.zeros(0, dtype=torch.int64), 4).shape == (0,)


def test_draw_below_fills_its_range() -> None:
    limit = torch.tensor([1, 3]).repeat(500, 1)
    value = draw_below(limit, torch.Generator().manual_seed(0))
    assert set(value[:, 0].tolist()) == {0}
    assert set(value[:, 1].tolist()) == {0, 1, 2}


def test_anchors_at_a_distance_are_uniform_over_those_with_a_partner() -> None:
    episodes = Episodes.from_lengths([2, 5, 1, 4])
    place = draw_near(episodes, 36_000, 3, torch.Generator().manual_seed(0))
    place = place[place[:, 1] - place[:, 0] == 3][:12_000]
    assert len(place) > 11_500
    # Lengths 5 and 4 have 2 and 1 frames with a partner 3 later: places 2, 3 and 8.
    anchors, count = place[:, 0].unique(return_counts=True)
    assert anchors.tolist() == [2, 3, 8]
    # A third each, with a standard deviation of sqrt(12000 * 1/3 * 2/3) = 52.
    assert (count - len(place) / 3).abs().max() < 4 * 52


def test_gathered_views_carry_gradients() -> None:
    views = torch.arange(6.0).reshape(2, 3, 1).requires_grad_()
    frames = TensorDict({"embedding": views}, [2, 3])
    numbers = {"pair": torch.tensor([[0, 4], [5, 0]]), "label": torch.tensor([1.0, 0])}
    pairs = gather_pairs(frames, TensorDict(numbers, [2]))
    assert pairs["label"].tolist() == [1, 0]
    assert "pair" not in pairs
    assert pairs["anchor"].flatten().tolist() == [0, 5]
    assert pairs["other"].flatten().tolist() == [4, 0]
    pairs["anchor"].sum().backward()
    assert views.grad is not None
    assert views.grad.flatten().tolist() == [1, 0, 0, 0, 0, 1]


@pytest.mark.parametrize("seed", [0, 1])
def test_drawing_is_seeded(seed: int) -> None:
    limit = torch.full((50,), 1000)
    one = draw_below(limit, torch.Generator().manual_seed(seed))
    assert torch.equal(one, draw_below(limit, torch.Generator().manual_seed(seed)))
    assert not torch.equal(one, draw_below(limit, torch.Generator().manual_seed(7)))
