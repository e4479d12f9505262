"""Where a run of `faults` is: its folder, its processes, and what it leaves."""

import math
import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path

import psutil

ROOT = Path(__file__).resolve().parent.parent
#: Seconds that a run, or what is left of one that was killed, may take: many, since a
#: busy machine is slow, and a hang has no end.
LIMIT_S, END_S = 900.0, 300.0


@dataclass
class Place:
    """Where the runs of a case are, and the mark by which its processes are known.

    ``marks`` are their numbers and those of engines, which names in shared memory have.
    """

    folder: Path
    marks: set[str] = field(default_factory=set)

    @property
    def temporary(self) -> Path:
        return self.folder / "tmp"

    @property
    def run(self) -> Path:
        return self.folder / "run"

    @property
    def runs(self) -> list[Path]:
        """The folder of the run, and of the pre-training that it started, if it did."""
        return [self.run, *pretraining_of(self.run).glob("*")]

    def start(self, words: Sequence[str], name: str, cwd: Path) -> subprocess.Popen:
        """A recipe in a session of its own; what it prints goes into files."""
        self.temporary.mkdir(parents=True, exist_ok=True)
        recipe, *settings = words
        inherited = {"PYTHONPATH": str(ROOT), "TMPDIR": str(self.temporary)}
        cache = {"XDG_CACHE_HOME": str(self.folder / "cache")}
        with (
            (self.folder / f"{name}.out").open("wb") as output,
            (self.folder / f"{name}.err").open("wb") as errors,
        ):
            return subprocess.Popen(
                [sys.executable, str(ROOT / "recipes" / f"{recipe}.py"), *settings],
                cwd=cwd,
                env={**os.environ, **inherited, **cache},
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=errors,
                start_new_session=True,
                # A shell that starts this in the background ignores Ctrl-C.
                preexec_fn=_take_signals,
            )

    def said(self, name: str) -> str:
        return (self.folder / f"{name}.err").read_text(errors="replace")

    def processes(self, word: str = "", but: str = "\0") -> list[psutil.Process]:
        """Those with this place's folder for temporary files, whoever started them.

        Their command lines have one word in them, and not the other.
        """
        found = []
        for process in psutil.process_iter():
            try:
                mine = process.environ().get("TMPDIR") == str(self.temporary)
                line = " ".join(process.cmdline()) if mine else ""
                if mine:
                    engine = re.findall(r"\+viz_instance_id (\w+)", line)
                    self.marks.update([str(process.pid), *engine])
                if mine and word in line and but not in line:
                    found.append(process)
            except psutil.Error:  # it has ended, or is somebody else's
                continue
        return [one for one in found if one.pid != os.getpid()]

    def wait(self, process: subprocess.Popen, core_s: float = math.inf) -> float:
        """Wait until a run has used so much, or ends; what its processes used."""
        used, deadline = dict[int, float](), time.monotonic() + LIMIT_S
        while process.poll() is None and sum(used.values()) < core_s:
            for one in self.processes():
                with suppress(psutil.Error):
                    used[one.pid] = sum(one.cpu_times()[:2])
            if time.monotonic() > deadline:
                raise subprocess.TimeoutExpired(process.args, LIMIT_S)
            time.sleep(0.05)
        return sum(used.values())

    def left(self, memory: set[str]) -> list[str]:
        """Processes, folders of engines, and shared memory that is new."""
        found = [" ".join(one.cmdline())[:200] for one in self.processes()]
        found += [str(one) for one in self.temporary.glob("toponav-*/vizdoom-*/*")]
        if new := set(shared_memory()) - memory:
            found += sorted(filter(self._may_own, new - _mapped()))
        return found

    def _may_own(self, name: str) -> bool:
        """Whether a name in shared memory may be of this place: others run, too."""
        owner = re.match(r"(?:ViZDoom(?:SM|MQCtr|MQDoom)|sem.loky-|torch_)(\w+)", name)
        return owner is None or owner[1].partition("_")[0] in self.marks

    def end(self) -> None:
        for process in self.processes():
            process.kill()


def pretraining_of(run: Path) -> Path:
    """Where an exploration in this folder keeps a pre-training of its own."""
    return run.with_name(f"{run.name}-pretraining")


def _take_signals() -> None:
    signal.signal(signal.SIGINT, signal.default_int_handler)


def wait_until(over: Callable[[], bool], seconds: float) -> bool:
    """Whether it was over within so many seconds."""
    deadline = time.monotonic() + seconds
    while not (found := over()) and time.monotonic() < deadline:
        time.sleep(0.05)
    return found


def shared_memory() -> list[str]:
    """Names of all shared memory that there is."""
    folder = Path("/dev/shm")
    return [path.name for path in folder.iterdir()] if folder.is_dir() else []


def _mapped() -> set[str]:
    """Names of the shared memory that a living process uses."""
    found = set()
    for process in psutil.process_iter():
        try:
            files = [one.path for one in process.memory_maps()]
        except (psutil.Error, OSError):
            continue
        found |= {Path(one).name for one in files if one.startswith("/dev/shm/")}
    return found
