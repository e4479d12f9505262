import pytest
import torch
from hypothesis import given, settings, strategies as st
from tensordict import TensorDict

from toponav.data import Chunks, Episodes, TCPairs
from toponav.keys import EPISODE, STEP


def generator(seed: int = 0) -> torch.Generator:
    return torch.Generator().manual_seed(seed)


def draw(rule: TCPairs, episodes: Episodes, num: int, seed: int = 0) -> TensorDict:
    place, extra = rule.draw(episodes, num, generator(seed))
    run = episodes.run_of(place)
    return TensorDict(
        {
            "place": place,
            "run": run,
            "step": place - episodes.start[run],
            "distance": place[:, 1] - place[:, 0],
            "label": extra["label"],
        },
        [num],
    )


@settings(max_examples=80, deadline=None)
@given(
    lengths=st.lists(st.integers(1, 70), max_size=8),
    k=st.integers(1, 6),
    m=st.integers(2, 6),
    share=st.sampled_from([0.0, 0.3, 1.0]),
    seed=st.integers(0, 1000),
)
def test_pairs_obey_the_rule(
    lengths: list[int], k: int, m: int, share: float, seed: int
) -> None:
    episodes = Episodes.from_lengths([*lengths, m * k + 1, 5])
    pairs = draw(TCPairs(k, m, share), episodes, 100, seed)
    same = pairs["run"][:, 0] == pairs["run"][:, 1]
    close, distance = pairs["label"] == 1, pairs["distance"].abs()
    assert close.sum() == 50
    assert bool(((distance >= 1) & (distance <= k) & same)[close].all())
    assert bool((~same | (distance >= m * k))[~close].all())
    if share == 0:
        assert bool(same.all())
    if share == 1:
        assert not bool(same[~close].any())


def test_distances_order_and_shares_are_fair() -> None:
    num = 20_000
    pairs = draw(TCPairs(other_episode_share=0.3), Episodes.from_lengths([60] * 9), num)
    close = pairs["label"] == 1
    distance = pairs["distance"][close]
    # 10,000 positives over 4 distances: 2500 each, standard deviation 43.
    count = distance.abs().bincount(minlength=5)[1:]
    assert (count - 2500).abs().max() < 4 * 43
    # Half of them swapped: 5000, standard deviation 50.
    assert abs(int((distance < 0).sum()) - 5000) < 4 * 50
    across = (pairs["run"][:, 0] != pairs["run"][:, 1]).sum()
    # 30 % of 10,000 negatives, standard deviation 46.
    assert abs(int(across) - 3000) < 4 * 46


@pytest.mark.parametrize("length", [21, 30, 39, 40, 41, 90])
def test_negatives_are_uniform_over_anchors_then_partners(length: int) -> None:
    episodes = Episodes.from_lengths([3, length])
    pairs = draw(TCPairs(), episodes, 60_000)
    far = pairs["step"][pairs["label"] == 0]
    # By enumeration: each anchor with a partner alike, then each of its partners.
    gap = torch.arange(length).unsqueeze(0) - torch.arange(length).unsqueeze(1)
    fits = (gap.abs() >= 20).double()
    partners = fits.sum(1, keepdim=True)
    one_way = fits / partners.clamp(min=1) / (partners > 0).sum()
    expected = (one_way + one_way.T) / 2
    seen = torch.zeros(length, length).double()
    seen.index_put_(far.unbind(-1), torch.tensor(1.0).double(), accumulate=True)
    share = seen / len(far)
    deviation = (expected * (1 - expected) / len(far)).sqrt()
    assert bool((share[expected == 0] == 0).all())
    # Five deviations, since up to 5000 cells are looked at.
    assert bool(((share - expected).abs() <= 5 * deviation + 1e-12).all())


def test_runs_of_one_episode_never_count_as_different_episodes() -> None:
    # Places 0..9 and 10..39 belong to one episode with a gap, 40..69 to another.
    episodes = Episodes(
        order=torch.arange(70),
        start=torch.tensor([0, 10, 40]),
        length=torch.tensor([10, 30, 30]),
        first_step=torch.tensor([0, 50, 0]),
        group_start=torch.tensor([0, 0, 40]),
        group_length=torch.tensor([40, 40, 30]),
    )
    place, extra = TCPairs(other_episode_share=1.0).draw(episodes, 2000, generator())
    far = place[extra["label"] == 0]
    assert bool(((far < 40).sum(-1) == 1).all())
    assert set(far.flatten().tolist()) == set(range(70))


