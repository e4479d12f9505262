"""From a command line to a recipe's settings, with errors of one sentence."""

import argparse
import hashlib
import inspect
import logging
import os
import re
import signal
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import hydra
import hydra.core.utils
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig, ListConfig, OmegaConf

from toponav.config import RECIPES, SettingsError, read_yaml, require
from toponav.interrupts import catch_as_usual, ignore_signals
from toponav.methods import METHODS, register
from toponav.refusals import (
    REFUSALS,
    leaves,
    methods_of,
    sentence_of,
    settings_of,
    unknown_setting,
)
from toponav.runs import (
    CHECKPOINT_FILE,
    alone_in,
    has_results,
    keep_draws,
    log_uniform,
    remove_halves,
    remove_unused,
    write_text,
)

Settings = TypeVar("Settings")

_FAILED = 1
_USAGE_ERROR = 2
#: Most characters of the name of a sweep's folder; file systems allow 255 bytes.
_LONGEST_NAME = 200
#: Hydra's flags that have a value.
_FLAGS = (
    *("--cfg", "-c", "--package", "-p", "--info", "-i", "--experimental-rerun"),
    *("--config-path", "-cp", "--config-name", "-cn", "--config-dir", "-cd"),
)
_configure_log = hydra.core.utils.configure_log


class _JobError(Exception):
    """A job of a sweep ended with a sentence, which was printed; holds its status."""


def recipe(
    name: str, *, first: str | None = None, aliases: Mapping[str, str] | None = None
) -> Callable[[Callable[[Settings, Path], None]], Callable[[], None]]:
    """Make a function of (settings, run folder) the main function of a script.

    Hydra composes ``conf/<name>.yaml`` and the command line, makes the run folder and
    starts sweeps (``-m``). A bad setting is one sentence on standard error and exit
    status 2. SIGTERM ends the run like ``sys.exit``; after its last job the process
    takes no signals any more. ``resume=<run folder>`` continues
    in that folder; what the command line says comes on top.

    Args:
        name: the recipe, a key of ``RECIPES``.
        first: a setting that holds a folder, which may be given without its name.
        aliases: other words of the command line to the settings that they stand for.
    """

    def decorate(function: Callable[[Settings, Path], None]) -> Callable[[], None]:
        conf = Path(inspect.getfile(function)).resolve().parent.parent / "conf"

        def run(cfg: DictConfig) -> None:
            # Once more: a launcher may have started another process for it.
            _register()
            _run_job(name, function, cfg)

        def main() -> None:
            _register()
            # TorchRL logs every buffer that it makes, on standard output.
            logging.getLogger("torchrl").setLevel(logging.WARNING)
            # Hydra then raises instead of printing, and the sentence is ours.
            os.environ["HYDRA_FULL_ERROR"] = "1"
            argparse.ArgumentParser.error = _refuse_flags  # type: ignore[assignment, method-assign]
            hydra.core.utils._save_config = _save_whole
            hydra.core.utils.configure_log = _log_in_own_folder
            start = hydra.main(
                version_base="1.3", config_path=str(conf), config_name=name
            )(run)
            with _one_sentence(name):
                catch_as_usual()
                arguments = sys.argv[1:]
                for word in arguments:
                    rule = "a setting must have a name before its equals sign"
                    require(not word.startswith("="), rule, f"'{word}'")
                for word, setting in (aliases or {}).items():
                    arguments = [
                        re.sub(f"^{word}=", f"{setting}=", given) for given in arguments
                    ]
                if first:
                    arguments = named_folder(arguments, first)
                sys.argv[1:] = resumed_arguments(arguments, name)
                start()
                # Inside: until here Ctrl-C is one sentence.
                ignore_signals()

        return main

    return decorate


def _register() -> None:
    """Tell Hydra the schemas, and OmegaConf what YAML and command lines call."""
    register()
    for resolver in (folder_name, log_uniform):
        OmegaConf.register_new_resolver(resolver.__name__, resolver, replace=True)


def _refuse_flags(_: argparse.ArgumentParser, message: str) -> NoReturn:
    """Raise what Hydra's parser would print under its usage."""
    raise SettingsError(f"what begins with a dash must be a flag of Hydra's: {message}")


