"""Runs are made once, go on after a kill, and a failing one ends nothing."""

import math
import multiprocessing
import os
import shutil
import signal
import subprocess
import time
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path

import psutil
import pytest
from omegaconf import OmegaConf

from tests.forked import own_progress
from tests.sweeps import write_table
from toponav.experiments import Cell, RunMaker, kept_runs, making
from toponav.experiments.making import last_sentence

FAKE = Path(__file__).with_name("fake_recipe.py")
CONFIG = OmegaConf.create({"collect": {"decisions": 100, "minutes": None}})


def recipes(tmp_path: Path) -> Path:
    folder = tmp_path / "recipes"
    folder.mkdir(exist_ok=True)
    shutil.copy(FAKE, folder / "explore.py")
    return folder


def make_cell(tmp_path: Path, key: str, *words: str, first: Cell | None = None) -> Cell:
    folder = tmp_path / "runs" / key
    return Cell(key, "maze1", 0, "explore", words, CONFIG, key, folder, first)


def make(tmp_path: Path, *cells: Cell, jobs: int = 1) -> RunMaker:
    maker = RunMaker(recipes(tmp_path), jobs=jobs, poll_s=0.02)
    maker.make(cells, {})
    return maker


def make_apart(tmp_path: Path, cell: Cell) -> None:
    own_progress()
    make(tmp_path, cell)


def starts(cell: Cell) -> list[str]:
    return (cell.folder / "starts").read_text().split()


def wait_for(holds: Callable[[], bool]) -> None:
    end = time.monotonic() + 60
    while not holds():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_each_run_is_made_once_and_the_first_one_first(tmp_path: Path) -> None:
    one = make_cell(tmp_path, "one")
    # The same settings in another row are the same run.
    two = make_cell(tmp_path, "two", first=one)
    maker = make(tmp_path, two, one, one, jobs=2)
    assert maker.failures == {}
    assert starts(one) == starts(two) == ["start"]
    made = [(cell.folder / "evaluation.csv").stat().st_mtime_ns for cell in (one, two)]
    assert made[0] < made[1]
    # What is finished is not made again.
    make(tmp_path, one, two)
    assert starts(one) == starts(two) == ["start"]


