"""Batches that are taken while something else is done."""

import threading
import time
from collections.abc import Iterator

import pytest
import torch
from tensordict import TensorDict, TensorDictBase

from toponav.builders import taken_meanwhile


def batches_of(count: int, taken: list[int]) -> Iterator[TensorDictBase]:
    """Batches of 4 decisions, in one memory that each of them overwrites."""
    memory = TensorDict({"number": torch.zeros(2, 2)}, [2, 2])
    for number in range(count):
        memory["number"].fill_(number)
        taken.append(threading.get_ident())
        yield memory


def wait_for(taken: list[int], count: int) -> None:
    deadline = time.monotonic() + 30
    while len(taken) < count:
        assert time.monotonic() < deadline
        time.sleep(0.001)


def numbers(batches: Iterator[TensorDictBase]) -> list[int]:
    return [int(one["number"][0, 0]) for one in batches]


def test_all_come_in_their_order() -> None:
    taken: list[int] = []
    with taken_meanwhile(batches_of(9, taken), 20) as batches:
        wait_for(taken, 5)
        time.sleep(0.05)
        assert len(taken) == 5  # 20 decisions, and no more
    assert numbers(batches) == list(range(9))
    here = threading.get_ident()
    assert [one == here for one in taken] == [False] * 5 + [True] * 4


@pytest.mark.parametrize("count", [0, 2])
def test_there_may_be_fewer(count: int) -> None:
    with taken_meanwhile(batches_of(count, []), 20) as batches:
        pass
    assert numbers(batches) == list(range(count))


def failing(taken: list[int]) -> Iterator[TensorDictBase]:
    yield from batches_of(2, taken)
    raise OSError("the third batch")


def test_an_error_comes_after_what_came_before_it() -> None:
    taken: list[int] = []
    with taken_meanwhile(failing(taken), 20) as batches:
        wait_for(taken, 2)
    assert numbers(iter([next(batches), next(batches)])) == [0, 1]
    with pytest.raises(OSError, match="the third batch"):
        next(batches)


def test_an_error_of_the_block_ends_the_taking() -> None:
    threads = threading.active_count()
    with (
        pytest.raises(RuntimeError, match="of the block"),
        taken_meanwhile(batches_of(10**9, []), 10**9),
    ):
        raise RuntimeError("of the block")
    assert threading.active_count() == threads
