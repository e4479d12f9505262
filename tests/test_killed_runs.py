"""An exploration to which everything happens, one after the other, and which goes on.

`benchmarks/faults.py` does it at a hundred random moments.
"""

import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import psutil
import pytest
import torch

from tests.explored import RING
from tests.exploring import save_untrained
from tests.forked import run_forked
from tests.test_explore import SHORT, command, rows

#: A checkpoint is written when the run begins and when it is asked to stop. A busy
#: machine is no fault.
FIRST = (
    *("collect.decisions=100000", "collect.max_idle_s=3000"),
    *("report.every=64", "report.save_every_s=10000"),
)


@contextmanager
def going_on(said: Path, *words: str) -> Iterator[subprocess.Popen[bytes]]:
    """The recipe, in a process group of its own; what it says goes into a file."""
    with said.open("wb") as errors:
        process = subprocess.Popen(
            command(*words),
            stdout=subprocess.DEVNULL,
            stderr=errors,
            start_new_session=True,
        )
        try:
            yield process
        finally:
            with suppress(ProcessLookupError):
                os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def wait_for(
    over: Callable[[], bool], process: subprocess.Popen[bytes], said: Path
) -> None:
    """Until then the process must live; who hangs is ended by the test's timeout."""
    while not over():
        assert process.poll() is None, said.read_text()[-500:]
        time.sleep(0.05)


def reported(folder: Path) -> int:
    """Rows of a run's table."""
    file = folder / "metrics.csv"
    return len(rows(file)) if file.exists() else 0


def saved(folder: Path) -> int:
    """Decisions of the checkpoint."""
    state = torch.load(folder / "checkpoint.pt", weights_only=True)["state"]
    decisions: int = state["decisions"]
    return decisions


def engines(process: subprocess.Popen[bytes]) -> list[psutil.Process]:
    found = []
    for child in psutil.Process(process.pid).children(recursive=True):
        with suppress(psutil.Error):  # it has ended
            if any("engine.ini" in word for word in child.cmdline()):
                found.append(child)
    return found


def semaphores(process: subprocess.Popen[bytes]) -> list[Path]:
    """The files of those that a process has made; joblib puts its number into them."""
    return list(Path("/dev/shm").glob(f"sem.*-{process.pid}-*"))


def require_stopped(status: int, number: int, said: Path) -> None:
    assert status == 128 + number
    assert said.read_text().endswith("stopped; resume=<run folder> continues\n")
    assert "Traceback" not in said.read_text()


@pytest.mark.slow
def test_it_goes_on_whatever_ended_it(tmp_path: Path) -> None:
    folder, said = tmp_path / "run", tmp_path / "said"
    save_untrained(tmp_path / "networks.pt")
    words = [*SHORT, *FIRST, f"pretrained={tmp_path}/networks.pt"]

    # It survives the death of an engine, and is asked to stop in mid-batch.
    with going_on(said, *words, f"hydra.run.dir={folder}") as process:
        wait_for(lambda: reported(folder) >= 1, process, said)
        engines(process)[0].kill()
        before = reported(folder)
        wait_for(lambda: reported(folder) > before + 1, process, said)
        assert saved(folder) == 0
        process.terminate()
        require_stopped(process.wait(), signal.SIGTERM, said)
    stopped, before = saved(folder), reported(folder)
    assert stopped >= 64 * before

    # What was saved goes on. Ctrl-C reaches all processes at once.
    with going_on(said, f"resume={folder}") as process:
        wait_for(lambda: reported(folder) > before, process, said)
        os.killpg(process.pid, signal.SIGINT)
        require_stopped(process.wait(), signal.SIGINT, said)
    assert saved(folder) > stopped

    # All of them are killed, while they share a queue.
    before, words = reported(folder), ["collect.mode=async", "report.save_every_s=0.01"]
    with going_on(said, f"resume={folder}", *words) as process:
        wait_for(lambda: reported(folder) > before + 1, process, said)
        assert semaphores(process)
        os.killpg(process.pid, signal.SIGKILL)
        assert process.wait() == -signal.SIGKILL
    deadline = time.monotonic() + 60
    while semaphores(process):
        assert time.monotonic() < deadline
        time.sleep(0.05)
    stopped = saved(folder)

    end = f"collect.decisions={stopped + 64}"
    done = run_forked("explore", f"resume={folder}", end, "locomotion.updates=3")
    assert done.returncode == 0, done.stderr
    assert saved(folder) == stopped + 64
    decisions = [int(row["decisions"]) for row in rows(folder / "metrics.csv")]
    assert decisions == list(range(64, stopped + 65, 64))
    assert not list(folder.rglob(".*"))


@pytest.mark.slow
def test_one_that_is_stopped_while_it_pre_trains_promises_nothing(
    tmp_path: Path,
) -> None:
    said, layout = tmp_path / "said", tmp_path / "it's.txt"
    layout.write_text(RING)
    words = [*SHORT, "maze=file", f'maze.path="{layout}"']
    words += [f"pretraining.folder={tmp_path}/pre", f"hydra.run.dir={tmp_path}/run"]
    with going_on(said, *words) as process:
        # From its first picture on, a pre-training saves before it ends.
        wait_for(lambda: any(tmp_path.glob("pre/*/walk.png")), process, said)
        os.killpg(process.pid, signal.SIGINT)
        assert process.wait() == 128 + signal.SIGINT
    ends = ("stopped", "explore: ", "pretrain: ")
    lines = [line for line in said.read_text().splitlines() if line.startswith(ends)]
    assert lines == ["explore: stopped by Ctrl-C"]
    # The same command goes on with that pre-training.
    assert any(tmp_path.glob("pre/*/checkpoint.pt"))
    assert not (tmp_path / "run").exists()
