"""WAD files: packed, kept on disk by content, and tried before Python loads them.

An engine that fails while it starts crashes Python, so a child process loads each WAD
first, once per content and engine version.
"""

import hashlib
import os
import struct
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path

from toponav.envs.cache import cache_folder
from toponav.envs.engines.doom import instances
from toponav.envs.game import EngineError

_HEADER_SIZE = 12
_CACHE = "wads"
_SECONDS = 120.0
# What has this suffix and this age in seconds, nobody goes on writing.
_HALF, _OLD_S = ".half", 3600.0
_LOAD_ONCE = """
import sys, vizdoom
wad, map_name, ini = sys.argv[1:]
game = vizdoom.DoomGame()
game.set_doom_config_path(ini)
game.set_doom_scenario_path(wad)
game.set_doom_map(map_name)
game.set_window_visible(False)
game.init()
game.advance_action(1)
game.close()
"""


def build_wad(lumps: Sequence[tuple[str, bytes]]) -> bytes:
    """Pack lumps, pairs of name (at most 8 letters) and content, into a patch WAD.

    It is a header, the contents and a directory of (start, size, name).
    """
    directory = contents = b""
    for name, content in lumps:
        if len(name) > 8:
            raise ValueError(f"a lump name must have at most 8 letters, got '{name}'")
        start = _HEADER_SIZE + len(contents)
        directory += struct.pack("<ii8s", start, len(content), name.encode("ascii"))
        contents += content
    start = _HEADER_SIZE + len(contents)
    return struct.pack("<4sii", b"PWAD", len(lumps), start) + contents + directory


def lump_names(wad: bytes) -> list[str]:
    """Names of a WAD's lumps, in order; none if the bytes are not a whole WAD."""
    try:
        kind, number, start = struct.unpack_from("<4sii", wad)
        entries = [
            struct.unpack_from("<8x8s", wad, start + 16 * i) for i in range(number)
        ]
        names = [name.rstrip(b"\0").decode("ascii") for (name,) in entries]
    except (struct.error, UnicodeDecodeError):
        return []
    return names if kind == b"PWAD" else []


def wad_file(wad: bytes) -> Path:
    """The file of a WAD, named by its content and written atomically."""
    path = cache_folder(_CACHE) / f"{hashlib.sha256(wad).hexdigest()}.wad"
    if not path.exists() or path.read_bytes() != wad:
        _remove_halves(path.parent)
        with tempfile.NamedTemporaryFile(
            dir=path.parent, prefix=".", suffix=_HALF, delete=False
        ) as file:
            file.write(wad)
        os.replace(file.name, path)
    return path


def _remove_halves(folder: Path) -> None:
    """Remove what processes that were killed have not finished writing."""
    for half in folder.glob(f".*{_HALF}"):
        with suppress(FileNotFoundError):
            if time.time() - half.stat().st_mtime > _OLD_S:
                half.unlink()


def check_wad(wad: Path, map_name: str, *, seconds: float = _SECONDS) -> None:
    """Raise an ``EngineError`` if the engine dies or hangs on this map of this WAD."""
    content = wad.read_bytes()
    digest = hashlib.sha256(content).hexdigest()
    mark = cache_folder(_CACHE) / f"{digest}-{map_name}-{version('vizdoom')}.ok"
    if mark.exists():
        return
    must = f"the engine must load {wad.name}"
    if map_name not in lump_names(content):  # the engine would hang
        raise EngineError(f"{must}, and it holds no map named '{map_name}'")
    folder = instances.claim()
    ini = str(instances.ini_path(folder))
    try:
        child = subprocess.run(
            [sys.executable, "-P", "-c", _LOAD_ONCE, str(wad), map_name, ini],
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
        status = f"exit status {child.returncode}; its last output: {last}"
        raise EngineError(f"{must}, and it failed with {status}")
    mark.touch()
