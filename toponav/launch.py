"""From a command line to a recipe's settings, with errors of one sentence."""

import dataclasses
import hashlib
import inspect
import logging
import os
import re
import signal
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager, nullcontext
from difflib import get_close_matches
from pathlib import Path
from typing import Any, TypeVar, get_type_hints

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from toponav.config import RECIPES, SettingsError, TrainingError, require
from toponav.envs import EngineError
from toponav.methods import METHODS, register
from toponav.runs import alone_in, keep_draws, log_uniform, remove_unused

Settings = TypeVar("Settings")

_FAILED = 1
_USAGE_ERROR = 2
_REFUSALS = (HydraException, OmegaConfBaseException, SettingsError)
_FAILURES = (EngineError, TrainingError)
#: Most characters of the name of a sweep's folder; file systems allow 255 bytes.
_LONGEST_NAME = 200
#: Hydra's flags that have a value.
_FLAGS = (
    *("--cfg", "-c", "--package", "-p", "--info", "-i", "--experimental-rerun"),
    *("--config-path", "-cp", "--config-name", "-cn", "--config-dir", "-cd"),
)


class _JobError(Exception):
    """A job of a sweep ended with a sentence, which was printed; holds its status."""


def recipe(
    name: str, *, first: str | None = None, aliases: Mapping[str, str] | None = None
) -> Callable[[Callable[[Settings, Path], None]], Callable[[], None]]:
    """Make a function of (settings, run folder) the main function of a script.

    Hydra composes ``conf/<name>.yaml`` and the command line, makes the run folder and
    starts sweeps (``-m``). A bad setting is one sentence on standard error and exit
    status 2. SIGTERM ends the run like ``sys.exit``. ``resume=<run folder>`` continues
    in that folder; what the command line says comes on top.

    Args:
        name: the recipe, a key of ``RECIPES``.
        first: a setting that holds a folder, which may be given without its name.
        aliases: other words of the command line to the settings that they stand for.
    """

    def decorate(function: Callable[[Settings, Path], None]) -> Callable[[], None]:
        conf = Path(inspect.getfile(function)).resolve().parent.parent / "conf"

        def run(cfg: DictConfig) -> None:
            _run_job(name, function, cfg)

        def main() -> None:
            register()
            OmegaConf.register_new_resolver("folder_name", folder_name, replace=True)
            OmegaConf.register_new_resolver("log_uniform", log_uniform, replace=True)
            signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))
            # TorchRL logs every buffer that it makes, on standard output.
            logging.getLogger("torchrl").setLevel(logging.WARNING)
            # Hydra then raises instead of printing, and the sentence is ours.
            os.environ["HYDRA_FULL_ERROR"] = "1"
            start = hydra.main(
                version_base="1.3", config_path=str(conf), config_name=name
            )(run)
            with _one_sentence(name):
                arguments = sys.argv[1:]
                for word, setting in (aliases or {}).items():
                    arguments = [
                        re.sub(f"^{word}=", f"{setting}=", given) for given in arguments
                    ]
                if first:
                    arguments = named_folder(arguments, first)
                sys.argv[1:] = resumed_arguments(arguments, name)
                start()

        return main

    return decorate


