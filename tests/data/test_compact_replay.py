"""A state that is as large as what is kept, and with which the draws go on."""

import copy
import io

import pytest
import torch
from tensordict import TensorDict
from torchrl.data import LazyTensorStorage, TensorDictReplayBuffer

from toponav.data import CompactReplay


def make_replay(capacity: int = 8) -> CompactReplay:
    return CompactReplay(storage=LazyTensorStorage(capacity))


def frames(start: int, num: int) -> TensorDict:
    numbers = torch.arange(start, start + num)
    return TensorDict({"view": numbers, "next": {"view": numbers + 1}}, [num])


def draws(replay: TensorDictReplayBuffer) -> list[int]:
    torch.manual_seed(0)
    return replay.sample(20)["next", "view"].tolist()


# Empty, in part, full, and full with the oldest in the middle.
@pytest.mark.parametrize("num", [0, 3, 8, 13])
def test_another_one_goes_on_where_it_was(num: int) -> None:
    whole, other = make_replay(), make_replay()
    for start in range(num):
        whole.extend(frames(start, 1))
    other.extend(frames(50, 5))
    other.load_state_dict(copy.deepcopy(whole.state_dict()))
    assert len(other) == len(whole) == min(num, 8)
    for replay in (whole, other):
        replay.extend(frames(100, 2))
    assert draws(whole) == draws(other)
    assert (whole.storage[:] == other.storage[:]).all()


def test_a_state_has_no_memory_for_what_is_to_come() -> None:
    replay = make_replay(100_000)
    replay.extend(frames(0, 10))
    file = io.BytesIO()
    torch.save(replay.state_dict(), file)
    # Ten frames of 16 bytes; the memory is 1.6 MB.
    assert file.tell() < 5_000


def test_what_came_later_is_not_in_a_state() -> None:
    replay = make_replay()
    replay.extend(frames(0, 8))
    state = replay.state_dict()
    replay.extend(frames(100, 8))
    assert state["frames"]["view"].tolist() == list(range(8))


def test_a_state_with_all_of_the_memory_is_read() -> None:
    earlier = TensorDictReplayBuffer(storage=LazyTensorStorage(8))
    earlier.extend(frames(0, 11))
    replay = make_replay()
    replay.load_state_dict(copy.deepcopy(earlier.state_dict()))
    for one in (earlier, replay):
        one.extend(frames(100, 2))
    assert draws(replay) == draws(earlier)


@pytest.mark.parametrize("capacity", [4, 20])
def test_one_of_another_size_keeps_what_it_can(capacity: int) -> None:
    whole, other = make_replay(), make_replay(capacity)
    whole.extend(frames(0, 13))
    other.load_state_dict(whole.state_dict())
    assert len(other) == min(capacity, 8)
    for start in range(100, 100 + capacity):
        other.extend(frames(start, 1))
    kept = other.storage[:]["view"].tolist()
    assert sorted(kept)[-capacity:] == list(range(100, 100 + capacity))
