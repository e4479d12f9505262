from types import SimpleNamespace

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer

from toponav.data import Chunks, DrawnPairs, LPairs, MinedPairs, TCPairs
from toponav.data.pair_rules import keep_some
from toponav.keys import (
    ACTION,
    ANCHOR,
    LABEL,
    NETWORK_PIXELS,
    OTHER,
    TRAJECTORY,
    WEIGHT,
)

LENGTH = 60


def frames(episodes: range) -> TensorDict:
    """Frames whose first pixel is the episode and whose second is the step."""
    step = torch.arange(LENGTH).repeat(len(episodes))
    episode = torch.tensor(list(episodes)).repeat_interleave(LENGTH)
    pixels = torch.zeros(len(step), 2, 2, 3, dtype=torch.uint8)
    pixels[:, 0, 0, 0], pixels[:, 0, 0, 1] = episode, step
    data = TensorDict({NETWORK_PIXELS: pixels, ACTION: step % 6}, [len(step)])
    data[TRAJECTORY], data["step_count"] = episode, step
    return data


def make_buffer(capacity: int = 600) -> TensorDictReplayBuffer:
    storage = LazyTensorStorage(capacity)
    return TensorDictReplayBuffer(storage=storage, batch_size=1)


def embed(pixels: torch.Tensor) -> torch.Tensor:
    return pixels[:, 0, 0, :2].float()


def mined(
    buffer: TensorDictReplayBuffer, *, min_length: int = 13, **options: object
) -> MinedPairs:
    settings = {
        "tc_pairs": TCPairs(3, 4),
        "l_pairs": LPairs(3),
        "embed_tc": embed,
        "generator": torch.Generator().manual_seed(0),
    }
    chunks = Chunks(4, 5, min_length=min_length)
    return MinedPairs(buffer.storage, chunks, 80, **(settings | options))


def drawn(buffer: TensorDictReplayBuffer, **options: object) -> DrawnPairs:
    return DrawnPairs(
        buffer.storage,
        200,
        tc_pairs=TCPairs(3, 4),
        l_pairs=LPairs(3),
        generator=torch.Generator().manual_seed(0),
        **options,
    )


def seen(pairs: TensorDict, key: str) -> torch.Tensor:
    """Episode and step of views or embeddings."""
    entry = pairs[key]
    return embed(entry) if entry.ndim == 4 else entry


@pytest.mark.parametrize("make", [mined, drawn])
def test_both_give_pairs_that_keep_the_rules(make) -> None:
    buffer = make_buffer()
    buffer.extend(frames(range(10)))
    tc_pairs, l_pairs = make(buffer)()
    first, second = seen(tc_pairs, ANCHOR), seen(tc_pairs, OTHER)
    assert torch.equal(first[:, 0], second[:, 0])
    gap = (first[:, 1] - second[:, 1]).abs()
    close = tc_pairs[LABEL] == 1
    assert bool(((gap[close] >= 1) & (gap[close] <= 3)).all())
    assert bool((gap[~close] >= 12).all())
    here, there = seen(l_pairs, ANCHOR), seen(l_pairs, OTHER)
    assert set((there - here)[:, 1].tolist()) == {1.0, 2.0, 3.0}
    assert torch.equal(l_pairs[ACTION], here[:, 1].long() % 6)


@pytest.mark.parametrize("make", [mined, drawn])
def test_frames_that_come_later_are_met(make) -> None:
    buffer = make_buffer()
    buffer.extend(frames(range(5)))
    pairs = make(buffer)
    pairs()
    buffer.extend(frames(range(5, 10)))
    met = torch.cat([seen(tc, ANCHOR)[:, 0] for tc, _ in (pairs() for _ in range(20))])
    assert set(met.tolist()) == set(map(float, range(10)))


@pytest.mark.parametrize("make", [mined, drawn])
def test_a_ring_that_ran_over_forgets_the_oldest(make) -> None:
    buffer = make_buffer(capacity=300)
    buffer.extend(frames(range(5)))
    buffer.extend(frames(range(5, 8)))
    pairs = make(buffer)
    met = torch.cat([seen(tc, ANCHOR)[:, 0] for tc, _ in (pairs() for _ in range(20))])
    assert set(met.tolist()) == {3.0, 4.0, 5.0, 6.0, 7.0}


@pytest.mark.parametrize("k", [1, 2, 4])
def test_the_number_of_mined_pairs_does_not_hang_on_k(k: int) -> None:
    buffer = make_buffer()
    buffer.extend(frames(range(10)))
    # At k = 1 the chunks hold 4 * 4 * 4 = 64 close pairs.
    options = {"tc_pairs": TCPairs(k, 5), "max_pairs": 100}
    tc_pairs, l_pairs = mined(buffer, min_length=5 * k + 1, **options)()
    assert tc_pairs[LABEL].sum() == 50
    assert len(tc_pairs) == 100
    assert len(l_pairs) <= 100