def test_a_run_is_kept_as_soon_as_it_is_finished(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # What networks learned from is in the settings of a whole recipe.
    monkeypatch.setattr(kept_runs, "keep_decisions_before", lambda *_: None)
    bad = make_cell(tmp_path, "bad", "bad=1")
    cells = [make_cell(tmp_path, "good"), bad]
    cells = [replace(cell, kept=tmp_path / "kept" / cell.key) for cell in cells]
    make(tmp_path, *cells)
    assert [path.name for path in (tmp_path / "kept").iterdir()] == ["good"]
    assert cells[0].results == cells[0].kept


def test_a_failing_run_ends_nothing_but_what_needs_it(tmp_path: Path) -> None:
    bad = make_cell(tmp_path, "bad", "bad=1")
    after = make_cell(tmp_path, "after", first=bad)
    good = make_cell(tmp_path, "good")
    maker = make(tmp_path, bad, after, good)
    sentence = "explore: the engine must start, got nothing"
    assert maker.failures == {
        "bad": sentence,
        "after": f"the run that it starts from failed: {sentence}",
    }
    assert starts(good) == ["start"]
    assert not after.folder.exists()


def killed_maker(tmp_path: Path, cell: Cell) -> psutil.Process:
    """Kill a maker while its run is half done; the run's own process."""
    context = multiprocessing.get_context("fork")
    maker = context.Process(target=make_apart, args=(tmp_path, cell))
    maker.start()
    wait_for((cell.folder / "checkpoint.pt").exists)
    (run,) = psutil.Process(maker.pid).children()
    os.kill(maker.pid, signal.SIGKILL)
    maker.join()
    return run


def test_after_a_kill_of_both_the_run_goes_on(tmp_path: Path) -> None:
    cell = make_cell(tmp_path, "one", f"wait={tmp_path / 'go'}")
    run = killed_maker(tmp_path, cell)
    run.kill()
    wait_for(lambda: not run.is_running() or run.status() == psutil.STATUS_ZOMBIE)
    (tmp_path / "go").touch()
    assert make(tmp_path, cell).failures == {}
    assert starts(cell) == ["start", "resume"]


def test_a_run_that_outlived_its_maker_is_waited_for(tmp_path: Path) -> None:
    cell = make_cell(tmp_path, "one", f"wait={tmp_path / 'go'}")
    killed_maker(tmp_path, cell)
    context = multiprocessing.get_context("fork")
    second = context.Process(target=make_apart, args=(tmp_path, cell))
    second.start()
    time.sleep(0.2)
    assert second.is_alive()
    (tmp_path / "go").touch()
    second.join(60)
    assert second.exitcode == 0
    assert starts(cell) == ["start"]


def test_runs_are_asked_to_stop_with_their_maker(tmp_path: Path) -> None:
    cell = make_cell(tmp_path, "one", f"wait={tmp_path / 'go'}")
    maker = RunMaker(recipes(tmp_path), jobs=1, poll_s=0.02)
    found: list[subprocess.Popen[bytes]] = []

    def stop(_: object) -> str:
        if (cell.folder / "checkpoint.pt").exists():
            found.append(maker._running[0].process)
            raise KeyboardInterrupt
        return ""

    maker._progress = stop  # type: ignore[method-assign, assignment]
    with pytest.raises(KeyboardInterrupt):
        maker.make([cell], {})
    # It was asked, and had the time to save its state.
    assert found[0].returncode == -signal.SIGTERM


class Clock:
    """Stands in for the module ``time``."""

    now = 100.0

    def monotonic(self) -> float:
        return self.now


def test_a_pre_training_is_not_in_the_rate_of_a_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock, cell = Clock(), make_cell(tmp_path, "one")
    monkeypatch.setattr(making, "time", clock)
    maker = RunMaker(recipes(tmp_path), jobs=1, poll_s=0.02)
    maker.expected = {"one": 120.0}
    none: subprocess.Popen[bytes] = subprocess.Popen(["true"])
    none.wait()
    held = ExitStack()
    job = making._Job(cell, none, tmp_path / "log", held, started=clock.now)
    maker._running = [job]
    cell.folder.mkdir(parents=True)

    def progress(decisions: int) -> str:
        table = [{"decisions": decisions, "seconds": 1.0}]
        write_table(cell.folder / "metrics.csv", table)
        return maker._progress([])

    clock.now += 1000  # of pre-training, and a moment of exploring
    # 90 % of 120 s are left.
    said = "one, maze1, seed 0 10%, 0 decisions/s; time left: about 1.8 minutes"
    assert progress(10) == said
    clock.now += 10
    # 10 of 100 decisions in 10 s: 80 s are left.
    said = "one, maze1, seed 0 20%, 1 decisions/s; time left: about 1.3 minutes"
    assert progress(20) == said


def test_what_nobody_knows_is_said_of_runs_that_go_on(tmp_path: Path) -> None:
    config = OmegaConf.create({"train": {"updates": 100}})
    cell = replace(make_cell(tmp_path, "one"), recipe="pretrain", config=config)
    maker = RunMaker(recipes(tmp_path), jobs=1, poll_s=0.02)
    none: subprocess.Popen[bytes] = subprocess.Popen(["true"])
    none.wait()
    maker._running = [making._Job(cell, none, tmp_path / "log", ExitStack())]
    maker.expected = {"one": math.nan}
    assert maker._progress([]) == "one, maze1, seed 0; time left: unknown"
    maker.expected = {"one": 0.0}
    assert maker._progress([]).endswith("time left: about 0.0 minutes")


def test_what_runs_took_is_compared_with_what_is_expected_of_them(
    tmp_path: Path,
) -> None:
    cells = [make_cell(tmp_path, key) for key in ("one", "unknown", "two")]
    maker = RunMaker(recipes(tmp_path), jobs=1, poll_s=0.02)
    # Each says that it took 1.5 s.
    maker.make(cells[:2], {"one": 0.75, "unknown": math.nan, "two": 600.0})
    assert maker._progress(cells[2:]) == "time left: about 20.0 minutes"


def test_the_last_sentence_is_no_progress_bar(tmp_path: Path) -> None:
    log = tmp_path / "log"
    assert last_sentence(log) == ""
    log.write_text("one\n 0%| 1/2\rexplore: it must be so, got no\r99%| 2/2\n\n")
    assert last_sentence(log) == "explore: it must be so, got no"
