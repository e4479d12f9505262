import pytest
import torch
from tensordict import TensorDict

from toponav.data import HeldOut, LPairs, TCPairs
from toponav.keys import ACTION, HEADING, NETWORK_PIXELS, POSITION


def make_held_out(episodes: int = 3, length: int = 50) -> HeldOut:
    number = torch.arange(episodes * length).reshape(episodes, length)
    data = TensorDict(
        {
            NETWORK_PIXELS: torch.zeros(episodes, length, 2, 2, 3, dtype=torch.uint8),
            ACTION: number % 6,
            POSITION: torch.stack([number, -number], -1).float(),
            HEADING: number.float().unsqueeze(-1),
        },
        [episodes, length],
    )
    return HeldOut(data, name="maze1")


def test_pairs_lie_within_one_episode_at_the_distance_told() -> None:
    held_out = make_held_out()
    pairs = held_out.draw(TCPairs(4, 5), 200, seed=0)
    assert torch.equal(pairs.first // 50, pairs.second // 50)
    assert torch.equal((pairs.first - pairs.second).abs(), pairs.distance)
    assert bool((pairs.distance[pairs.label == 1] <= 4).all())
    assert bool((pairs.distance[pairs.label == 0] >= 20).all())
    assert pairs.label.sum() == 100


def test_frames_of_two_episodes_have_no_distance() -> None:
    pairs = make_held_out().draw(TCPairs(4, 5, other_episode_share=1.0), 100, seed=0)
    across = pairs.first // 50 != pairs.second // 50
    assert torch.equal(across, pairs.label == 0)
    assert bool((pairs.distance[across] == 0).all())


def test_no_pair_spans_an_end_within_a_walk() -> None:
    """Two walks of 50 decisions, in each of which an episode ends after 30."""
    frames = make_held_out(2).frames.reshape(2, 50)
    done = torch.zeros(2, 50, 1, dtype=torch.bool)
    done[:, 29] = True
    frames["next"] = TensorDict({"done": done}, [2, 50])
    held_out = HeldOut(frames, name="game")
    assert held_out.episodes.length.tolist() == [30, 20, 30, 20]
    near = held_out.draw(LPairs(4), 400, seed=0)
    assert torch.equal((near.first % 50) < 30, (near.second % 50) < 30)
    across = held_out.draw(TCPairs(4, 5, other_episode_share=1.0), 400, seed=0)
    other = across.label == 0
    first, second = map(held_out.episodes.run_of, (across.first, across.second))
    assert torch.equal(other, first != second)
    # Two episodes of one walk are as far apart as those of two walks.
    assert bool((other & (across.first // 50 == across.second // 50)).any())
    assert bool((across.distance[other] == 0).all())


def test_the_action_is_the_one_taken_at_the_anchor() -> None:
    pairs = make_held_out().draw(LPairs(4), 100, seed=0)
    assert torch.equal(pairs.action, pairs.first % 6)
    assert bool((pairs.second > pairs.first).all())


def test_the_poses_are_those_of_the_frames() -> None:
    held_out = make_held_out()
    pairs = held_out.draw(LPairs(4), 100, seed=0)
    (here, there), (heading, other) = held_out.poses(pairs)
    assert torch.equal(here[:, 0], pairs.first.float())
    assert torch.equal(there[:, 1], -pairs.second.float())
    assert torch.equal(heading, pairs.first.float())
    assert torch.equal(other, pairs.second.float())


def test_the_seed_decides() -> None:
    held_out = make_held_out()
    one, same, other = (held_out.draw(LPairs(4), 100, seed=s) for s in (1, 1, 2))
    assert torch.equal(one.first, same.first)
    assert not torch.equal(one.first, other.first)


def test_frames_must_be_episodes_by_time() -> None:
    with pytest.raises(ValueError, match=r"must be \[E, T\], got \[6\]"):
        HeldOut(TensorDict(batch_size=[6]), name="maze1")
