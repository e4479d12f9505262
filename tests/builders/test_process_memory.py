"""Freed memory is kept, and what stays is not looked through for garbage."""

import gc
import subprocess
import sys
from collections.abc import Iterator

import pytest
import torch

from toponav.builders import keep_freed_memory, prepare_process

# Page faults of twenty 32 MiB tensors, one after the other, before and after the call.
_COUNT_FAULTS = """
import resource, torch
from toponav.builders import keep_freed_memory

def count_faults():
    torch.ones(2**23)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    for _ in range(20):
        torch.ones(2**23)
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before

print(count_faults(), keep_freed_memory(), count_faults())
"""


@pytest.mark.slow
@pytest.mark.skipif(not keep_freed_memory(), reason="the C library is not glibc")
def test_freed_blocks_are_used_again() -> None:
    # A process of its own: this one keeps its memory since the line above.
    done = subprocess.run(
        [sys.executable, "-c", _COUNT_FAULTS],
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
    )
    returned, taken, kept = done.stdout.split()
    assert taken == "True"
    # 20 blocks of 8192 pages of 4 KiB: the system hands out each of them every
    # time, or one or two of them once.
    assert int(returned) > 20 * 8192 / 2
    assert int(kept) <= 2 * 8192


@pytest.fixture
def thawed() -> Iterator[None]:
    """Let the collector see all again, before and after."""
    gc.unfreeze()
    yield
    gc.unfreeze()


@pytest.mark.usefixtures("thawed")
def test_what_was_imported_is_not_looked_through_for_garbage() -> None:
    before = len(gc.get_objects())
    # Those of torch alone are more than a hundred thousand.
    assert before > 100_000
    prepare_process(threads=torch.get_num_threads())
    assert len(gc.get_objects()) < before / 10
