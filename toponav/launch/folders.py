"""Folders that Hydra makes for runs: theirs alone, and whole, or none at all."""

import os
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from pathlib import Path
from typing import IO, Any

from hydra.core import utils
from hydra.core.hydra_config import HydraConfig
from hydra.core.plugins import Plugins
from hydra.core.utils import JobReturn, JobStatus
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import DictConfig, OmegaConf

from toponav.config import SettingsError, require
from toponav.runs import (
    CHECKPOINT_FILE,
    DRAWS_FILE,
    LAYOUT_FILE,
    alone_in,
    has_results,
    remove_empty,
    remove_unused,
    write_text,
)

_configure_log = utils.configure_log
_hydras_sweeper = Plugins.instantiate_sweeper
# Holds the lock of a job from before Hydra writes into its folder.
_lock = ExitStack()
# Of the job that took it, why it is refused, if it is; empty where no hook of ours ran.
_begun: list[SettingsError | None] = []
# What Hydra saves of a run, in this order.
_SAVED = ("config.yaml", "hydra.yaml", "overrides.yaml")


def folder_setting(words: Sequence[str], *, sweep: bool) -> str:
    """The setting that says where a run writes, for a command line."""
    given = [word[7:].strip("'\"") for word in words if word.startswith("resume=")]
    if any(folder not in ("", "null") for folder in given):
        return "resume"
    return "hydra.sweep.dir" if sweep else "hydra.run.dir"


def log_in_own_folder(
    log_config: DictConfig, verbose_config: bool | str | Sequence[str] = False
) -> None:
    """Let Hydra open its log, the first file of a run, if the folder is the run's own.

    From then on it is: `job_lock` takes the lock over. `SettingsError` if another run
    is writing there, or has left its results; for a job of a sweep `job_lock` raises
    it, since an error here would end the whole sweep.
    """
    # A sweep's own log is opened where no job is.
    job = HydraConfig.get() if HydraConfig.initialized() else None
    # A recipe without settings in its folder writes beside the runs of others.
    if job and job.output_subdir is not None:
        _begun[:] = [None]
        try:
            _take(_lock, Path(job.runtime.output_dir) / job.output_subdir)
        except SettingsError as error:
            if not is_sweep():
                raise
            _begun[:] = [error]
    _configure_log(log_config, verbose_config)


def _take(held: ExitStack, own: Path) -> None:
    """Hold the lock of a job's settings folder, if its run folder has no results."""
    held.callback(remove_empty, own)  # of one that is refused
    held.enter_context(alone_in(own))
    _require_free(own.parent)


def _require_free(folder: Path) -> None:
    """Refuse to begin a run where another one has left its results."""
    can_go_on = (folder / CHECKPOINT_FILE).is_file()
    hint = f" (did you mean resume='{folder}'?)" if can_go_on else ""
    setting = folder_setting((), sweep=is_sweep())
    rule = f"{setting} must name a folder without results of another run"
    words: Any = OmegaConf.to_container(HydraConfig.get().overrides.task)  # as given
    resumes = any(one.startswith("resume='") for one in words)
    require(resumes or not has_results(folder), rule, f"'{folder}'{hint}")


@contextmanager
def job_lock(own: Path | None) -> Iterator[None]:
    """Hold the lock of a job's settings folder, which is taken already as a rule.

    ``None`` for a job that writes beside others. `SettingsError` if another run is
    writing there, or has left its results.
    """
    with _lock.pop_all() as held:
        if own is not None:
            # Where a launcher has Hydra open no log.
            if not _begun:
                _take(held, own)
            elif (refusal := _begun.pop()) is not None:
                raise refusal
        yield


def save_whole(cfg: Any, filename: str, output_dir: Path) -> None:
    """Write what Hydra would write in place; a killed resume leaves the former file.

    Where it cannot be written, a folder that holds nothing else is removed.
    """
    # The settings of another run stay; `job_lock` refuses this job of a sweep.
    if any(_begun):
        return
    try:
        output_dir.mkdir(parents=True, exist_ok=True)
        write_text(output_dir / filename, OmegaConf.to_yaml(cfg))
    except OSError:
        earlier = _SAVED[: _SAVED.index(filename)] if filename in _SAVED else ()
        with suppress(OSError):
            found = {path.name for path in output_dir.iterdir()}
            if found <= {".lock", *earlier}:
                remove_refused(output_dir.parent, output_dir, before=())
        raise


