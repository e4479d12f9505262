"""Threads that compute together each have a core of their own, for a while."""

import os
import time
from collections.abc import Iterator

import pytest
import torch

from toponav.builders import (
    ThreadGuard,
    one_thread,
    threads as builders_threads,
    threads_apart,
)

CORES = os.sched_getaffinity(0)


@pytest.fixture(autouse=True)
def as_many_threads_as_cores() -> Iterator[None]:
    before = torch.get_num_threads()
    torch.set_num_threads(len(CORES))
    yield
    torch.set_num_threads(before)


def cores_of_threads() -> list[set[int]]:
    """The cores that each computing thread may use."""
    found = list[set[int]]()
    openmp = builders_threads._load_openmp()
    assert openmp is not None

    def look() -> None:
        found.append(os.sched_getaffinity(0))
        # No thread takes the place of another one.
        time.sleep(0.05)

    builders_threads._on_each_thread(openmp, look)
    return found


needs_cores = pytest.mark.skipif(
    len(CORES) < 2 or builders_threads._load_openmp() is None,
    reason="one core alone, or other threads than GNU OpenMP's",
)


@needs_cores
def test_each_thread_has_a_core_of_its_own_and_all_of_them_afterwards() -> None:
    with threads_apart():
        inside = cores_of_threads()
    assert sorted(map(sorted, inside)) == [[core] for core in sorted(CORES)]
    assert cores_of_threads() == [CORES] * len(CORES)


@needs_cores
def test_an_error_gives_the_cores_back() -> None:
    with pytest.raises(ValueError, match="no"), threads_apart():
        raise ValueError("no")
    assert cores_of_threads() == [CORES] * len(CORES)


@needs_cores
def test_fewer_threads_than_cores_are_left_alone() -> None:
    with one_thread(), threads_apart():
        assert os.sched_getaffinity(0) == CORES


def test_other_threads_than_those_of_gnu_openmp_are_left_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(builders_threads, "_load_openmp", lambda: None)
    with threads_apart():
        assert os.sched_getaffinity(0) == CORES


@needs_cores
def test_a_call_that_had_less_than_all_cores_but_one_fixes_the_next_ones(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # A call of 10 s of n threads is slow below 10 (n - 0.9) s of processor time if they
    # were sent from their cores more than 10 x 50 times. 10 n - 8.9 is more; 10 n - 9.1
    # is less, the first time with 500 of them, then with 501: the next two calls have
    # fixed cores, and what the first of them had says nothing.
    n = len(CORES)
    spent, given = [10 * n - 8.9, *[10 * n - 9.1] * 2, 1.0, 10 * n, 10 * n], []
    sent = [0, 501, 0, 500, 0, 501, 0, 501, 0, 501, 0, 501]
    times = [time for one in spent for time in (0.0, one)]
    clock, processor = iter([0.0, 10.0] * len(spent)), iter(times)
    monkeypatch.setattr(builders_threads, "perf_counter", lambda: next(clock))
    monkeypatch.setattr(builders_threads, "process_time", lambda: next(processor))
    counts = iter(sent)
    monkeypatch.setattr(builders_threads, "_times_sent", lambda: next(counts))
    guard = ThreadGuard(calls=2)
    for _ in spent:
        with guard.watch():
            given.append(len(os.sched_getaffinity(0)) == 1)
    assert given == [False, False, False, True, True, False]


def test_a_call_that_fails_is_not_measured() -> None:
    guard = ThreadGuard()
    with pytest.raises(ValueError, match="no"), guard.watch():
        raise ValueError("no")
    assert guard.left == 0
