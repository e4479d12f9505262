"""What settings may hold; each check refuses in one sentence."""

import io
import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import yaml  # type: ignore[import-untyped]
from omegaconf import MISSING, DictConfig, ListConfig, OmegaConf

Config = TypeVar("Config", DictConfig, ListConfig)

#: Most threads of a process; with some ten thousand the thread library gives up, or
#: the process ends without a word.
MOST_THREADS = 1024
#: Most bootstrap samples of a table: more take many minutes and change no digit.
MOST_DRAWS = 1_000_000
#: Most pairs of views at a time, whose embeddings take gigabytes.
MOST_PAIRS = 1_000_000
#: Most gigabytes of views; no machine has the memory for more.
MOST_GB = 100_000
#: Largest size of a number that is no whole one. Tensors hold 3.4e38, and optimisers
#: multiply such numbers by some more before a tensor gets them.
_LARGEST = 1e30
#: Most bytes of a YAML file of a run; those that runs write have some thousands, and
#: reading so many takes seconds.
_MOST_BYTES = 50_000
#: Most references of one setting to others: those that runs write have 13. If each of
#: a chain names the next one twice, twice as many take 2^15 times as long to read.
_MOST_REFERENCES = 30
# A tenth of the time of the one in Python, and it refuses what is nested too deeply.
_YAML_LOADER = getattr(yaml, "CSafeLoader", yaml.SafeLoader)


class SettingsError(ValueError):
    """A setting is out of range or does not fit another one."""


class TrainingError(RuntimeError):
    """Training cannot go on, such as after a loss that is not a number."""


def require(holds: bool, rule: str, given: object) -> None:
    """Refuse a setting in one sentence.

    Raises:
        SettingsError: unless ``holds``; "``rule``, got ``given``".
    """
    if not holds:
        raise SettingsError(f"{rule}, got {given}")


def require_finite(name: str, value: float) -> None:
    """Refuse infinity and NaN, which most comparisons let pass."""
    require(math.isfinite(value), f"{name} must be a finite number", value)


def require_multiple(name: str, value: int, base_name: str, base: int) -> None:
    """Refuse a setting that is no multiple of another one; names the nearest."""
    nearest = max(round(value / base), 1) * base
    rule = f"{name} must be a multiple of {base_name}={base}"
    require(value % base == 0, rule, f"{value} (did you mean {nearest}?)")


@contextmanager
def refusing(
    start: str, errors: tuple[type[Exception], ...] = (ValueError,)
) -> Iterator[None]:
    """Make a `SettingsError` of an error in the ``with`` block or the function.

    Examples:
        >>> with refusing("maze: "):
        ...     int("two")
        Traceback (most recent call last):
        toponav.config.checks.SettingsError: maze: invalid literal for int() with ...
    """
    try:
        yield
    except SettingsError:
        raise
    except errors as error:
        raise SettingsError(f"{start}{error}") from error


def read_yaml(file: Path, kind: type[Config] = DictConfig) -> Config:  # type: ignore[assignment]
    """The YAML of a run folder.

    Raises:
        SettingsError: if it is damaged, far too long, has aliases, or is of another
            kind than a dictionary or list.
    """
    found, reason = None, f"no {kind.__name__[:4].lower()}"
    try:
        found = OmegaConf.load(io.StringIO(_plain_text(file)))
    except Exception as bad:  # damage can make its reader fail in any way
        reason = str(bad).splitlines()[0]
    if not isinstance(found, kind):
        rule = "a run folder must hold the settings of a run, got the damaged"
        raise SettingsError(f"{rule} {file} ({reason})")
    return found


def _plain_text(file: Path) -> str:
    """The text of a YAML file that takes no longer to read than its length says."""
    with file.open("rb") as opened:
        content = opened.read(_MOST_BYTES + 1)
    if len(content) > _MOST_BYTES:
        raise ValueError(f"it has more than {_MOST_BYTES:,} bytes")
    text = content.decode("utf-8")
    if text.count("${") > _MOST_REFERENCES:
        raise ValueError(f"it has more than {_MOST_REFERENCES} references, '${{...}}'")
    # A few of them stand for more words than any memory holds; no run writes one.
    for event in yaml.parse(text, Loader=_YAML_LOADER):
        if isinstance(event, yaml.AliasEvent):
            raise ValueError(f"it has an alias, '*{event.anchor}'")
    return text


@dataclass
class Settings:
    """A group of settings, whose fields say what they may hold beside ``None``.

    Numbers are finite in all of them, and none is too large for a tensor.

    Examples:
        >>> @dataclass
        ... class Optimizer(Settings):
        ...     group = "optimizer"
        ...     lr: float = above(0)
        >>> Optimizer(lr=0.0)
        Traceback (most recent call last):
        toponav.config.checks.SettingsError: optimizer.lr must be above 0, got 0.0
    """

    #: Its name on the command line; settings of a recipe have none.
    group: ClassVar[str] = ""

    def __post_init__(self) -> None:
        for one in fields(self):
            value = getattr(self, one.name)
            name = f"{self.group}.{one.name}" if self.group else one.name
            if isinstance(value, float):
                require_finite(name, value)
            if value is not None and "check" in one.metadata:
                one.metadata["check"](name, value)
            if isinstance(value, float):
                rule = f"{name} must be at most {_LARGEST:g} in size"
                require(abs(value) <= _LARGEST, rule, value)


def _field(
    rule: str,
    holds: Callable[[Any], bool],
    given: Callable[[Any], object] = str,
    *,
    most: float | None = None,
    default: Any = MISSING,
) -> Any:
    def check(name: str, value: Any) -> None:
        require(holds(value), f"{name} must {rule}", given(value))
        if most is not None:
            require(value <= most, f"{name} must be at most {most:,}", value)

    return field(default=default, metadata={"check": check})


def at_least(least: float, *, most: float | None = None, default: Any = MISSING) -> Any:
    """A number that is not too small; ``default`` is what older runs had.

    One above ``most`` is refused in a sentence of its own.
    """
    rule = f"be at least {least}"
    return _field(rule, lambda value: value >= least, most=most, default=default)


def above(bound: float, *, most: float | None = None) -> Any:
    """A number above another one, and at ``most`` a third."""
    return _field(f"be above {bound}", lambda value: value > bound, most=most)


def between(low: float, high: float) -> Any:
    """A number in a range; the sentence names the nearest one."""
    return _field(
        f"lie in [{low:g}, {high:g}]",
        lambda value: low <= value <= high,
        lambda value: f"{_shown(value)} (did you mean {min(max(value, low), high):g}?)",
    )


def _shown(value: float) -> str:
    # A whole number may be too long for a float.
    return f"{value:.10g}" if isinstance(value, float) else str(value)


def a_seed() -> Any:
    """A number with which random generators can begin."""
    return _field("lie in [0, 4294967295]", lambda value: 0 <= value < 2**32)


def one_of(*choices: str) -> Any:
    """One of several words."""
    return _field(f"be one of {', '.join(choices)}", lambda value: value in choices)


def threshold_or(*words: str) -> Any:
    """A similarity below 1, or a word that stands for a calibrated one."""

    def holds(value: str) -> bool:
        with suppress(ValueError):
            return value in words or 0 <= float(value) <= 0.999
        return False

    return _field(f"be one of {', '.join(words)} or a number in [0, 0.999]", holds)