def test_gradients_reach_both_encoders() -> None:
    buffer = make_buffer()
    buffer.extend(frames(range(10)))
    layers = [torch.nn.Linear(2, 4), torch.nn.Linear(2, 4)]
    tc_pairs, l_pairs = mined(
        buffer,
        embed_tc=lambda x: layers[0](embed(x)),
        embed_l=lambda x: layers[1](embed(x)),
    )()
    tc_pairs[OTHER].sum().backward()
    assert layers[0].weight.grad is not None
    assert layers[1].weight.grad is None
    l_pairs[ANCHOR].sum().backward()
    assert layers[1].weight.grad is not None


@pytest.mark.parametrize("make", [mined, drawn])
def test_the_seed_decides(make) -> None:
    buffer = make_buffer()
    buffer.extend(frames(range(10)))
    (first, one), (second, other) = make(buffer)(), make(buffer)()
    assert bool((first == second).all())
    assert bool((one == other).all())


def test_keeping_some_keeps_the_sum_of_weights() -> None:
    pairs = TensorDict({WEIGHT: torch.rand(50)}, [50])
    kept = keep_some(pairs, 20, torch.Generator().manual_seed(0))
    assert len(kept) == 20
    assert kept[WEIGHT].sum() == pytest.approx(float(pairs[WEIGHT].sum()))
    assert keep_some(pairs, 50, None) is pairs


def test_a_buffer_that_is_too_short_says_so() -> None:
    buffer = make_buffer()
    buffer.extend(frames(range(2)))
    wide = {"tc_pairs": TCPairs(20, 5)}
    pairs = MinedPairs(
        buffer.storage,
        Chunks(4, 21, min_length=101),
        84,
        **wide,
        l_pairs=LPairs(3),
        embed_tc=embed,
    )
    with pytest.raises(ValueError, match=r"at least 101 decisions .*, got 60 at most"):
        pairs()
    pairs = DrawnPairs(buffer.storage, 40, **wide, l_pairs=LPairs(3))
    with pytest.raises(
        ValueError, match=r"101 decisions \(more than M \* k = 5 \* 20\)"
    ):
        pairs()
    with pytest.raises(ValueError, match="max_pairs must be at least 2, got 1"):
        mined(buffer, max_pairs=1)


@pytest.mark.parametrize(
    ("rules", "message"),
    [
        ({"tc_pairs": TCPairs(5, 2)}, "chunk_len must be more than .*, 5, got 5"),
        ({"l_pairs": LPairs(8)}, "chunk_len must be more than .*, 8, got 5"),
        ({"tc_pairs": TCPairs(4, 5)}, r"min_length .* M \* k of tc_pairs, 20, got 13"),
    ],
)
def test_chunks_that_do_not_fit_the_rules_are_refused(rules, message) -> None:
    buffer = make_buffer()
    with pytest.raises(ValueError, match=message):
        mined(buffer, **rules)
    # All negatives are of two episodes: none need be long.
    assert mined(buffer, tc_pairs=TCPairs(4, 5, other_episode_share=1.0))


@pytest.mark.parametrize("make", [mined, drawn])
def test_frames_need_no_storage(make) -> None:
    buffer, data = make_buffer(), frames(range(10))
    buffer.extend(data)
    rows = data.reshape(10, LENGTH).set("next", data.reshape(10, LENGTH).clone())
    given = SimpleNamespace(storage=rows)
    for first, second in zip(make(buffer)(), make(given)(), strict=True):
        assert bool((first == second).all())


def test_views_may_have_a_key_of_their_own() -> None:
    data = frames(range(10))
    other = data.clone().rename_key_(NETWORK_PIXELS, "view")
    for make in (mined, drawn):
        usual, own = (
            make(SimpleNamespace(storage=one), **options)()
            for one, options in ((data, {}), (other, {"in_key": "view"}))
        )
        for first, second in zip(usual, own, strict=True):
            assert torch.equal(first[ANCHOR], second[ANCHOR])
            assert torch.equal(first[OTHER], second[OTHER])


def test_the_rules_fit_each_other_by_default() -> None:
    tc_pairs, l_pairs = MinedPairs(frames(range(10)), embed_tc=embed)()
    gap = (tc_pairs[ANCHOR] - tc_pairs[OTHER])[:, 1].abs()
    assert gap[tc_pairs[LABEL] == 1].unique().tolist() == [1, 2, 3, 4]
    assert gap[tc_pairs[LABEL] == 0].min() >= 20
    assert len(l_pairs)
