"""Try a WAD in a process of its own before Python loads it.

An engine that fails while it starts crashes Python, and one that looks for an unknown
map never returns. So a child process loads each WAD first, once per content and engine
version.
"""

import hashlib
import subprocess
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from toponav.envs.engines.doom import instances, load_once
from toponav.envs.engines.doom.level.wad import lump_names
from toponav.envs.engines.doom.level.wad_cache import cache_folder
from toponav.envs.errors import EngineError

_SECONDS = 120.0
_REMEDY = (
    "pip has wheels of 'vizdoom' for Linux (x86-64 and ARM with glibc), macOS on "
    "Apple silicon and Windows on x86-64, for Python 3.10 to 3.14; elsewhere build "
    "it from source (https://vizdoom.farama.org) or use one of these systems"
)


def missing_engine(reason: str) -> EngineError:
    """The error for a machine without the engine; it says what to do."""
    return EngineError(
        f"the ViZDoom engine must be installed, and it is not ({reason}): {_REMEDY}"
    )


def engine_version() -> str:
    """Version of the installed engine; an ``EngineError`` says how to install it."""
    try:
        return version("vizdoom")
    except PackageNotFoundError as error:
        raise missing_engine(str(error)) from None


def check_wad(wad: Path, map_name: str, *, seconds: float = _SECONDS) -> None:
    """Make sure that the engine can load this map of this WAD in so many seconds.

    Raises:
        EngineError: if the engine is not installed, or dies or hangs on the file.
    """
    content = wad.read_bytes()
    digest = hashlib.sha256(content).hexdigest()
    mark = cache_folder() / f"{digest}-{map_name}-{engine_version()}.ok"
    if mark.exists():
        return
    must = f"the engine must load {wad.name}"
    try:
        if map_name not in lump_names(content):  # the engine would hang
            raise EngineError(f"{must}, and it holds no map named '{map_name}'")
    except ValueError as error:
        raise EngineError(f"{must}, and {error}") from None
    folder = instances.claim()
    ini = str(instances.ini_path(folder))
    # -P: this package's folder must not shadow the child's imports.
    command = [sys.executable, "-P", load_once.__file__, str(wad), map_name, ini]
    try:
        child = subprocess.run(
            command,
            capture_output=True,
            stdin=subprocess.DEVNULL,
            timeout=seconds,
            check=False,
            cwd=folder,
        )
    except subprocess.TimeoutExpired:
        raise EngineError(f"{must} within {seconds:g} s, and it hangs") from None
    finally:
        instances.release(folder)
    if child.returncode != 0:
        output = (child.stderr + child.stdout).decode(errors="replace").strip()
        last = output.splitlines()[-1] if output else "nothing"
        raise EngineError(
            f"{must}, and it failed with exit status {child.returncode}; "
            f"its last output: {last}"
        )
    mark.touch()
