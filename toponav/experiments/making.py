"""Makes the runs that an experiment lacks: processes of the recipes, side by side."""

import math
import re
import subprocess
import sys
import time
from collections.abc import Iterable, Mapping, Sequence
from contextlib import ExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from filelock import FileLock, Timeout
from omegaconf import OmegaConf
from tqdm import tqdm

from toponav.experiments.cells import Cell
from toponav.experiments.found_runs import decisions_of, is_finished, seconds_of
from toponav.experiments.kept_runs import keep_run
from toponav.runs import CHECKPOINT_FILE

# Seconds in which a run that is asked to stop saves its state.
_STOP_S = 60


@dataclass
class _Job:
    """A process that makes a run."""

    cell: Cell
    process: subprocess.Popen[bytes]
    log: Path
    held: ExitStack
    started: float = field(default_factory=time.monotonic)
    decisions: float = 0.0  # that the run had when this process began
    # When it first reported more of them, and how many: a pre-training may come before.
    first: tuple[float, float] | None = None

    def rate(self, made: float, now: float) -> float:
        """Decisions a second up to those that are ``made``, 0 while it is not known."""
        if made > self.decisions:
            self.first = self.first or (now, made)
        since, before = self.first or (now, made)
        return (made - before) / max(now - since, 1e-9)


