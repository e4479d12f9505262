"""Bookkeeping of engine processes, so that none outlives its owner.

An engine is a process that outlives a killed Python, with three files in shared memory.
So each has a private folder, ``<pid>-<start time>-<random>`` of its owner. The next
start sweeps the folders of dead owners; SIGTERM ends the engines first.
"""

import atexit
import math
import os
import shutil
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from types import FrameType

import psutil

from toponav.envs.engines.doom.shared_memory import (
    SHARED_BYTES,
    SHARED_MEMORY,
    instance_of,
    remove_memory,
    remove_nameless,
)
from toponav.envs.game import EngineError

# The engine writes these sections if they are missing, and then also a folder
# into the working directory; several at once fail over it.
_INI = "".join(
    f"[{game}.AutoExec]\n" for game in ("Doom", "Heretic", "Hexen", "Strife", "Chex")
)
_INI_NAME = "engine.ini"
# Its level, and what it writes beside.
_FILES_BYTES = 1024 * 1024
# So long a start is waited for before its engine is ended.
_PATIENCE_S = 5.0
_starters: dict[Path, threading.Thread] = {}
# A sweep looks at all processes and all engines' files.
_SWEEP_EVERY_S = 1.0
_swept = -math.inf


def check_room() -> None:
    """An ``EngineError`` where no engine could start for want of memory or disk."""
    temporary = Path(tempfile.gettempdir())
    places = {f"{temporary} (TMPDIR)": (temporary, _FILES_BYTES)}
    if sys.platform.startswith("linux"):
        places[str(SHARED_MEMORY)] = (SHARED_MEMORY, SHARED_BYTES)
    for name, (folder, least) in places.items():
        rule = f"{name} must have room for {least // 1024} kB of the engine's"
        try:
            with tempfile.TemporaryFile(dir=folder):
                free = shutil.disk_usage(folder).free
        except OSError as error:
            raise EngineError(f"{rule}, got none ({error.strerror})") from error
        if free < least:
            raise EngineError(f"{rule}, got {free // 1024} kB")


def registry() -> Path:
    """The folder that holds one folder per engine of this user on this machine."""
    user = os.getuid() if hasattr(os, "getuid") else os.environ.get("USERNAME", "user")
    # Process numbers mean nothing outside their namespace (containers may share
    # the temporary folder), so each namespace has a registry of its own.
    namespace = Path("/proc/self/ns/pid")
    mark = namespace.stat().st_ino if namespace.exists() else 0
    return Path(tempfile.gettempdir()) / f"toponav-{user}" / f"vizdoom-{mark}"


def claim() -> Path:
    """Make a private folder for one engine, owned by this process."""
    parent, pid = registry(), os.getpid()
    parent.mkdir(mode=0o700, parents=True, exist_ok=True)
    folder = Path(tempfile.mkdtemp(prefix=f"{pid}-{_started(pid)}-", dir=parent))
    ini_path(folder).write_text(_INI)
    return folder


def ini_path(folder: Path) -> Path:
    """The engine's private configuration file in a claimed folder."""
    return folder / _INI_NAME


def note_instance(folder: Path, instance_id: str) -> None:
    """Record the engine's own instance number, which names its shared memory."""
    (folder / "instance").write_text(instance_id)


def note_starter(folder: Path, starter: threading.Thread) -> None:
    """Say which thread starts the engine: it is not ended before that has returned."""
    _starters[folder] = starter


def release(folder: Path, *, patience: float = _PATIENCE_S) -> None:
    """End an engine and remove all it left, unless this is a fork of its owner.

    One that is still starting, and goes on doing so, is left to the sweep that follows
    this process: ViZDoom 1.3 reads memory that is not there where an engine dies before
    it has started, and takes its process along.
    """
    if not folder.name.startswith(f"{os.getpid()}-"):
        return
    if (starter := _starters.get(folder)) is not None:
        with suppress(RuntimeError):  # that thread may be the one that ends it
            starter.join(max(patience, 0.0))
        if starter.is_alive() and engine_pid(folder) is not None:
            return
        _starters.pop(folder, None)
    _reap(folder)


def sweep_if_due() -> None:
    """Sweep, unless this process did a moment ago: many engines start together."""
    global _swept
    if time.monotonic() - _swept > _SWEEP_EVERY_S:
        sweep()
        _swept = time.monotonic()