def _run_job(
    name: str, function: Callable[[Settings, Path], None], cfg: DictConfig
) -> None:
    job = HydraConfig.get()
    folder = Path(job.runtime.output_dir)
    # A recipe without settings in its folder writes beside the runs of others.
    own = None if job.output_subdir is None else folder / job.output_subdir
    world = OmegaConf.select(cfg, "world.name", default="maze")
    words: Any = OmegaConf.to_container(job.overrides.task)
    try:
        # The lock comes first: without it a run must not remove the folder.
        with nullcontext() if own is None else alone_in(own):
            try:
                for word in words:
                    key = word.lstrip("+~").partition("=")[0]
                    good = world == "maze" or key.split(".")[0] != "maze"
                    require(good, f"'{key}' must go with world=maze", f"world={world}")
                if own is not None:
                    keep_draws(own, cfg, words)
                settings: Settings = OmegaConf.to_object(cfg)  # type: ignore[assignment]
                function(settings, folder)
            except _REFUSALS:
                if own is not None and not OmegaConf.select(cfg, "resume"):
                    remove_unused(folder, {own.name, f"{job.job.name}.log"})
                raise
    except (*_REFUSALS, *_FAILURES) as error:
        if job.mode is not RunMode.MULTIRUN:
            with _one_sentence(name):
                raise
        # Hydra goes on with the next job, and raises the first error at the end.
        sentence = f"{_sentence(error, name)} ({' '.join(words)})"
        print(f"{name}: {sentence}", file=sys.stderr)  # noqa: T201
        refused = isinstance(error, _REFUSALS)
        raise _JobError(_USAGE_ERROR if refused else _FAILED) from error


def folder_name(overrides: str) -> str:
    """One folder's name for the overrides of a run of a sweep, joined by commas.

    Nothing in it makes folders of its own or needs quotes in a shell; a long one ends
    in a digest. YAML writes it ``${folder_name:${hydra.job.override_dirname}}``.

    Examples:
        >>> folder_name("maze.blocked=[a,b],init_from=/runs/select")
        'maze.blocked=a,b,init_from=-runs-select'
    """
    bare = re.sub(r"[][{}$'\"\\]", "", overrides)
    name = re.sub(r"[^\w.,=+-]+", "-", bare)
    if len(name) > _LONGEST_NAME:
        digest = hashlib.sha256(overrides.encode()).hexdigest()[:8]
        name = f"{name[: _LONGEST_NAME - 9]}-{digest}"
    return name


def resumed_arguments(arguments: list[str], recipe: str) -> list[str]:
    """The command line of the run to go on with, and its folder to write into.

    A command line without ``resume=`` comes back as it is.

    Raises:
        SettingsError: if ``resume`` names no run folder, or that of an earlier version
            or another recipe, with settings that ``recipe`` has not.
    """
    given = [word for word in arguments if word.startswith("resume=")]
    folder = given[-1].partition("=")[2].strip("'\"") if given else ""
    if folder in ("", "null"):
        return arguments
    overrides = Path(folder) / "config" / "overrides.yaml"
    if not overrides.is_file():
        raise SettingsError(f"resume must name the folder of a run, got '{folder}'")
    config = overrides.with_name("config.yaml")
    known = set(_keys(RECIPES[recipe]))
    for group, schemas in METHODS.items():
        known.update(*(_keys(schema, f"{group}.") for schema in schemas.values()))
    old = OmegaConf.to_container(OmegaConf.load(config)) if config.is_file() else {}
    other = next((key for key in _leaves(old) if key not in known), None)
    require(
        other is None,
        f"resume must name a run of {recipe} of this version",
        f"'{folder}', which an earlier version (or another recipe) made with other "
        f"settings, '{other}'",
    )
    first: Any = OmegaConf.to_container(OmegaConf.load(overrides))
    kept = [word for word in first + arguments if not word.startswith("resume=")]
    return [*kept, *(f"{key}={_quoted(folder)}" for key in ("resume", "hydra.run.dir"))]


def _leaves(entries: Any, prefix: str = "") -> Iterator[str]:
    """Dotted names of all values in nested dictionaries."""
    for key, value in entries.items():
        below = isinstance(value, dict)
        yield from _leaves(value, f"{prefix}{key}.") if below else [f"{prefix}{key}"]


