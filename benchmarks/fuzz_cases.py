"""A case of `fuzz`, and how the process that runs it may end."""

import os
import resource
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch

ROOT = Path(__file__).resolve().parent.parent
#: Exit statuses of a child: read as another thing, accepted, refused by an error.
CHANGED, ACCEPTED, RAISED = 70, 71, 72
# Kilobytes that a file may take: far less than a model that is not the file's.
_MOST_KB = 1_000_000


class Accepted(BaseException):
    """A recipe came to where it would start engines."""


@dataclass
class Case:
    """What is tried, in words, and how.

    A refusal leaves nothing, but settings and a log in the folder of a run that was to
    be ``resumed``.
    """

    number: int
    kind: str
    what: str
    run: Callable[[], object]
    resumed: Path | None = None


def same_value(one: Any, other: Any) -> bool:
    """Whether two entries of a map are equal; NaN equals NaN."""
    if isinstance(one, torch.Tensor):
        return torch.equal(torch.nan_to_num(one), torch.nan_to_num(other))
    return bool(one == other)


def require_same(same: bool) -> None:
    """End the child process as ``changed`` if what was read is another thing."""
    if not same:
        os._exit(CHANGED)


@contextmanager
def taking_little() -> Iterator[None]:
    """Raise `MemoryError` if the block takes much, whether it refuses or not."""
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    try:
        yield
    finally:
        taken = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
        if taken > _MOST_KB:
            raise MemoryError(f"took {taken} kB")
