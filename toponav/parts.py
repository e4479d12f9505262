"""Parts that others hand in or use: what is asked of them, in one sentence."""

from typing import Any


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


def needs_env(transform: object) -> NotImplementedError:
    """What a transform that follows steps says to a tensordict without an env."""
    rule = f"{type(transform).__name__} must be in a TransformedEnv, whose steps it"
    return NotImplementedError(f"{rule} follows, got a tensordict alone")
