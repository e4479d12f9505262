"""Python processes that run mazes and end in every possible way."""

import json
import os
import subprocess
import sys
from pathlib import Path

import psutil

REPOSITORY = Path(__file__).parent.parent.parent
SHARED_MEMORY = Path("/dev/shm")

_PREAMBLE = """
import json, os, signal, sys, threading, time
from pathlib import Path
from tests.envs.layouts import GATE, LANE
from toponav.envs import MazeEnv
from toponav.envs.engines.doom import instances

# A shell that starts the tests in the background lets them ignore Ctrl-C.
signal.signal(signal.SIGINT, signal.default_int_handler)

def report(*envs):
    '''Engines' process and instance numbers, then wait for a line.'''
    engines = [game.engine for env in envs for game in env.games._games]
    found = {
        "pids": [engine.pid for engine in engines],
        "ids": [engine.game.get_instance_id() for engine in engines],
    }
    print(json.dumps(found), flush=True)
    sys.stdin.readline()
"""


class Child:
    """A Python process that runs a script after ``report`` and some imports.

    Args:
        script: what it does; it must call ``report`` once.
        cwd: its working directory.
    """

    def __init__(self, script: str, cwd: Path = REPOSITORY) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-c", _PREAMBLE + script],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            cwd=cwd,
            env={**os.environ, "PYTHONPATH": str(REPOSITORY)},
        )
        line = self._stdout.readline()
        if not line:
            self.process.kill()
            raise AssertionError(self.process.communicate(timeout=60)[1])
        entries = json.loads(line)
        self.pids: list[int] = entries["pids"]
        self.ids: list[str] = entries["ids"]

    @property
    def _stdout(self):
        assert self.process.stdout is not None
        return self.process.stdout

    def go_on(self) -> None:
        """Let the script run on after ``report``."""
        assert self.process.stdin is not None
        self.process.stdin.write("\n")
        self.process.stdin.flush()

    def wait(self) -> tuple[int, str, str]:
        """Exit status, rest of standard output, standard error."""
        try:
            output, errors = self.process.communicate(timeout=60)
        finally:
            self.process.kill()
        return self.process.returncode, output, errors

    def engines(self) -> list[int]:
        """Those of its engines that still run."""
        return [pid for pid in self.pids if _runs_an_engine(pid)]

    def shared_memory(self) -> list[str]:
        """Names of its engines' files in shared memory."""
        return [
            path.name
            for path in SHARED_MEMORY.glob("ViZDoom*")
            if any(path.name.endswith(identifier) for identifier in self.ids)
        ]


def run(script: str, cwd: Path = REPOSITORY, before: str = "") -> str:
    """Run a script without engines to report; returns its standard output.

    ``before`` comes ahead of the imports.
    """
    child = subprocess.run(
        [sys.executable, "-c", before + _PREAMBLE + script],
        stdin=subprocess.DEVNULL,
        capture_output=True,
        text=True,
        cwd=cwd,
        env={**os.environ, "PYTHONPATH": str(REPOSITORY)},
        timeout=120,
        check=False,
    )
    assert child.returncode == 0, child.stderr
    return child.stdout


def _runs_an_engine(pid: int) -> bool:
    try:
        return any("engine.ini" in word for word in psutil.Process(pid).cmdline())
    except (psutil.NoSuchProcess, psutil.ZombieProcess):
        return False
