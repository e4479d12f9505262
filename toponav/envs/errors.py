"""What can go wrong with engines and with names."""

from collections.abc import Iterable
from difflib import get_close_matches


class EngineError(RuntimeError):
    """The engine could not be started, or did something that it must not."""


class EngineLostError(EngineError):
    """A running engine died; a new one can take its place."""


def unknown_name(what: str, name: str, choices: Iterable[str]) -> ValueError:
    """The error for a name that is not among the choices; it names the nearest one."""
    known = sorted(choices)
    near = get_close_matches(name, known, n=1, cutoff=0.0)[0]
    return ValueError(
        f"{what} must be one of {', '.join(known)}, got '{name}' "
        f"(did you mean '{near}'?)"
    )
