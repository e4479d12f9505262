"""Checks of settings: each refuses in one sentence."""


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


def require_at_least(name: str, value: float, least: float) -> None:
    """`require` that a number is not too small."""
    require(value >= least, f"{name} must be at least {least}", value)


def require_choice(name: str, value: str, choices: tuple[str, ...]) -> None:
    """`require` that a word is one of several."""
    require(value in choices, f"{name} must be one of {', '.join(choices)}", value)


def require_between(name: str, value: float, low: float, high: float) -> None:
    """`require` that a number lies in a range; the sentence names the nearest one.

    Examples:
        >>> require_between("reward.alpha", 2, 0, 1)
        Traceback (most recent call last):
        toponav.config.checks.SettingsError: reward.alpha must lie in [0, 1], got ...
    """
    nearest = min(max(value, low), high)
    require(
        nearest == value,
        f"{name} must lie in [{low:g}, {high:g}]",
        f"{value:g} (did you mean {nearest:g}?)",
    )


def require_above_zero(name: str, value: float) -> None:
    """`require` that a number is positive."""
    require(value > 0, f"{name} must be above 0", value)


def require_threshold(name: str, value: str, words: tuple[str, ...]) -> None:
    """`require` a similarity below 1, or a word that stands for a calibrated one.

    Examples:
        >>> require_threshold("map.tc_reach", "0.7", ("auto",))
        >>> require_threshold("map.tc_reach", "high", ("auto",))
        Traceback (most recent call last):
        toponav.config.checks.SettingsError: map.tc_reach must be one of auto or a ...
    """
    if value in words:
        return
    try:
        number = float(value)
    except ValueError as error:
        raise SettingsError(
            f"{name} must be one of {', '.join(words)} or a number in [0, 0.999], got "
            f"{value}"
        ) from error
    require_between(name, number, 0, 0.999)
