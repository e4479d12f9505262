"""`recipe`: the jobs of a command line, each with settings and a folder of its own."""

import argparse
import inspect
import logging
import os
import re
import signal
import sys
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn, TypeVar

import hydra
import hydra.core.plugins
import hydra.core.utils
from hydra.core.hydra_config import HydraConfig
from omegaconf import DictConfig, OmegaConf

from toponav.config import SettingsError, require
from toponav.interrupts import catch_as_usual, ignore_signals
from toponav.launch.arguments import (
    folder_name,
    named_folder,
    quote_names,
    require_known,
    require_own_subdir,
    resumed_arguments,
)
from toponav.launch.folders import (
    folder_setting,
    is_sweep,
    job_lock,
    log_in_own_folder,
    make_sweeper,
    refusing_folders,
    remove_refused,
    save_whole,
)
from toponav.methods import register
from toponav.refusals import REFUSALS, sentence_of
from toponav.runs import (
    keep_draws,
    log_uniform,
    remove_halves,
    require_room,
)

Settings = TypeVar("Settings")

_FAILED = 1
_USAGE_ERROR = 2
#: Room for settings and tables, which all runs write, in MB.
_LEAST_MB = 1.0


class _JobError(Exception):
    """A job of a sweep ended with a sentence, which it printed; its status and that."""


class _Hooks:
    """Puts ours in place of functions of Hydra's; where it is unpickled, at once.

    A launcher may start another process for a job, where Hydra writes into the job's
    folder before it calls the recipe.
    """

    def put(self) -> None:
        _register()
        hydra.core.utils._save_config = save_whole
        hydra.core.utils.configure_log = log_in_own_folder
        hydra.core.utils.JobReturn.return_value = _return_value  # type: ignore[assignment, method-assign]

    def __reduce__(self) -> tuple[Callable[[], "_Hooks"], tuple[()]]:
        return _hooks_that_are_put, ()


def _hooks_that_are_put() -> _Hooks:
    hooks = _Hooks()
    hooks.put()
    return hooks


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
        # The folder of the sweep of each job that began here, and what was here before.
        jobs, before, hooks = list[Path](), set[str](), _Hooks()

        def run(cfg: DictConfig) -> None:
            hooks.put()  # named here so that a launcher pickles them, too
            jobs.append(Path(HydraConfig.get().sweep.dir))
            _run_job(name, function, cfg, before)

        def main() -> None:
            hooks.put()
            # TorchRL logs every buffer that it makes, on standard output.
            logging.getLogger("torchrl").setLevel(logging.WARNING)
            # Hydra then raises instead of printing, and the sentence is ours.
            os.environ["HYDRA_FULL_ERROR"] = "1"
            argparse.ArgumentParser.error = _refuse_flags  # type: ignore[assignment, method-assign]
            hydra.core.plugins.Plugins.instantiate_sweeper = make_sweeper  # type: ignore[assignment, method-assign]
            start = hydra.main(
                version_base="1.3", config_path=str(conf), config_name=name
            )(run)
            with _one_sentence(name, jobs):
                catch_as_usual()
                before.update(os.listdir())
                arguments = sys.argv[1:]
                for word in arguments:
                    rule = "a setting must have a name before its equals sign"
                    require(not word.startswith("="), rule, f"'{word}'")
                    # Which OmegaConf cannot merge into what Hydra has there: nothing.
                    params = re.match(r"\+*hydra\.sweeper(\.params)?=", word)
                    rule = "a sweep must be given by settings such as seed=0,1"
                    require(params is None, rule, f"'{word}'")
                for word, setting in (aliases or {}).items():
                    arguments = [
                        re.sub(f"^{word}=", f"{setting}=", given) for given in arguments
                    ]
                if first:
                    arguments = named_folder(arguments, first)
                require_own_subdir(arguments, conf / f"{name}.yaml")
                arguments = quote_names(arguments, conf)
                sys.argv[1:] = resumed_arguments(arguments, name)
                with refusing_folders(sys.argv[1:], lambda: bool(jobs)):
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
    if found := re.fullmatch("unrecognized arguments: ([^-].*)", message):
        rule = "flags such as -m must come before all settings or after them"
        raise SettingsError(f"{rule}, got one before {found.group(1)}")
    raise SettingsError(f"what begins with a dash must be a flag of Hydra's: {message}")


def _result(job: hydra.core.utils.JobReturn) -> Any:
    """What a job returned; one that failed has said why, where Hydra would say that."""
    if isinstance(job._return_value, _JobError):
        raise job._return_value
    return _hydras_result(job)


_hydras_result = hydra.core.utils.JobReturn.return_value.fget  # type: ignore[attr-defined]
_return_value = property(_result, hydra.core.utils.JobReturn.return_value.fset)  # type: ignore[attr-defined]


def _run_job(
    name: str,
    function: Callable[[Settings, Path], None],
    cfg: DictConfig,
    before: Collection[str],
) -> None:
    job = HydraConfig.get()
    folder = Path(job.runtime.output_dir)
    # A recipe without settings in its folder writes beside the runs of others.
    own = None if job.output_subdir is None else folder / job.output_subdir
    words: Any = OmegaConf.to_container(job.overrides.task)
    try:
        # The lock comes first: without it a run must not remove the folder.
        with job_lock(own):
            try:
                require_known(cfg, words, name)
                if own is not None:
                    setting = folder_setting(words, sweep=is_sweep())
                    require_room(folder, setting, _LEAST_MB)
                    keep_draws(own, cfg, words)
                    remove_halves(folder)
                settings: Settings = OmegaConf.to_object(cfg)  # type: ignore[assignment]
                function(settings, folder)
            except BaseException:
                if not OmegaConf.select(cfg, "resume"):
                    remove_refused(folder, own, before=before)
                raise
    except Exception as error:
        sentence = sentence_of(error, name)
        if not is_sweep() or sentence is None:
            with _one_sentence(name, ()):
                raise
        # Hydra goes on with the next job, and raises the first error at the end.
        given = re.sub(r"\s*\n\s*", " ", " ".join(words))
        said = f"{name}: {sentence} ({given})"
        print(said, file=sys.stderr)  # noqa: T201
        refused = isinstance(error, REFUSALS)
        raise _JobError(_USAGE_ERROR if refused else _FAILED, said) from error


@contextmanager
def _one_sentence(name: str, jobs: Sequence[Path]) -> Iterator[None]:
    """Say what is wrong with the settings or the engine, and end the process.

    Of a sweep each job has said it; where it has several, the last line says so. Where
    they ran elsewhere, what the first one said is repeated, as launchers keep that in
    files.
    """
    try:
        yield
    except _JobError as error:
        status, said = error.args
        if not jobs:
            print(said, file=sys.stderr)  # noqa: T201
        if len(jobs) != 1:
            rest = "not all jobs of the sweep succeeded"
            print(f"{name}: {rest}", file=sys.stderr)  # noqa: T201
        sys.exit(status)
    except KeyboardInterrupt:
        print(f"{name}: stopped by Ctrl-C", file=sys.stderr)  # noqa: T201
        sys.exit(128 + signal.SIGINT)
    except Exception as error:
        if (sentence := sentence_of(error, name)) is None:
            raise
        print(f"{name}: {sentence}", file=sys.stderr)  # noqa: T201
        sys.exit(_USAGE_ERROR if isinstance(error, REFUSALS) else _FAILED)