def named_folder(arguments: list[str], name: str) -> list[str]:
    """The command line with the name of a setting before the folder that stands alone.

    What is an existing folder, or has neither a ``=`` nor a leading dash, is taken for
    the folder, unless it is the value of one of Hydra's flags.

    Examples:
        >>> named_folder(["multirun/explore"], "folder")
        ["folder='multirun/explore'"]
    """
    found = []
    for before, word in zip(["", *arguments], arguments, strict=False):
        given = word.removeprefix(f"{name}=")
        alone = Path(word).is_dir() or not ("=" in word or word.startswith("-"))
        alone = alone and before not in _FLAGS
        found.append(f"{name}={_quoted(given)}" if given != word or alone else word)
    return found


def _quoted(folder: str) -> str:
    """In quotes for Hydra: a sweep's folder has equals signs and commas in its name."""
    bare = folder.strip("'\"")
    return "'" + bare.replace("'", "\\'") + "'"


@contextmanager
def _one_sentence(name: str) -> Iterator[None]:
    """Say what is wrong with the settings or the engine, and end the process."""
    try:
        yield
    except _JobError as error:
        print(f"{name}: not all jobs of the sweep succeeded", file=sys.stderr)  # noqa: T201
        sys.exit(error.args[0])
    except (*_REFUSALS, *_FAILURES) as error:
        print(f"{name}: {_sentence(error, name)}", file=sys.stderr)  # noqa: T201
        sys.exit(_USAGE_ERROR if isinstance(error, _REFUSALS) else _FAILED)


def _sentence(error: Exception, name: str) -> str:
    """What must hold, what was given and the nearest valid choice."""
    errors = list(_chain(error))
    for one in errors:
        if isinstance(one, (SettingsError, *_FAILURES)):
            return str(one)
    # The innermost message first: Hydra wraps what OmegaConf says.
    causes = [one.__cause__ for one in reversed(errors) if one.__cause__]
    text = "\n".join(str(one) for one in (*causes, error))
    if found := re.search(r"Could not find '(\S+)/(\S+)'", text):
        group, given = found.groups()
        # The group of a recipe's own scales, which is chosen by this word.
        group = "scale" if group == name else group
        options = re.findall(r"^\t(\S+)$", text, re.MULTILINE)
        # What options build on is none itself; "run" is navigate's own default.
        parts = re.compile(r"base|schema|run|\w+_schema")
        choices = [option for option in options if not parts.fullmatch(option)]
        rule = f"{group} must be one of {', '.join(choices)}"
        return f"{rule}, got '{given}'{_hint(given, choices)}"
    if found := re.search(r"full_key: (\S+)", text):
        key = found.group(1)
        known, group = list(_keys(RECIPES[name])), key.split(".")[0]
        owners = [
            f"{group}={method}"
            for method, schema in METHODS.get(group, {}).items()
            if group in known and key in _keys(schema, f"{group}.")
        ]
        in_force = _in_force(errors)
        if owners and " not in " in text:
            rule = f"'{key}' must go with {' or '.join(owners)}"
            return f"{rule}, got {group}={in_force[group]}"
        if key not in known and not key.startswith("hydra."):
            schemas = {one: METHODS[one][method] for one, method in in_force.items()}
            known += [of for one in schemas for of in _keys(schemas[one], f"{one}.")]
            hint = _hint(key, known)
            return f"'{key}' must be a setting of {name}, got none of that name{hint}"
        if "is not a ListConfig" in text:
            return f"{key} must be a list such as [a,b], got something else"
        return f"{key}: {text.splitlines()[0].strip()}"
    return next(line.strip() for line in text.splitlines() if line.strip())


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


def _hint(given: str, choices: list[str]) -> str:
    near = get_close_matches(given, choices, n=1, cutoff=0.0)
    return f" (did you mean '{near[0]}'?)" if near else ""


def _keys(schema: type, prefix: str = "") -> Iterator[str]:
    """Dotted names of all settings of a schema."""
    hints: dict[str, Any] = get_type_hints(schema)
    for field in dataclasses.fields(schema):
        kind = hints[field.name]
        yield prefix + field.name
        if dataclasses.is_dataclass(kind) and isinstance(kind, type):
            yield from _keys(kind, f"{prefix}{field.name}.")
