"""Slices of the last decisions: successive, of one environment, masked at the clock."""

import pytest
import torch
from tensordict import TensorDict

from toponav.data import MASK, SliceReplay

VIEW, REWARD = "view", "paid"


def make_batch(start: int, *, envs: int = 3, length: int = 6, **flags) -> TensorDict:
    """Views that are numbered: 1000 for each environment and 1 for each decision."""
    shape = (envs, length, 1)
    times = start + torch.arange(length + 1).reshape(1, -1, 1)
    views = 1000 * torch.arange(envs).reshape(-1, 1, 1) + times
    none = torch.zeros(shape, dtype=torch.bool)
    done, terminated = flags.get("done", none), flags.get("terminated", none)
    begins = torch.cat([none[:, :1], done[:, :-1]], 1)
    following = {VIEW: views[:, 1:], REWARD: views[:, :-1] / 10, "done": done}
    following["terminated"] = terminated
    now = {VIEW: views[:, :-1], "action": views[:, :-1, 0], "is_init": begins}
    return TensorDict({**now, "next": following}, shape[:-1])


def make_replay(capacity: int = 90, length: int = 4) -> SliceReplay:
    return SliceReplay(capacity, length=length, view=VIEW, reward=REWARD)


def test_slices_are_successive_decisions_of_one_environment() -> None:
    torch.manual_seed(0)
    replay = make_replay()
    for start in (0, 6, 12):
        replay.extend(make_batch(start))
    assert len(replay) == 3 * 3 * 6
    slices = replay.sample(200)
    assert slices.batch_size == (200, 4)
    views = slices[VIEW].squeeze(-1)
    assert bool((views.diff(dim=1) == 1).all())
    assert torch.equal(slices["next", VIEW].squeeze(-1), views + 1)
    torch.testing.assert_close(slices["next", "reward"].squeeze(-1), views / 10)
    assert torch.equal(slices["action"], views)
    # All that a slice can hold is drawn: three starts in each of nine pieces.
    assert len(set(views[:, 0].tolist())) == 27


def test_the_oldest_decisions_are_forgotten_by_whole_pieces() -> None:
    torch.manual_seed(0)
    replay = make_replay(capacity=50)
    for start in range(0, 60, 6):
        replay.extend(make_batch(start))
    # Eight pieces of six decisions: two batches and two thirds of one before.
    assert len(replay) == 48
    views = replay.sample(300)[VIEW]
    assert bool((views.diff(dim=1) == 1).all())
    assert int((views % 1000).min()) == 42
    first = views[(views % 1000 < 48).all(1).squeeze(-1)] // 1000
    assert first.unique().tolist() == [1, 2]


def test_what_a_time_limit_ended_is_masked_and_a_new_episode_is_shown() -> None:
    torch.manual_seed(0)
    done = torch.zeros(1, 6, 1, dtype=torch.bool)
    done[:, 2], done[:, 4] = True, True
    terminated = done.clone()
    terminated[:, 2] = False
    replay = make_replay(length=6)
    replay.extend(make_batch(0, envs=1, done=done, terminated=terminated))
    slices = replay.sample(1)
    assert slices[MASK].flatten().tolist() == [True, True, False, True, True, True]
    assert slices["is_init"].flatten().tolist() == [0, 0, 0, 1, 0, 1]
    assert slices["next", "is_init"].flatten().tolist() == [0, 0, 1, 0, 1, 0]
    assert torch.equal(slices["next", "terminated"], terminated)


def test_batches_of_other_lengths_are_refused() -> None:
    replay = make_replay()
    with pytest.raises(ValueError, match="at least 4 decisions of each"):
        replay.extend(make_batch(0, length=3))
    replay.extend(make_batch(0))
    with pytest.raises(ValueError, match=r"must be \[E, 6\], got \[3, 7\]"):
        replay.extend(make_batch(0, length=7))
    with pytest.raises(ValueError, match="at least 1, got 0 and 4"):
        make_replay(capacity=0)
