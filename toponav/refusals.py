"""One-sentence errors for bad settings, engines, files and memory."""

import dataclasses
import re
from collections.abc import Iterable, Iterator, Mapping
from difflib import get_close_matches
from typing import Any, get_origin, get_type_hints

from hydra.errors import HydraException, OverrideParseException
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from toponav.config import RECIPES, SettingsError, TrainingError, require
from toponav.envs import EngineError
from toponav.methods import METHODS

REFUSALS = (HydraException, OmegaConfBaseException, SettingsError)
FAILURES = (EngineError, TrainingError)
# Settings by which a run takes more or less memory.
_SIZES = {
    "explore": ("collect.envs", "policy.view_size"),
    "pretrain": ("collect.buffer_gb", "pairs.per_update"),
    "navigate": ("evaluate.episodes", "maze.episode_length"),
    "tour": ("decisions", "height"),
}
# Extras that bring a launcher of Hydra's.
_LAUNCHERS = {
    "ray": "ray-sweeps",
    "ray_aws": "ray-sweeps",
    "submitit_local": "slurm",
    "submitit_slurm": "slurm",
}
# What torch and others say when memory or the disk is full; no type tells it.
_FULL = re.compile(
    r"allocat|out of memory|shared memory|Storage size|PytorchStreamWriter|enforce fail"
)


def sentence_of(error: Exception, name: str) -> str | None:
    """What must hold, what was given and the nearest valid choice, in one line.

    ``None`` for a bug in the package.
    """
    found = None
    if isinstance(error, (*REFUSALS, *FAILURES)):
        found = _refusal(error, name)
    elif isinstance(error, OSError):
        found = f"the files of a run must be readable and writable, got {error}"
    elif isinstance(error, MemoryError | OverflowError) or _FULL.search(str(error)):
        given = str(error).strip().splitlines() or ["too little"]
        rule = "a run must fit into this machine's memory and disk"
        found = f"{rule}{_smaller(name)}, got: {given[0]}"
    return found and re.sub(r"\s*\n\s*", " ", found)


def _smaller(name: str) -> str:
    """The settings of a recipe that decide most about how much it takes."""
    names = _SIZES.get(name)
    return f" (smaller with smaller {' and '.join(names)})" if names else ""


def _refusal(error: Exception, name: str) -> str:
    """The sentence for what was given."""
    errors = list(_chain(error))
    for one in errors:
        if isinstance(one, (SettingsError, *FAILURES)):
            return str(one)
        if isinstance(one, OverrideParseException):
            rule = "settings must be written as name=value, with quotes around a value"
            return f"{rule} that Hydra cannot read otherwise, got '{one.override}'"
    # The innermost message first: Hydra wraps what OmegaConf says.
    causes = [one.__cause__ for one in reversed(errors) if one.__cause__]
    text = "\n".join(str(one) for one in (*causes, error))
    if found := re.search(r"Could not find '(\S+)/([^'\n]+)'", text):
        group, given = found.groups()
        # The group of a recipe's own scales, which is chosen by this word.
        group = "scale" if group == name else group
        options = re.findall(r"^\t(\S+)$", text, re.MULTILINE)
        # Base files are no choices; "run" is navigate's own default. What chooses a
        # method by the scale is no method.
        parts = re.compile(r"base|schema|run|\w+_schema")
        choices = [
            option
            for option in options
            if not parts.fullmatch(option) and option in METHODS.get(group, options)
        ]
        rule = f"{group} must be one of {', '.join(choices)}"
        if group == "hydra/launcher" and given in _LAUNCHERS:
            extra = f"pip install 'toponav[{_LAUNCHERS[given]}]'"
            return f"{rule}, got '{given}', which comes with {extra}"
        return f"{rule}, got '{given}'{_hint(given, choices)}"
    if found := re.search(r"full_key: (\S+)", text):
        key = found.group(1)
        known, group = list(settings_of(RECIPES[name])), key.split(".")[0]
        owners = [
            f"{group}={method}"
            for method, schema in METHODS.get(group, {}).items()
            if group in known and key in settings_of(schema, f"{group}.")
        ]
        in_force = _in_force(errors)
        if owners and " not in " in text:
            rule = f"'{key}' must go with {' or '.join(owners)}"
            return f"{rule}, got {group}={in_force[group]}"
        unknown = unknown_setting(key, name, in_force)
        if unknown and not key.startswith("hydra."):
            return unknown
        if "is not a ListConfig" in text:
            return f"{key} must be a list such as [a,b], got something else"
        return f"{key}: {text.splitlines()[0].strip()}"
    return next(line.strip() for line in text.splitlines() if line.strip())


def unknown_setting(key: str, name: str, methods: Mapping[str, str]) -> str:
    """The sentence for a name that no setting has; empty if one has it."""
    known = list(settings_of(RECIPES[name]))
    for group, method in methods.items():
        if method in METHODS[group]:
            known += settings_of(METHODS[group][method], f"{group}.")
    # The keys of a dictionary, such as explore_s, are those that its YAML has.
    hints: dict[str, Any] = get_type_hints(RECIPES[name])
    free = get_origin(hints.get(key.partition(".")[0])) is dict
    rule = f"'{key}' must be a setting of {name}, got none of that name"
    return "" if free or key in known else rule + _hint(key, known)


def _chain(error: BaseException | None) -> Iterator[BaseException]:
    """An error and its causes; OmegaConf wraps a resolver's own without naming it."""
    while error is not None:
        yield error
        error = error.__cause__ or error.__context__


def _in_force(errors: Iterable[BaseException]) -> dict[str, str]:
    """The method of each group in the settings that OmegaConf refused."""
    for error in errors:
        if isinstance(error, OmegaConfBaseException) and error.parent_node is not None:
            root = error.parent_node._get_root()
            return {group: root[group].name for group in METHODS if group in root}
    return {}


def methods_of(cfg: Any) -> dict[str, str]:
    """The method of each group that these settings have; SettingsError without one."""
    found = {group: cfg[group].name for group in METHODS if group in cfg}
    for group, name in found.items():
        rule = f"{group} must be one of {', '.join(METHODS[group])}"
        require(name in METHODS[group], rule, f"'{name}'")
        # The settings of one method, and the name of another.
        kind, schema = OmegaConf.get_type(cfg[group]), METHODS[group][name]
        rule = f"{group}.name must stay as {group}=<name> sets it, with its settings"
        given = f"'{name}' (did you mean {group}={name}?)"
        require(kind is not None and issubclass(kind, schema), rule, given)
    return found


def _hint(given: str, choices: list[str]) -> str:
    near = get_close_matches(given, choices, n=1, cutoff=0.0)
    return f" (did you mean '{near[0]}'?)" if near else ""


def settings_of(schema: type, prefix: str = "") -> Iterator[str]:
    """Dotted names of all settings of a schema."""
    hints: dict[str, Any] = get_type_hints(schema)
    for field in dataclasses.fields(schema):
        kind = hints[field.name]
        yield prefix + field.name
        if dataclasses.is_dataclass(kind) and isinstance(kind, type):
            yield from settings_of(kind, f"{prefix}{field.name}.")


def leaves(entries: Any, prefix: str = "") -> Iterator[str]:
    """Dotted names of all values in nested dictionaries."""
    for key, value in entries.items():
        below = isinstance(value, dict) and value
        yield from leaves(value, f"{prefix}{key}.") if below else [f"{prefix}{key}"]
