from pathlib import Path

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import (
    LazyMemmapStorage,
    LazyTensorStorage,
    ReplayBuffer,
    TensorDictReplayBuffer,
)
from torchrl.data.replay_buffers import Storage

from tests.data.test_episodes import TRAJECTORY, make_frames
from toponav.data import Chunks, EpisodeSampler, LPairs, SplitPairs, TCPairs


def make_buffer(storage: Storage, *, seed: int = 0) -> TensorDictReplayBuffer:
    buffer = TensorDictReplayBuffer(
        storage=storage,
        sampler=EpisodeSampler(TCPairs()),
        batch_size=64,
    )
    buffer.set_rng(torch.Generator().manual_seed(seed))
    return buffer


def check_pairs(pairs: TensorDict) -> None:
    assert pairs.shape == (64, 2)
    episode, step = pairs[TRAJECTORY], pairs["step_count"][..., 0]
    assert torch.equal(episode[:, 0], episode[:, 1])
    distance = (step[:, 0] - step[:, 1]).abs()
    close = pairs["label"][:, 0] == 1
    assert bool(((distance >= 1) & (distance <= 4))[close].all())
    assert bool((distance[~close] >= 20).all())


@pytest.mark.parametrize("kind", [LazyTensorStorage, LazyMemmapStorage])
def test_pairs_come_from_a_flat_ring(kind: type[Storage]) -> None:
    buffer = make_buffer(kind(100))
    for episode in range(10):
        buffer.extend(make_frames([25 + episode], episode))
        check_pairs(buffer.sample())


@pytest.mark.parametrize("kind", [LazyTensorStorage, LazyMemmapStorage])
def test_pairs_come_from_a_storage_of_several_environments(
    kind: type[Storage],
) -> None:
    buffer = TensorDictReplayBuffer(
        storage=kind(2 * 60, ndim=2),
        sampler=EpisodeSampler(TCPairs()),
        batch_size=64,
        dim_extend=1,
    )
    rollout = torch.stack([make_frames([30, 50, 40]), make_frames([50, 30, 40], 10)])
    for part in rollout.split(8, dim=1):
        buffer.extend(part)
        if len(buffer) >= 60:
            check_pairs(buffer.sample())


def test_the_same_seed_gives_the_same_pairs() -> None:
    def sample(seed: int) -> torch.Tensor:
        buffer = make_buffer(LazyTensorStorage(100), seed=seed)
        buffer.extend(make_frames([40, 60]))
        return torch.stack([buffer.sample()["index"] for _ in range(3)])

    assert torch.equal(sample(0), sample(0))
    assert not torch.equal(sample(0), sample(1))


@pytest.mark.parametrize("kind", [ReplayBuffer, TensorDictReplayBuffer])
def test_a_write_is_seen_by_the_next_sample(kind: type[ReplayBuffer]) -> None:
    buffer = kind(
        storage=LazyTensorStorage(100),
        sampler=EpisodeSampler(LPairs(20)),
        batch_size=8,
    )
    buffer.extend(make_frames([10]))
    with pytest.raises(ValueError, match="got 10 at most"):
        buffer.sample()
    buffer.extend(make_frames([15], 1))
    with pytest.raises(ValueError, match="got 15 at most"):
        buffer.sample()
    for frame in make_frames([21], 2):
        buffer.add(frame)
    assert bool((buffer.sample()[TRAJECTORY] == 2).any())


def test_a_loaded_buffer_is_read_again(tmp_path: Path) -> None:
    first = make_buffer(LazyTensorStorage(200))
    first.extend(make_frames([40, 60, 30]))
    first.dumps(tmp_path)
    second = make_buffer(LazyTensorStorage(200))
    second.extend(make_frames([5]))
    with pytest.raises(ValueError, match="got 5 at most"):
        second.sample()
    second.loads(tmp_path)
    check_pairs(second.sample())


def test_an_emptied_buffer_is_read_again() -> None:
    buffer = make_buffer(LazyTensorStorage(100))
    buffer.extend(make_frames([100]))
    buffer.sample()
    buffer.empty()
    with pytest.raises(ValueError, match="got 0 at most"):
        buffer.sample()


def test_prefetching_threads_work() -> None:
    buffer = TensorDictReplayBuffer(
        storage=LazyTensorStorage(100),
        sampler=EpisodeSampler(TCPairs()),
        batch_size=64,
        prefetch=2,
    )
    buffer.extend(make_frames([100]))
    for _ in range(5):
        check_pairs(buffer.sample())


def test_split_pairs_makes_views_and_labels() -> None:
    frames = make_frames([60])
    frames["network_pixels"] = frames["step_count"].to(torch.uint8).reshape(60, 1, 1, 1)
    frames["action"] = torch.arange(60)
    buffer = TensorDictReplayBuffer(
        storage=LazyTensorStorage(60),
        sampler=EpisodeSampler(LPairs()),
        transform=SplitPairs(),
        batch_size=8,
    )
    buffer.extend(frames)
    pairs = buffer.sample()
    assert pairs.shape == (8,)
    assert pairs.get("network_pixels", None) is None
    distance = pairs["other"].flatten().int() - pairs["anchor"].flatten().int()
    assert bool(((distance >= 1) & (distance <= 4)).all())
    # The action is the anchor's: here the action's number is the step's.
    assert torch.equal(pairs["action"], pairs["anchor"].flatten().long())


def test_split_pairs_wants_pairs() -> None:
    buffer = TensorDictReplayBuffer(
        storage=LazyTensorStorage(60),
        sampler=EpisodeSampler(Chunks()),
        transform=SplitPairs("step_count"),
        batch_size=20,
    )
    buffer.extend(make_frames([60]))
    with pytest.raises(ValueError, match=r"must be of pairs.* got \[1, 20\]"):
        buffer.sample()
