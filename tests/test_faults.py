"""What benchmarks/faults.py looks for in the folder of a killed run is found.

And what it does not do: a disk that fills up, or cannot be written any more, while a
run goes on.
"""

import ctypes
import os
import re
import sys
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from types import ModuleType

import pytest
import torch

from tests.benchmarks.loading import load_benchmark
from tests.exploring import save_untrained
from tests.forked import run_forked
from tests.mounts import disk, needs_mounts


def test_a_damaged_file_of_each_kind_is_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    files = load_benchmark("fault_files", monkeypatch)
    torch.save({"a": torch.zeros(300)}, tmp_path / "a.pt")
    (tmp_path / "b.csv").write_text("a,b\n1,2\n")
    (tmp_path / "c.json").write_text("{}")
    (tmp_path / ".c.17.json").write_text("{")
    assert files.broken_files(tmp_path) == []
    assert files.temporary_files(tmp_path) == [".c.17.json"]
    for name in ("a.pt", "b.csv", "c.json"):
        content = (tmp_path / name).read_bytes()
        (tmp_path / name).write_bytes(content[:-1])
    (tmp_path / "d.xyz").touch()
    found = [name.partition(":")[0] for name in files.broken_files(tmp_path)]
    assert found == ["a.pt", "b.csv", "c.json", "d.xyz"]