def _log_in_own_folder(
    log_config: DictConfig, verbose_config: bool | str | Sequence[str] = False
) -> None:
    """Let Hydra open its log, the first file of a run, if the folder is the run's own.

    `SettingsError` if another run is writing there, or has left its results.
    """
    job = HydraConfig.get()
    folder = Path(job.runtime.output_dir)
    # A recipe without settings in its folder writes beside the runs of others.
    if job.mode is RunMode.RUN and job.output_subdir is not None:
        if (folder / job.output_subdir / ".lock").is_file():
            with alone_in(folder / job.output_subdir):
                pass
        words: Any = OmegaConf.to_container(job.overrides.task)  # as they were given
        is_new = not any(word.startswith("resume='") for word in words)
        can_go_on = (folder / CHECKPOINT_FILE).is_file()
        hint = f" (did you mean resume='{folder}'?)" if can_go_on else ""
        rule = "hydra.run.dir must name a folder without results of another run"
        require(not (is_new and has_results(folder)), rule, f"'{folder}'{hint}")
    _configure_log(log_config, verbose_config)


def _save_whole(cfg: Any, filename: str, output_dir: Path) -> None:
    """Write what Hydra would write in place; a killed resume leaves the former file."""
    output_dir.mkdir(parents=True, exist_ok=True)
    write_text(output_dir / filename, OmegaConf.to_yaml(cfg))


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
                    of_maze = re.match(r"(maze|engine|pretraining\.maze)\b", key)
                    good = world == "maze" or not of_maze
                    require(good, f"'{key}' must go with world=maze", f"world={world}")
                for key in leaves(OmegaConf.to_container(cfg)):
                    if unknown := unknown_setting(key, name, methods_of(cfg)):
                        raise SettingsError(unknown)
                if own is not None:
                    keep_draws(own, cfg, words)
                    remove_halves(folder)
                settings: Settings = OmegaConf.to_object(cfg)  # type: ignore[assignment]
                function(settings, folder)
            except BaseException:
                # What wrote into the working directory made no folder.
                made = folder.resolve() != Path.cwd()
                if made and not OmegaConf.select(cfg, "resume"):
                    log = f"{job.job.name}.log"
                    remove_unused(folder, {log} if own is None else {log, own.name})
                raise
    except Exception as error:
        sentence = sentence_of(error, name)
        if job.mode is not RunMode.MULTIRUN or sentence is None:
            with _one_sentence(name):
                raise
        # Hydra goes on with the next job, and raises the first error at the end.
        print(f"{name}: {sentence} ({' '.join(words)})", file=sys.stderr)  # noqa: T201
        refused = isinstance(error, REFUSALS)
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
    known = set(settings_of(RECIPES[recipe]))
    for group, schemas in METHODS.items():
        known.update(*(settings_of(schema, f"{group}.") for schema in schemas.values()))
    old = OmegaConf.to_container(read_yaml(config)) if config.is_file() else {}
    other = next((key for key in leaves(old) if key not in known), None)
    require(
        other is None,
        f"resume must name a run of {recipe} of this version",
        f"'{folder}', which an earlier version (or another recipe) made with other "
        f"settings, '{other}'",
    )
    first: Any = OmegaConf.to_container(read_yaml(overrides, ListConfig))
    rule = "resume must name a run whose command line was kept whole"
    whole = all(isinstance(word, str) and word[:1] not in ("", "=") for word in first)
    require(whole, rule, f"'{overrides}'")
    kept = [word for word in first + arguments if not word.startswith("resume=")]
    return [*kept, *(f"{key}={_quoted(folder)}" for key in ("resume", "hydra.run.dir"))]


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
    except KeyboardInterrupt:
        print(f"{name}: stopped by Ctrl-C", file=sys.stderr)  # noqa: T201
        sys.exit(128 + signal.SIGINT)
    except Exception as error:
        if (sentence := sentence_of(error, name)) is None:
            raise
        print(f"{name}: {sentence}", file=sys.stderr)  # noqa: T201
        sys.exit(_USAGE_ERROR if isinstance(error, REFUSALS) else _FAILED)
