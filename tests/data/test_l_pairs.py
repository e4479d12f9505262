import pytest
import torch
from hypothesis import given, settings, strategies as st
from tensordict import TensorDict

from toponav.data import Episodes, LPairs
from toponav.keys import EPISODE, STEP


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


@settings(max_examples=60, deadline=None)
@given(
    lengths=st.lists(st.integers(1, 20), max_size=8),
    k=st.integers(1, 6),
    seed=st.integers(0, 1000),
)
def test_the_earlier_view_comes_first_and_no_episode_is_left(
    lengths: list[int], k: int, seed: int
) -> None:
    episodes = Episodes.from_lengths([*lengths, k + 1])
    place, extra = LPairs(k).draw(episodes, 64, generator(seed))
    distance = place[:, 1] - place[:, 0]
    run = episodes.run_of(place)
    assert extra == {}
    assert bool(((distance >= 1) & (distance <= k)).all())
    assert torch.equal(run[:, 0], run[:, 1])


def test_distances_are_uniform() -> None:
    place, _ = LPairs(4).draw(Episodes.from_lengths([6, 9]), 10_000, generator())
    count = (place[:, 1] - place[:, 0]).bincount(minlength=5)[1:]
    # 2500 each, standard deviation 43.
    assert (count - 2500).abs().max() < 4 * 43


def test_exact_pairs_are_all_k_decisions_apart() -> None:
    episodes = Episodes.from_lengths([5, 9, 3])
    place, _ = LPairs(4, exact=True).draw(episodes, 500, generator())
    assert (place[:, 1] - place[:, 0] == 4).all()
    # Of 5 views one has such a partner, of 9 five, of 3 none: six pairs, all alike.
    anchors, counts = place[:, 0].unique(return_counts=True)
    assert anchors.tolist() == [0, *range(5, 10)]
    assert (counts - 500 / 6).abs().max() < 4 * 8.4
    frames = TensorDict(
        {
            "embedding": torch.arange(5.0).unsqueeze(-1),
            "action": torch.arange(5),
            EPISODE: torch.tensor([0, 0, 0, 7, 7]),
            STEP: torch.tensor([10, 11, 12, 11, 13]),
        },
        [5],
    )
    mined = LPairs(2, exact=True).mine(frames)
    assert mined["anchor"].flatten().tolist() == [0.0, 3.0]
    assert mined["other"].flatten().tolist() == [2.0, 4.0]
    assert mined["weight"].tolist() == [0.5, 0.5]


def test_the_same_seed_gives_the_same_pairs() -> None:
    episodes = Episodes.from_lengths([50, 60])
    one, two, three = (LPairs().draw(episodes, 64, generator(s))[0] for s in (1, 1, 2))
    assert torch.equal(one, two)
    assert not torch.equal(one, three)


def test_mined_pairs_by_hand() -> None:
    frames = TensorDict(
        {
            "embedding": torch.arange(5.0).unsqueeze(-1),
            "action": torch.tensor([5, 4, 3, 2, 1]),
            EPISODE: torch.tensor([0, 0, 0, 7, 7]),
            STEP: torch.tensor([10, 11, 12, 11, 13]),
        },
        [5],
    ).reshape(5, 1)
    pairs = LPairs(2).mine(frames)
    one_hot = torch.nn.functional.one_hot(frames["action"], 6)
    other = LPairs(2).mine(frames.copy().set("action", one_hot))
    assert torch.equal(other["action"], pairs["action"])
    found = {
        (int(a), int(b), int(action)): float(weight)
        for a, b, action, weight in zip(
            *(pairs[key] for key in ("anchor", "other", "action", "weight")),
            strict=True,
        )
    }
    # Distance 1: 0-1 and 1-2; distance 2: 0-2 and 3-4. Half a distance, half a pair.
    # The action is that of the earlier view.
    assert found == {
        (0, 1, 5): 0.25,
        (1, 2, 4): 0.25,
        (0, 2, 5): 0.25,
        (3, 4, 2): 0.25,
    }


def test_too_short_a_buffer_is_refused() -> None:
    match = r"at least 5 decisions \(more than max_action_distance\), got 4 at most"
    with pytest.raises(ValueError, match=match):
        LPairs(4).draw(Episodes.from_lengths([4, 2]), 8, None)
    with pytest.raises(ValueError, match="must be at least 1, got 0"):
        LPairs(0)