def test_kills_hit_an_exploration_that_pre_trains_itself(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    runs = load_benchmark("fault_runs", monkeypatch)
    place = load_benchmark("fault_place", monkeypatch).Place(tmp_path)
    networks = tmp_path / "networks.pt"
    commands = [runs.command(name, networks, place.run) for name in runs.RUNS]
    alone = [
        words
        for words in commands
        if words[0] == "explore" and f"pretrained={networks}" not in words
    ]
    # What it trains is looked at as well.
    kept = f"pretraining.folder={tmp_path}/run-pretraining"
    assert [kept in words for words in alone] == [True]
    (tmp_path / "run-pretraining" / "maze3-smoke-0").mkdir(parents=True)
    assert place.runs == [place.run, tmp_path / "run-pretraining" / "maze3-smoke-0"]


@pytest.fixture
def short_path() -> Iterator[Path]:
    """A folder for temporary files of collecting processes.

    Sockets are among them, whose paths have at most 107 bytes.
    """
    with tempfile.TemporaryDirectory() as folder:
        yield Path(folder)


@pytest.mark.slow
# Of two busy cores; two quiet ones take a minute and a half.
@pytest.mark.timeout(900)
def test_explorations_and_tours_start_at_once(
    short_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Six explorations, of which one pre-trains for all, and six tours: all whole.

    The long form has 24 tours.
    """
    few = ("collect.decisions=128", "maze.episode_length=32", "evaluate.episodes=1")
    small = ("scale=smoke", "model.embedding_dim=8", "policy.hidden=16")
    together = load_benchmark("fault_together", monkeypatch)
    found = together.start_together(
        short_path, [("explore", *small, *few)] * 6 + [("tour", "scale=smoke")] * 6
    )
    assert found["ended_well"] == 12, found["said"]
    assert found["folders"] == {"explore": 6, "tour": 6}
    none = ("hangs", "tracebacks", "broken", "stray", "left")
    assert [found[name] for name in none] == [0, 0, [], [], []]
    assert len(list((short_path / "run/runs/pretrain").glob("*/networks.pt"))) == 1
    said = [(short_path / f"{number}.out").read_text() for number in range(6)]
    assert sum(one.count("decisions, 20 updates in ") for one in said) == 1


#: Runs that would go on for long, and a file that each of them writes again and again.
LONG_RUNS = {
    "explore": (
        *("model.embedding_dim=8", "policy.hidden=16", "pretrained=networks.pt"),
        *("maze.episode_length=32", "collect.decisions=100000", "report.every=64"),
        # A map is written in a thread, which could be amid its own files just then.
        *("report.save_every_s=0.2", "map.grow=false", "evaluate.random_folder=kept"),
    ),
    "pretrain": (
        *("model.embedding_dim=8", "train.updates=2000", "train.save_every_s=0.2"),
        *("validate.decisions=60", "validate.every=2"),
    ),
}
WRITTEN = {"explore": "checkpoint.pt", "pretrain": "metrics.csv"}


@contextmanager
def failing(place: Path, name: str, files: ModuleType, *, full: bool) -> Iterator[None]:
    """In a run's process: no byte is left, or no right to write, when it is in mid-run.

    That is when it has a table and opens the file of this name. What is wrong with its
    files in the end is noted beside ``place``.
    """
    run, filler = place / "run", place / "filler"
    stem, suffix = name.split(".")
    writes = re.compile(rf"{run}/\.{stem}\.\d+\.{suffix}")
    failed = False

    def fail(event: str, arguments: tuple[object, ...]) -> None:
        nonlocal failed
        if event != "open" or failed or not writes.fullmatch(str(arguments[0])):
            return
        if (run / "metrics.csv").exists():
            failed = True
            fill(filler) if full else run.chmod(0o555)

    with ExitStack() as stack:
        if full:
            stack.enter_context(disk(place, "24m"))
        else:
            obey_permissions()
        sys.addaudithook(fail)
        try:
            yield
        finally:
            run.chmod(0o755)
            # Else the list would be of a full disk.
            filler.unlink(missing_ok=True)
            wrong = [*files.broken_files(run), *files.temporary_files(run)]
            noted = f"{failed} {(run / 'checkpoint.pt').exists()} {wrong}"
            place.with_name("noted").write_text(noted)


def fill(path: Path) -> None:
    """Write until the disk is full to the last byte."""
    with path.open("wb", buffering=0) as file:
        try:
            while True:
                file.write(bytes(4096))
        except OSError:
            return


def obey_permissions() -> None:
    """Take from this process what lets root write into any folder."""
    if os.geteuid() != 0:
        return
    libc = ctypes.CDLL(None)
    # Of linux/capability.h: its third version, this process; six numbers, of which the
    # first two hold what is in force and what may be.
    header, numbers = (ctypes.c_uint32 * 2)(0x20080522, 0), (ctypes.c_uint32 * 6)()
    assert libc.capget(header, numbers) == 0
    for number in range(2):
        numbers[number] &= ~0b110  # CAP_DAC_OVERRIDE and CAP_DAC_READ_SEARCH
    assert libc.capset(header, numbers) == 0


@pytest.mark.slow
@pytest.mark.parametrize("recipe", LONG_RUNS)
@pytest.mark.parametrize(
    ("full", "reason"),
    [
        pytest.param(True, "No space left on device", marks=needs_mounts),
        (False, "Permission denied"),
    ],
)
def test_a_disk_that_fails_in_mid_run_is_said_and_leaves_whole_files(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    recipe: str,
    full: bool,
    reason: str,
) -> None:
    place, name = tmp_path / "disk", WRITTEN[recipe]
    place.mkdir()
    save_untrained(tmp_path / "networks.pt")
    files = load_benchmark("fault_files", monkeypatch)
    words = ("scale=smoke", *LONG_RUNS[recipe], f"hydra.run.dir={place}/run")
    inside = failing(place, name, files, full=full)
    done = run_forked(recipe, *words, cwd=tmp_path, inside=inside)
    assert done.returncode == 1
    assert "Traceback" not in done.stderr
    stem, suffix = name.split(".")
    assert re.fullmatch(
        rf"{recipe}: the files of a run must be readable and writable, got "
        rf"\[Errno \d+\] {reason}: '{place}/run/\.?{stem}(\.\d+)?\.{suffix}'",
        done.stderr.splitlines()[-1],
    )
    # It was in mid-run, with a checkpoint, and no file is broken or half.
    assert (tmp_path / "noted").read_text() == "True True []"