class RunMaker:
    """Makes runs by the recipes' own command lines, a number of them side by side.

    A run that was cut off goes on from its checkpoint. One that another process makes
    is waited for, also one that outlived the process which started it. What a run says
    is in ``<folder>.log`` beside its folder.

    Args:
        recipes: the folder of the recipes.
        jobs: runs side by side.
        poll_s: seconds between two looks at them.
    """

    def __init__(self, recipes: Path, *, jobs: int, poll_s: float) -> None:
        self.recipes, self.jobs, self.poll_s = recipes, jobs, poll_s
        self.expected: Mapping[str, float] = {}
        #: By key, the sentence with which a run failed.
        self.failures: dict[str, str] = {}
        self._running: list[_Job] = []
        self._done: set[str] = set()
        self._took = self._should = 0.0

    def make(self, cells: Sequence[Cell], expected: Mapping[str, float]) -> None:
        """Make the cells, each once, first runs before those that need them.

        ``expected`` are the seconds that each should take, by key, for the time that is
        left.
        """
        self.expected = expected
        waiting = list({cell.key: cell for cell in cells}.values())
        total = len(waiting)
        with tqdm(total=total, unit="run", smoothing=0) as bar:
            try:
                while waiting or self._running:
                    waiting = [cell for cell in waiting if not self._settled(cell)]
                    for cell in waiting:
                        if len(self._running) < self.jobs and self._may_start(cell):
                            self._start(cell)
                    going = {job.cell.key for job in self._running}
                    waiting = [cell for cell in waiting if cell.key not in going]
                    self._collect()
                    bar.n = total - len(waiting) - len(self._running)
                    bar.set_postfix_str(self._progress(waiting))
                    if waiting or self._running:
                        time.sleep(self.poll_s)
            finally:
                self._stop()

    def _settled(self, cell: Cell) -> bool:
        """Whether there is nothing left to do for a cell."""
        for first in cell.before:
            if first.key in self.failures:
                why = f"the run that it starts from failed: {self.failures[first.key]}"
                self.failures[cell.key] = why
        if cell.key in self.failures or cell.key in self._done:
            return True
        # Another process may have made it meanwhile.
        return is_finished(cell.folder) and not _is_held(cell.folder)

    def _may_start(self, cell: Cell) -> bool:
        if cell.key in {job.cell.key for job in self._running}:
            return False
        return all(is_finished(one.folder) for one in cell.before)

    def _start(self, cell: Cell) -> None:
        """Start the process of a cell, unless another one is at it."""
        cell.folder.parent.mkdir(parents=True, exist_ok=True)
        held = ExitStack()
        # Ours falls with this process, that of the run with the run's.
        lock = FileLock(cell.folder.with_name(f".{cell.folder.name}.lock"), timeout=0)
        try:
            held.enter_context(lock)
        except Timeout:
            return
        if _is_held(cell.folder) or is_finished(cell.folder):
            held.close()
            return
        log = cell.folder.with_name(f"{cell.folder.name}.log")
        output: IO[bytes] = held.enter_context(log.open("wb"))
        script = str(self.recipes / f"{cell.recipe}.py")
        command = [sys.executable, script, *run_words(cell)]
        process = subprocess.Popen(command, stdout=output, stderr=subprocess.STDOUT)
        before = decisions_of(cell.folder)
        self._running.append(_Job(cell, process, log, held, decisions=before))

    def _collect(self) -> None:
        """Note which processes have ended, and how."""
        for job in list(self._running):
            status = job.process.poll()
            if status is None:
                continue
            self._running.remove(job)
            job.held.close()
            key = job.cell.key
            if status == 0 and is_finished(job.cell.folder):
                self._done.add(key)
                keep_run(job.cell)
                self._compare(job)
                continue
            said = last_sentence(job.log)
            self.failures[key] = said or f"it ended with exit status {status}"
            tqdm.write(f"failed: {job.cell.name}: {self.failures[key]}", sys.stderr)

    def _compare(self, job: _Job) -> None:
        """Count what a run took, its pre-training left out, and what it should take."""
        should = self.expected.get(job.cell.key, math.nan)
        took = seconds_of(job.cell.folder)
        if math.isnan(took):
            took = time.monotonic() - job.started
        if not math.isnan(should):
            self._took += took
            self._should += should

    def _progress(self, waiting: Iterable[Cell]) -> str:
        """What runs now, at which rate, and how long the rest takes."""
        texts, now = [], time.monotonic()
        factor = self._took / self._should if self._should else 1.0
        left = sum(self.expected.get(one.key, math.nan) for one in waiting) * factor
        for job in self._running:
            took, cell = now - job.started, job.cell
            should = self.expected.get(cell.key, math.nan) * factor
            wanted = OmegaConf.select(cell.config, "collect.decisions")
            if wanted is None:
                texts.append(cell.name)
                left += should if math.isnan(should) else max(0.0, should - took)
                continue
            made = decisions_of(cell.folder)
            rate = job.rate(made, now)
            texts.append(f"{cell.name} {made / wanted:.0%}, {rate:.0f} decisions/s")
            # By its own rate once it has one; what comes after it is not in it.
            left += (wanted - made) / rate if rate else should * (1 - made / wanted)
        known = (
            f"about {hours(left / self.jobs)}" if not math.isnan(left) else "unknown"
        )
        return "; ".join([*texts, f"time left: {known}"])

    def _stop(self) -> None:
        """Ask the runs that go on to save and end."""
        for job in self._running:
            job.process.terminate()
        for job in self._running:
            with suppress(subprocess.TimeoutExpired):
                job.process.wait(_STOP_S)
            job.process.kill()
            job.process.wait()
            job.held.close()
        self._running = []


def run_words(cell: Cell) -> list[str]:
    """The command line that makes a cell, or goes on with it."""
    folder = str(cell.folder).replace("'", "\\'")
    if (cell.folder / CHECKPOINT_FILE).is_file():
        return [f"resume='{folder}'"]
    return [*cell.words, f"hydra.run.dir='{folder}'"]


def _is_held(folder: Path) -> bool:
    """Whether a run writes into a folder now."""
    file = folder / "config" / ".lock"
    if not file.is_file():
        return False
    try:
        with FileLock(file, timeout=0):
            return False
    except Timeout:
        return True


def last_sentence(log: Path) -> str:
    """The last line that a run wrote, progress bars left out; empty without any."""
    text = log.read_text(encoding="utf-8", errors="replace") if log.is_file() else ""
    lines = [line.strip() for line in text.splitlines()]
    lines = [line for line in lines if line and not re.search(r"\d%\|", line)]
    return lines[-1] if lines else ""


def hours(seconds: float) -> str:
    """A time in words.

    Examples:
        >>> hours(90), hours(7200)
        ('1.5 minutes', '2.0 hours')
    """
    minutes = seconds / 60
    return f"{minutes:.1f} minutes" if minutes < 60 else f"{minutes / 60:.1f} hours"