def test_the_same_seed_gives_the_same_pairs() -> None:
    episodes = Episodes.from_lengths([50, 60])
    rule = TCPairs(other_episode_share=0.5)
    one, two = draw(rule, episodes, 64, 1), draw(rule, episodes, 64, 1)
    assert bool((one == two).all())
    assert not torch.equal(one["place"], draw(rule, episodes, 64, 2)["place"])


def test_too_short_a_buffer_is_refused() -> None:
    match = r"at least 21 decisions \(more than M \* k = 5 \* 4\), got 20 at most"
    with pytest.raises(ValueError, match=match):
        TCPairs().draw(Episodes.from_lengths([20, 7]), 4, None)
    with pytest.raises(ValueError, match="at least two episodes"):
        TCPairs(other_episode_share=0.5).draw(Episodes.from_lengths([30]), 4, None)


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ({"max_action_distance": 0}, "max_action_distance must be at least 1, got 0"),
        ({"negative_sample_multiplier": 1}, "must be at least 2, got 1"),
        ({"other_episode_share": 1.5}, r"must lie in \[0, 1\], got 1.5"),
    ],
)
def test_arguments_are_checked(arguments: dict[str, int], match: str) -> None:
    with pytest.raises(ValueError, match=match):
        TCPairs(**arguments)


def make_frames(episode: list[int], step: list[int]) -> TensorDict:
    """Frames whose embedding is their own number."""
    number = torch.arange(len(step))
    return TensorDict(
        {
            "embedding": number.float().unsqueeze(-1),
            EPISODE: torch.tensor(episode),
            STEP: torch.tensor(step),
        },
        [len(step)],
    )


def test_mined_pairs_by_hand() -> None:
    frames = make_frames([0, 0, 0, 0, 7], [10, 11, 13, 20, 11])
    pairs = TCPairs(2, 3).mine(frames, generator=generator())
    found = {
        (*sorted((int(a), int(b))), int(label)): round(float(weight), 4)
        for a, b, label, weight in zip(
            pairs["anchor"],
            pairs["other"],
            pairs["label"],
            pairs["weight"],
            strict=True,
        )
    }
    # Close: steps 10-11 (1) and 11-13 (2), a quarter each. Far, from 6 on: 10-20,
    # 11-20, 13-20, half over three. 10-13 is neither; frame 4 is another episode's.
    expected = {
        (0, 1, 1): 0.25,
        (1, 2, 1): 0.25,
        (0, 3, 0): 0.1667,
        (1, 3, 0): 0.1667,
        (2, 3, 0): 0.1667,
    }
    assert found == expected


def test_mined_weights_make_the_classes_equal_and_the_distances_uniform() -> None:
    place, extra = Chunks(4, 5).draw(
        Episodes.from_lengths([100] * 20), 160, generator()
    )
    frames = TensorDict({**extra, "embedding": extra[STEP].unsqueeze(-1)}, place.shape)
    rule = TCPairs(other_episode_share=0.25)
    pairs = rule.mine(frames, generator=generator())
    label, weight = pairs["label"], pairs["weight"]
    distance = (pairs["anchor"] - pairs["other"]).abs().squeeze(-1)
    assert weight.sum() == pytest.approx(1)
    assert weight[label == 1].sum() == pytest.approx(0.5)
    for k in range(1, 5):
        close = (label == 1) & (distance == k)
        assert weight[close].sum() == pytest.approx(0.125)
    # Negatives of one episode share 3/8, as many of two share 1/8.
    num = int((label == 0).sum()) // 2
    values, counts = weight[label == 0].unique(return_counts=True)
    torch.testing.assert_close(values, torch.tensor([0.125 / num, 0.375 / num]))
    assert counts.tolist() == [num, num]


def test_a_chunk_of_five_gives_ten_positives() -> None:
    frames = make_frames([0] * 5 + [1] * 5, [*range(5), *range(5)])
    pairs = TCPairs().mine(frames, generator=generator())
    assert pairs["label"].sum() == 20
    assert len(pairs) == 20


def test_mined_order_is_random() -> None:
    frames = make_frames([0] * 300, list(range(300)))
    pairs = TCPairs().mine(frames, generator=generator())
    close = pairs["label"] == 1
    swapped = (pairs["anchor"] > pairs["other"]).squeeze(-1)[close].float().mean()
    # About 1190 positives: standard deviation 0.0145.
    assert abs(swapped - 0.5) < 4 * 0.0145


def test_frames_without_any_pair_give_an_empty_batch() -> None:
    pairs = TCPairs(other_episode_share=0.5).mine(make_frames([0], [3]))
    assert pairs.shape == (0,)
