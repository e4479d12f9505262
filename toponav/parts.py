"""Parts that others hand in or use: what is asked of them, in one sentence."""

from typing import Any

from torch import Tensor


def require_parts(part: object, name: str, like: str, *wanted: str) -> None:
    """TypeError unless an object has what is asked of it.

    Args:
        part: the object.
        name: of the argument that it was given as.
        like: what has all that is wanted.
        wanted: methods and attributes.

    Examples:
        >>> require_parts(3, "network", "a TCNetwork", "embed")
        Traceback (most recent call last):
        TypeError: network must be such as a TCNetwork, got int without embed
    """
    if missing := [one for one in wanted if not hasattr(part, one)]:
        got = f"{type(part).__name__} without {', '.join(missing)}"
        raise TypeError(f"{name} must be such as {like}, got {got}")


def require_callables(**functions: Any) -> None:
    """TypeError unless all of these can be called; ``None`` is none.

    Examples:
        >>> require_callables(embed=abs, compare=0.5)
        Traceback (most recent call last):
        TypeError: compare must be a function or a network, got float
    """
    for name, given in functions.items():
        if given is not None and not callable(given):
            got = type(given).__name__
            raise TypeError(f"{name} must be a function or a network, got {got}")


def require_returned(name: str, found: Any, **sizes: int | None) -> None:
    """ValueError unless a function that was handed in returned a tensor of a shape.

    Args:
        name: of the argument that the function was given as.
        found: what it returned.
        sizes: of its dimensions, by their letters; ``None`` takes any.

    Examples:
        >>> import torch
        >>> require_returned("embed", torch.zeros(2, 8), N=2, D=None)
        >>> require_returned("embed", torch.zeros(2, 4, 6), N=2, D=None)
        Traceback (most recent call last):
        ValueError: embed must return [N, D], got [2, 4, 6] for N = 2
    """
    if isinstance(found, Tensor) and len(sizes) == found.ndim:
        pairs = zip(sizes.values(), found.shape, strict=True)
        if all(size in (None, given) for size, given in pairs):
            return
    got = list(found.shape) if isinstance(found, Tensor) else type(found).__name__
    known = [f"{one} = {size}" for one, size in sizes.items() if size is not None]
    rule = f"{name} must return [{', '.join(sizes)}]"
    raise ValueError(f"{rule}, got {got} for {' and '.join(known)}")


def needs_env(transform: object) -> NotImplementedError:
    """What a transform that follows steps says to a tensordict without an env."""
    rule = f"{type(transform).__name__} must be in a TransformedEnv, whose steps it"
    return NotImplementedError(f"{rule} follows, got a tensordict alone")
