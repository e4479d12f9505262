"""Freed memory is kept: the same blocks cost no page faults again."""

import subprocess
import sys

import pytest

from toponav.builders import keep_freed_memory

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
