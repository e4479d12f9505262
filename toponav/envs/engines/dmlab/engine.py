"""One engine: a child process that runs it, and what becomes of it."""

import importlib.util
import json
import os
import shutil
import socket
import subprocess
import sys
import tempfile
import weakref
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from toponav.envs.cache import cache_folder
from toponav.envs.engines.dmlab.spec import FRAMES_PER_SECOND, WORLD
from toponav.envs.game import EngineError, EngineLostError

_CHILD = Path(__file__).with_name("child.py")
_LEVEL = Path(__file__).with_name("level.lua")
# A map of 101 x 101 cells is compiled in some minutes.
_SECONDS = 600.0
_REMEDY = (
    "build the Python package 'deepmind_lab' from its public source "
    "(https://github.com/google-deepmind/lab; docs/dmlab.md) or use engine=vizdoom"
)
Seen = tuple[NDArray[np.uint8], list[float]]


def check_installed() -> None:
    """An ``EngineError`` where Python finds no engine."""
    if importlib.util.find_spec("deepmind_lab") is None:
        raise EngineError(
            "the DeepMind Lab engine must be installed, and there is no Python "
            f"package 'deepmind_lab': {_REMEDY}"
        )


class Engine:
    """Runs the package's level in a process of its own, without a window.

    ``settings`` are those of the level (``level.lua`` lists them), and ``view`` is the
    engine's name of the picture. An ``EngineError`` if it is not installed or does not
    start.
    """

    def __init__(
        self, settings: dict[str, str], *, view: str = "RGB_INTERLEAVED"
    ) -> None:
        self._settings, self._view = settings, view
        self._channels = 4 if "RGBD" in view else 3
        self._start()

    def _start(self) -> None:
        check_installed()
        self._folder = Path(tempfile.mkdtemp(prefix="toponav-dmlab-"))
        ours, theirs = socket.socketpair()
        try:
            with theirs:
                self._process = self._launch(theirs.fileno())
        except OSError as error:
            ours.close()
            shutil.rmtree(self._folder, ignore_errors=True)
            raise EngineError(f"the engine must start, got: {error}") from error
        self._link: Connection[Any, Any] = Connection(ours.detach())
        self._end = weakref.finalize(
            self, _release, os.getpid(), self._process, self._link, self._folder
        )
        try:
            self._answer()
        except EngineError as error:
            self._end()
            raise EngineError(f"the engine must start, got: {error}") from error

    def _launch(self, link: int) -> "subprocess.Popen[bytes]":
        """Start the process that serves at the other end of a socket."""
        # In a file: the look of a large maze is too long for an argument.
        options = self._folder / "options.json"
        options.write_text(json.dumps(self._options(link)))
        with (self._folder / "log").open("wb") as log:
            return subprocess.Popen(
                [sys.executable, "-P", str(_CHILD), str(options)],
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=log,
                pass_fds=[link],
            )

    def _options(self, link: int) -> dict[str, Any]:
        """What ``child.py`` needs to run the engine."""
        height, width = WORLD.view_size
        return {
            "socket": link,
            "owner": os.getpid(),
            "path": sys.path,
            "folder": str(self._folder),
            "cache": str(cache_folder("dmlab-maps")),
            "level": str(_LEVEL),
            "view": self._view,
            "config": {
                "width": str(width),
                "height": str(height),
                "fps": str(FRAMES_PER_SECOND),
                "minimalUI": "true",
                # No network, no hand in the view, no mark in its middle.
                "appendCommand": " +set net_enabled 0 +set cg_drawGun 0"
                " +set cg_drawCrosshair 0 +set cg_drawCrosshairAlways 0",
                **self._settings,
            },
        }

    def reset(self, scene: str, *, idle: int) -> Seen:
        """Load a scene (see ``level.lua``), wait some frames: the view and the pose."""
        return self._seen(*self._ask("reset", scene, idle))

    def set_respawn(self, pose: str) -> None:
        """Say where the goal puts the agent."""
        self._ask("respawn", pose)

    def act(
        self, action: list[int], *, frames: int, least: float | None = None
    ) -> tuple[float, Seen]:
        """Hold an action, at most until a frame pays ``least``: reward, view, pose."""
        reward, view, pose = self._ask("act", action, frames, least)
        return reward, self._seen(view, pose)

    @property
    def pid(self) -> int:
        """Process number of the engine."""
        return self._process.pid

    def restart(self) -> None:
        """Start again, also after the engine's process died."""
        self.close()
        self._start()

    def close(self) -> None:
        """End the engine and remove its files."""
        self._end()

    def _seen(self, view: bytes, pose: list[float]) -> Seen:
        shape = (*WORLD.view_size, self._channels)
        return np.frombuffer(view, dtype=np.uint8).reshape(shape), pose

    def _ask(self, *request: Any) -> Any:
        if not self._end.alive:
            raise EngineError("the engine must be running, and it was closed")
        try:
            self._link.send(request)
        except OSError as error:
            raise EngineLostError(f"the engine died: {self._last_words()}") from error
        return self._answer()

    def _answer(self) -> Any:
        try:
            if not self._link.poll(_SECONDS):
                self._process.kill()
                raise EngineLostError(f"the engine hung for {_SECONDS:g} s")
            kind, value = self._link.recv()
        except (EOFError, OSError) as error:
            raise EngineLostError(f"the engine died: {self._last_words()}") from error
        if kind == "error":
            raise EngineError(value)
        return value

    def _last_words(self) -> str:
        """The exit status and the last line that the process wrote."""
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(5)
        log = self._folder / "log"
        text = log.read_text(errors="replace") if log.exists() else ""
        lines = [line for line in text.splitlines() if line.strip()]
        last = lines[-1].strip() if lines else "nothing"
        return f"exit status {self._process.returncode}; its last output: {last}"


def _release(
    owner: int,
    process: "subprocess.Popen[bytes]",
    link: "Connection[Any, Any]",
    folder: Path,
) -> None:
    """End an engine and remove its files, unless this is a fork of its owner."""
    link.close()
    if os.getpid() == owner:
        process.kill()
        process.wait()
        shutil.rmtree(folder, ignore_errors=True)