def sweep() -> int:
    """Remove what engines of dead owners left; returns the number of folders.

    One that was only starting when its owner ended lives on without its folder.
    """
    commands = [one.info["cmdline"] or [] for one in psutil.process_iter(["cmdline"])]
    inis = (Path(word) for command in commands for word in command if _INI_NAME in word)
    used = {ini.parent for ini in inis if ini.parent.parent == registry()}
    folders = used.union(registry().glob("*"))
    dead = [folder for folder in folders if not _has_owner(folder)]
    for folder in dead:
        _reap(folder)
    remove_nameless(commands)
    return len(dead)


def end_engines_on_sigterm() -> None:
    """On SIGTERM, unless somebody else handles it, end this process's engines first."""
    in_main_thread = threading.current_thread() is threading.main_thread()
    if in_main_thread and signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:
        signal.signal(signal.SIGTERM, _on_sigterm)


def _on_sigterm(number: int, _frame: FrameType | None) -> None:
    # Not through DoomGame.close: another thread may be inside the same game.
    _release_all()
    signal.signal(number, signal.SIG_DFL)
    os.kill(os.getpid(), number)


@atexit.register
def _release_all() -> None:
    deadline = time.monotonic() + _PATIENCE_S
    for folder in registry().glob("*"):
        release(folder, patience=deadline - time.monotonic())


def _has_owner(folder: Path) -> bool:
    """Whether the process that claimed a folder still runs."""
    try:
        pid, started, _ = folder.name.split("-")
        return _started(int(pid)) == started
    except (OSError, ValueError, psutil.Error):
        return False


def _started(pid: int) -> str:
    """What tells a process from a later one of the same number."""
    # Not psutil's wall-clock time: it moves by a second with the clock's drift,
    # and a living owner's engines would be taken for orphans.
    stat = Path(f"/proc/{pid}/stat")
    if stat.exists():
        state, *fields = stat.read_text().rpartition(")")[2].split()
        # A zombie is dead; only its parent has not asked yet.
        return "dead" if state in "ZX" else fields[18]
    return str(round(psutil.Process(pid).create_time(), 1))


def _reap(folder: Path) -> None:
    """End the engine that uses this folder, remove its shared memory, the folder."""
    identifiers = set[str]()
    with suppress(OSError, ValueError):
        identifiers.add((folder / "instance").read_text())
    for process, command in _engines_of(folder):
        identifiers.update(filter(None, [instance_of(command)]))
        with suppress(psutil.Error):
            process.kill()
            process.wait(5)
    for identifier in identifiers:
        remove_memory(identifier)
    shutil.rmtree(folder, ignore_errors=True)


def _engines_of(folder: Path) -> Iterator[tuple[psutil.Process, list[str]]]:
    """Processes whose command line names the folder's configuration file."""
    noted = _noted_process(folder)
    return _matching(folder, psutil.process_iter() if noted is None else noted)


def engine_pid(folder: Path) -> int | None:
    """Process number of the engine that uses a folder of this process, if one does.

    It is recorded, and so is the engine's instance number: of one that dies while it
    starts, nothing else would tell it.
    """
    noted = _noted_process(folder)
    for process, command in _matching(folder, _children() if noted is None else noted):
        if noted is None:
            (folder / "pid").write_text(str(process.pid))
            if (found := instance_of(command)) is not None:
                note_instance(folder, found)
        return int(process.pid)
    return None


def seconds_worked(folder: Path) -> float:
    """Processor time that the engine of a folder has taken; 0 without one."""
    with suppress(psutil.Error):
        if (pid := engine_pid(folder)) is not None:
            times = psutil.Process(pid).cpu_times()
            return float(times.user + times.system)
    return 0.0


def _matching(
    folder: Path, processes: Iterable[psutil.Process]
) -> Iterator[tuple[psutil.Process, list[str]]]:
    config = str(ini_path(folder))
    for process in processes:
        with suppress(psutil.Error):
            if config in (command := process.cmdline()):
                yield process, command


def _noted_process(folder: Path) -> list[psutil.Process] | None:
    """The process that was recorded, if it lives; ``None`` if none was recorded.

    To look through all processes for each engine takes longer the more engines there
    are, and there may be a thousand.
    """
    try:
        pid = int((folder / "pid").read_text())
    except (OSError, ValueError):
        return None
    with suppress(psutil.Error, ValueError, OverflowError):
        return [psutil.Process(pid)]
    return []


def _children() -> Iterator[psutil.Process]:
    """Processes that this one started, the newest first."""
    lists = list(Path("/proc/self/task").glob("*/children"))
    if not lists:
        yield from psutil.Process().children()[::-1]
    pids = list[int]()
    for one in lists:
        with suppress(OSError):  # a thread that has ended
            pids += map(int, one.read_text().split())
    for pid in sorted(pids, reverse=True):
        with suppress(psutil.Error):
            yield psutil.Process(pid)
