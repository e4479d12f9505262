"""A refusal in words, which says what must hold and what there is, and of whom."""

from collections.abc import Callable
from inspect import isclass

import pytest
import torch

Thunk = Callable[[], object]
#: Who is given a part that lacks what is asked of it, and what is said of it.
Parts = dict[str, tuple[Thunk, str]]


def embed(views: torch.Tensor) -> torch.Tensor:
    return views.flatten(1).float()


def compare(one: torch.Tensor, many: torch.Tensor) -> torch.Tensor:
    return 1 / (1 + (one.unsqueeze(-2) - many).abs().sum(-1))


def refused(act: Thunk) -> str:
    """The sentence by which something is refused; an error of another kind passes."""
    kinds = (KeyError, ValueError, TypeError, NotImplementedError)
    with pytest.raises(kinds) as refusal:
        act()
    said = str(refusal.value.args[0])
    assert "must" in said, said
    assert "got" in said, said
    return said


def classes(room: object, kind: type) -> set[str]:
    """Names of a room's classes of a kind, so that none of them is forgotten."""
    found = {name: getattr(room, name) for name in dir(room)}
    return {
        name for name, one in found.items() if isclass(one) and issubclass(one, kind)
    }
