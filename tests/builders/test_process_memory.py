"""Freed memory is kept: the same blocks cost no page faults again."""

import subprocess
import sys

import pytest

from toponav.builders import keep_freed_memory

# Page faults of twenty 32 MiB tensors, one after the other, in a process of its own.
_COUNT_FAULTS = """
import resource, sys, torch
from toponav.builders import keep_freed_memory
if sys.argv[1] == "keep":
    assert keep_freed_memory()
torch.ones(2**23)
before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
for _ in range(20):
    torch.ones(2**23)
print(resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before)
"""


def count_faults(how: str) -> int:
    done = subprocess.run(
        [sys.executable, "-c", _COUNT_FAULTS, how],
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
    )
    return int(done.stdout)


@pytest.mark.slow
@pytest.mark.skipif(not keep_freed_memory(), reason="the C library is not glibc")
def test_freed_blocks_are_used_again() -> None:
    # 20 blocks of 8192 pages of 4 KiB: the system hands out each of them every
    # time, or one or two of them once.
    assert count_faults("return") > 20 * 8192 / 2
    assert count_faults("keep") <= 2 * 8192
