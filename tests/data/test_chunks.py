import pytest
import torch
from hypothesis import given, settings, strategies as st

from toponav.data import Chunks, Episodes
from toponav.keys import EPISODE, STEP


@settings(max_examples=60, deadline=None)
@given(
    lengths=st.lists(st.integers(1, 60), min_size=1, max_size=8),
    num_episodes=st.integers(1, 4),
    chunks=st.integers(1, 4),
    chunk_len=st.integers(1, 8),
    seed=st.integers(0, 1000),
)
def test_a_row_is_chunks_of_one_episode(
    lengths: list[int], num_episodes: int, chunks: int, chunk_len: int, seed: int
) -> None:
    episodes = Episodes.from_lengths([*lengths, 30])
    rule = Chunks(chunks, chunk_len, min_length=10)
    place, extra = rule.draw(
        episodes,
        num_episodes * chunks * chunk_len,
        torch.Generator().manual_seed(seed),
    )
    assert place.shape == (num_episodes, chunks * chunk_len)
    run = episodes.run_of(place)
    assert torch.equal(run, run[:, :1].expand_as(run))
    assert bool((episodes.length[run] >= 10).all())
    assert torch.equal(extra[STEP], place - episodes.start[run])
    assert torch.equal(extra[EPISODE], episodes.start[run])
    within = place.unflatten(1, (chunks, chunk_len)).diff(dim=-1)
    assert bool((within == 1).all())


def test_an_episode_is_not_drawn_twice_while_there_are_enough() -> None:
    episodes = Episodes.from_lengths([1000, 30, 30, 30])
    _, extra = Chunks(2, 5).draw(episodes, 40, torch.Generator().manual_seed(0))
    assert len(extra[EPISODE][:, 0].unique()) == 4


def test_chunks_start_anywhere() -> None:
    episodes = Episodes.from_lengths([25])
    _, extra = Chunks(4, 5).draw(episodes, 8000, torch.Generator().manual_seed(0))
    starts, count = extra[STEP][:, ::5].flatten().unique(return_counts=True)
    assert starts.tolist() == list(range(21))
    # 1600 chunks over 21 starts: 76 each, standard deviation 8.5.
    assert (count - 76.2).abs().max() < 4 * 8.5


def test_steps_count_on_behind_a_gap() -> None:
    # An episode of which steps 0..4 and 9..13 are left.
    whole = torch.tensor([0, 0])
    episodes = Episodes(
        order=torch.arange(10),
        start=torch.tensor([0, 5]),
        length=torch.tensor([5, 5]),
        first_step=torch.tensor([0, 9]),
        group_start=whole,
        group_length=whole + 10,
    )
    rule = Chunks(1, 5, min_length=5)
    _, extra = rule.draw(episodes, 10, torch.Generator().manual_seed(0))
    assert sorted(extra[STEP].flatten().tolist()) == [*range(5), *range(9, 14)]
    assert extra[EPISODE].unique().tolist() == [0]


def test_a_batch_that_does_not_divide_is_refused() -> None:
    episodes = Episodes.from_lengths([50])
    with pytest.raises(ValueError, match=r"multiple of .* = 20, got 50; .* is 40"):
        Chunks(4, 5).draw(episodes, 50, None)
    with pytest.raises(ValueError, match="got 3; the nearest is 20"):
        Chunks(4, 5).draw(episodes, 3, None)


def test_too_short_a_buffer_is_refused() -> None:
    with pytest.raises(ValueError, match=r"at least 21 decisions .*, got 20 at most"):
        Chunks(4, 5).draw(Episodes.from_lengths([20, 3]), 20, None)
    with pytest.raises(ValueError, match="got 0 at most"):
        Chunks(4, 5).draw(Episodes.from_lengths([]), 20, None)


def test_numbers_are_checked() -> None:
    with pytest.raises(ValueError, match="must be at least 1, got Chunks"):
        Chunks(chunk_len=0)
