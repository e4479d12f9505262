"""What may stand in a file of networks in the place of weights, or of their sizes."""

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
import torch

from toponav.config import SettingsError

#: Other weights, and what is said of them beside their name.
OTHER_WEIGHTS: dict[str, tuple[Callable[[torch.Tensor], object], str]] = {
    "nan": (lambda one: one.fill_(torch.nan), "NaN or infinity in "),
    "infinite": (lambda one: one + torch.inf, "NaN or infinity in "),
    "double": (lambda one: one.double(), "is torch.float64 "),
    # Infinite once it is rounded.
    "too large": (lambda one: one.double() + 1e300, "NaN or infinity in "),
    "whole": (lambda one: one.long(), "is torch.int64 "),
    "half": (lambda one: one.half(), "is torch.float16 "),
    "complex": (lambda one: one + 0j, "no plain numbers in "),
    "repeated": (lambda one: one[:1].clone().expand(one.shape), "no plain numbers in "),
    "enormous": (
        lambda _: torch.zeros(1, dtype=torch.int8).expand(10**6, 10**7),
        "no plain numbers in ",
    ),
    "short": (lambda one: one[:1], "is torch.float32 "),
    "a word": (lambda _: "x", "is no plain tensor"),
}
#: Other sizes of networks. One of 4,000 digits could be printed.
OTHER_SIZES: list[Any] = [
    *(-1, 10**30, 10**480, 16.0, float("nan"), True, "16", "x\ny", None),
    *(torch.tensor(16), torch.ones(3, 3), [torch.ones(9)] * 20_000),
]


def rewrite(path: Path, change: Callable[[dict[str, Any]], object]) -> None:
    """Change what a file holds; its checksums then fit."""
    state = torch.load(path, weights_only=True)
    change(state)
    torch.save(state, path)


def replace(path: Path, names: tuple[str, ...], other: object) -> None:
    """Put something else, or what a function makes of it, under these names."""

    def change(state: dict[str, Any]) -> None:
        *outer, last = names
        for name in outer:
            state = state[name]
        state[last] = other(state[last]) if callable(other) else other

    rewrite(path, change)


@contextmanager
def refusing(rule: str) -> Iterator[None]:
    """The block is refused at once, in one short sentence that begins like this."""
    started = time.process_time()
    with pytest.raises(SettingsError, match=f"^{rule}") as caught:
        yield
    assert "\n" not in str(caught.value)
    assert len(str(caught.value)) < 500
    assert time.process_time() - started < 1
