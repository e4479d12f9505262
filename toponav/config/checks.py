"""What settings may hold; each check refuses in one sentence."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, ClassVar, TypeVar

from omegaconf import MISSING, DictConfig, ListConfig, OmegaConf

Config = TypeVar("Config", DictConfig, ListConfig)


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
        SettingsError: if it is damaged or of another kind than a dictionary or list.
    """
    found, reason = None, f"no {kind.__name__[:4].lower()}"
    try:
        found = OmegaConf.load(file)
    except Exception as bad:  # damage can make its reader fail in any way
        reason = str(bad).splitlines()[0]
    if not isinstance(found, kind):
        rule = "a run folder must hold the settings of a run, got the damaged"
        raise SettingsError(f"{rule} {file} ({reason})")
    return found


@dataclass
class Settings:
    """A group of settings, whose fields say what they may hold beside ``None``.

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
            if value is not None and "check" in one.metadata:
                name = f"{self.group}.{one.name}" if self.group else one.name
                one.metadata["check"](name, value)


def _field(
    rule: str,
    holds: Callable[[Any], bool],
    given: Callable[[Any], object] = str,
    *,
    default: Any = MISSING,
) -> Any:
    def check(name: str, value: Any) -> None:
        require(holds(value), f"{name} must {rule}", given(value))

    return field(default=default, metadata={"check": check})


def at_least(least: float, *, default: Any = MISSING) -> Any:
    """A number that is not too small; ``default`` is what older runs had."""
    return _field(f"be at least {least}", lambda value: value >= least, default=default)


def above(bound: float) -> Any:
    """A number above another one."""
    return _field(f"be above {bound}", lambda value: value > bound)


def between(low: float, high: float) -> Any:
    """A number in a range; the sentence names the nearest one."""
    return _field(
        f"lie in [{low:g}, {high:g}]",
        lambda value: low <= value <= high,
        lambda value: f"{value:.10g} (did you mean {min(max(value, low), high):g}?)",
    )


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
