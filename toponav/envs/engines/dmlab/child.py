"""The process in which one engine runs; a script that imports nothing of toponav.

The engine is a library: a fault in it ends its process, it holds Python's lock while it
draws, and a fork would copy its threads' locks. So each has a process of its own, which
serves requests ``(name, *arguments)`` over a socket and ends with its owner.
"""

import fcntl
import json
import os
import shutil
import signal
import sys
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

# So often it looks whether its owner still lives; forks keep sockets open.
_SECONDS = 2.0


class MapCache:
    """Compiled maps by name and content, in one folder for all engines of a user.

    Of several engines that miss the same map one compiles it, and the others wait.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._lock: Any = None

    def fetch(self, key: str, pk3_path: str) -> bool:
        """Copy a map to where the engine wants it; false if it has to be compiled."""
        self.unlock()
        self._lock = (self._folder / f"{key}.lock").open("w")
        fcntl.flock(self._lock, fcntl.LOCK_EX)
        kept = self._folder / f"{key}.pk3"
        if not kept.exists():
            return False
        try:
            shutil.copyfile(kept, pk3_path)
        finally:
            self.unlock()
        return True

    def write(self, key: str, pk3_path: str) -> None:
        """Keep a compiled map."""
        partly = self._folder / f"{key}.{os.getpid()}"
        shutil.copyfile(pk3_path, partly)
        partly.replace(self._folder / f"{key}.pk3")
        self.unlock()

    def unlock(self) -> None:
        """Let others compile a map that was missed."""
        if self._lock is not None:
            self._lock.close()
            self._lock = None


class Server:
    """Answers the requests of ``Engine``, each with ``("ok", value)`` or an error."""

    def __init__(self, options: dict[str, Any]) -> None:
        import deepmind_lab

        names = ["POSE", options["view"]]
        self._maps = MapCache(Path(options["cache"]))
        self._lab = deepmind_lab.Lab(
            options["level"],
            names,
            options["config"],
            "software",
            level_cache=self._maps,
            temp_folder=options["folder"],
        )
        self._names, self._is_warm = names, False

    def reset(self, scene: str, idle: int) -> tuple[bytes, list[float]]:
        """Load a scene and wait until the agent stands: its view and pose."""
        try:
            # An engine's first episode runs a little otherwise than all that follow.
            for _ in range(1 if self._is_warm else 2):
                self._lab.write_property("scene", scene)
                self._lab.reset(seed=0)
        finally:
            self._maps.unlock()  # held yet where a map did not compile
        self._is_warm = True
        _, view, pose = self.act([0] * 7, idle, None)
        return view, pose

    def respawn(self, pose: str) -> None:
        """Say where the goal puts the agent."""
        self._lab.write_property("respawn", pose)

    def act(
        self, action: list[int], frames: int, least: float | None
    ) -> tuple[float, bytes, list[float]]:
        """Hold an action for some frames, or until one of them pays ``least``."""
        held = np.array(action, dtype=np.intc)
        if least is None:
            reward = self._lab.step(held, num_steps=frames)
        else:
            reward = 0.0
            for _ in range(frames):
                earned = self._lab.step(held, num_steps=1)
                reward += earned
                if earned >= least:
                    break
        seen = self._lab.observations()
        view, pose = seen[self._names[1]], seen[self._names[0]]
        return reward, view.tobytes(), pose.tolist()


def main() -> None:
    """Serve until the owner closes the socket or dies."""
    # The owner ends its engines; a Ctrl-C reaches the whole group.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    options = json.loads(Path(sys.argv[1]).read_text())
    sys.path[:] = options["path"]
    link: Connection[Any, Any] = Connection(options["socket"])
    with suppress(EOFError, OSError):
        serve(link, options)
    # The owner is gone; while it is there, it reads the log of one that failed.
    shutil.rmtree(options["folder"], ignore_errors=True)


def serve(link: "Connection[Any, Any]", options: dict[str, Any]) -> None:
    """Start the engine and answer; an ``EOFError`` where nobody asks any more."""
    server: Server | None = None
    name, arguments = "start", (options,)
    while True:
        try:
            if server is None:
                server, value = Server(*arguments), None
            else:
                value = getattr(server, name)(*arguments)
        except Exception as error:
            link.send(("error", f"{type(error).__name__}: {error}"))
        else:
            link.send(("ok", value))
        while not link.poll(_SECONDS):
            if os.getppid() != options["owner"]:
                return
        name, *arguments = link.recv()


if __name__ == "__main__":
    main()