class SavesWhole(OmegaConf):
    """What Hydra's sweeper writes ``multirun.yaml`` by, which would do so in place."""

    @staticmethod
    def save(config: Any, f: str | Path | IO[Any], resolve: bool = False) -> None:
        """Write settings; a sweep that is killed leaves all of the file or nothing."""
        if isinstance(f, str | Path):
            write_text(Path(f), OmegaConf.to_yaml(config, resolve=resolve))
        else:
            OmegaConf.save(config, f, resolve)


def make_sweeper(plugins: Plugins, *, config: DictConfig, **arguments: Any) -> Any:
    """Hydra's sweeper, which leaves no folder where no job of the sweep has a run.

    It makes the folder before it composes the jobs, and one that is bad ends them all.
    A job that fails does not: its error is raised after the last batch.
    """
    name = "hydra.sweeper.max_batch_size"
    size = OmegaConf.select(config, name)
    require(size is None or size > 0, f"{name} must be null or at least 1", size)
    sweeper: Any = _hydras_sweeper(plugins, config=config, **arguments)
    # Plugins are loaded as modules of their own, which an import does not give.
    module = sweeper.sweep.__func__.__globals__
    if "OmegaConf" in module:
        module["OmegaConf"] = SavesWhole
    sweep, failed = sweeper.sweep, list[JobReturn]()
    # Optimisers among Hydra's plugins have it elsewhere, and need each result.
    launcher: Any = getattr(sweeper, "launcher", None)

    def launch_batch(*batch: Any, launch: Any, **numbered: Any) -> list[JobReturn]:
        ended = launch(*batch, **numbered)
        failed.extend(job for job in ended if job.status is JobStatus.FAILED)
        return [job for job in ended if job.status is not JobStatus.FAILED]

    def tidy(arguments: list[str]) -> Any:
        try:
            found = sweep(arguments)
            for job in failed:
                job.return_value  # noqa: B018 -- which raises its error
            return found
        except Exception:
            with suppress(Exception):  # a folder that cannot be named or read
                remove_sweep(Path(config.hydra.sweep.dir))
            raise

    sweeper.sweep = tidy
    if launcher is not None:
        launcher.launch = partial(launch_batch, launch=launcher.launch)
    return sweeper


def remove_sweep(folder: Path) -> None:
    """Remove the folder of a sweep without a run, and never the working directory."""
    if folder.resolve() != Path.cwd():
        remove_unused(folder, {"multirun.yaml"})
    else:
        (folder / "multirun.yaml").unlink(missing_ok=True)


def remove_refused(folder: Path, own: Path | None, *, before: Collection[str]) -> None:
    """Remove the folder of a run that was refused, unless it holds something.

    Args:
        folder: of the run.
        own: of its settings, in ``folder``; ``None`` if it has none.
        before: names in the working directory before the run. It is never removed, but
            what was made in it is.
    """
    log = f"{HydraConfig.get().job.name}.log"
    names = {log} if own is None else {log, own.name}
    if folder.resolve() != Path.cwd():
        remove_unused(folder, names)
    elif own is not None:
        for path in (folder / name for name in names - set(before)):
            if path.is_dir():
                remove_unused(path, [*_SAVED, DRAWS_FILE, LAYOUT_FILE, ".lock"])
            else:
                path.unlink(missing_ok=True)


@contextmanager
def refusing_folders(words: Sequence[str], began: Callable[[], bool]) -> Iterator[None]:
    """Make one sentence of a folder that Hydra cannot make or write to.

    Args:
        words: the command line.
        began: whether a job did, whose errors are its own.

    Raises:
        SettingsError: that names the setting and the folder.
    """
    try:
        with _lock:
            yield
    except (OSError, ValueError) as error:
        if began() or isinstance(error, (SettingsError, HydraException)):
            raise
        # The log's file stands behind another error.
        cause = error.__cause__ if isinstance(error.__cause__, OSError) else error
        if not isinstance(cause, OSError) and "null byte" not in str(cause):
            raise
        where = getattr(cause, "filename", None)
        reason = getattr(cause, "strerror", None) or str(cause)
        if where is not None:
            # Parents that were made before the last one could not be.
            remove_empty(Path(os.fsdecode(where)).parent)
        setting = folder_setting(words, sweep=bool({"-m", "--multirun"} & set(words)))
        rule = f"{setting} must name a folder that can be made and written to"
        given = f"'{os.fsdecode(where)}' ({reason})" if where is not None else reason
        raise SettingsError(f"{rule}, got {given}") from error


def is_sweep() -> bool:
    """Whether the job that runs is one of several that ``-m`` started."""
    return HydraConfig.get().mode is RunMode.MULTIRUN
