"""Folders that Hydra makes for runs: theirs alone, and whole, or none at all."""

import os
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from hydra.core.hydra_config import HydraConfig
from hydra.errors import HydraException
from hydra.types import RunMode
from omegaconf import OmegaConf

from toponav.config import SettingsError
from toponav.runs import DRAWS_FILE, remove_empty, remove_unused, write_text

# What Hydra saves of a run, in this order.
_SAVED = ("config.yaml", "hydra.yaml", "overrides.yaml")


def folder_setting(words: Sequence[str], *, sweep: bool) -> str:
    """The setting that says where a run writes, for a command line."""
    if any(word.startswith("resume=") and word[7:] != "null" for word in words):
        return "resume"
    return "hydra.sweep.dir" if sweep else "hydra.run.dir"


def save_whole(cfg: Any, filename: str, output_dir: Path) -> None:
    """Write what Hydra would write in place; a killed resume leaves the former file.

    Where it cannot be written, a folder that holds nothing else is removed.
    """
    try:
        output_dir.mkdir(parents=True, exist_ok=True)
        write_text(output_dir / filename, OmegaConf.to_yaml(cfg))
    except OSError:
        earlier = _SAVED[: _SAVED.index(filename)] if filename in _SAVED else ()
        with suppress(OSError):
            if {path.name for path in output_dir.iterdir()} <= set(earlier):
                remove_refused(output_dir.parent, output_dir, before=())
        raise


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
                remove_unused(path, [*_SAVED, DRAWS_FILE, ".lock"])
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
