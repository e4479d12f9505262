"""The tour recipe, run as its users run it."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import imageio.v3 as iio
import pytest
from PIL import Image

from tests.forked import run_forked

RECIPE = Path(__file__).parent.parent / "recipes" / "tour.py"
SMALL = ("scale=smoke",)


def tour(folder: Path, *overrides: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, str(RECIPE), *overrides],
        cwd=folder,
        capture_output=True,
        text=True,
        timeout=200,
        check=False,
    )


@pytest.mark.slow
def test_it_leaves_plan_views_and_video(tmp_path: Path) -> None:
    layout = tmp_path / "ring.txt"
    layout.write_text("*****\n*   *\n* *a*\n*   *\n*****\n")
    done = tour(
        tmp_path, *SMALL, "maze=file", f"maze.path={layout}", "maze.blocked=[a]"
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("ring: 12 decisions, ")
    (run,) = (tmp_path / "runs/tour").iterdir()
    for name in ("plan.png", "views.png"):
        assert min(Image.open(run / name).size) > 300
    assert iio.imread(run / "walk.mp4").shape[:2] == (12, 96)
    assert (run / "config" / "config.yaml").exists()


@pytest.mark.slow
def test_a_sweep_makes_readable_folders(tmp_path: Path) -> None:
    words = ["-m", "maze=maze1", "maze.blocked=[],[a,b]", *SMALL, "video=gif"]
    done = run_forked("tour", *words, cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    (sweep,) = (tmp_path / "multirun/tour").iterdir()
    (first,) = sweep.glob("*maze.blocked=a,b*")
    assert (first / "walk.gif").exists()
    assert len(list(sweep.rglob("walk.gif"))) == 2


@pytest.mark.slow
@pytest.mark.parametrize(
    ("overrides", "sentence"),
    [
        (
            ["maze=maze9"],
            "tour: maze must be one of file, maze1, maze2, maze3, random, select, got "
            "'maze9' (did you mean 'maze3'?)",
        ),
        (
            ["height=1000000"],
            "tour: height must lie in [64, 4320], got 1000000 (did you mean 4320?)",
        ),
        (
            ["maze.appels=3"],
            "tour: 'maze.appels' must be a setting of tour, got none of that name (did "
            "you mean 'maze.apples'?)",
        ),
        (["maze.apples=-1"], "tour: maze.apples must be at least 0, got -1"),
        (
            ["maze.blocked=b"],
            "tour: maze.blocked must be a list such as [a,b], got something else",
        ),
        (
            ["maze=file", "maze.path=nowhere.txt"],
            "tour: maze.path: layout 'nowhere.txt': the file must exist, and no such "
            "file was found",
        ),
        (
            ["maze=maze1", "maze.apples=60"],
            "tour: maze: apples must be at least 0 and at most 47 in maze1 (one cell "
            "each, beside start and goal), got 60",
        ),
    ],
)
def test_a_bad_setting_is_one_sentence(
    tmp_path: Path, overrides: list[str], sentence: str
) -> None:
    done = run_forked("tour", *overrides, cwd=tmp_path)
    assert done.stderr.strip() == sentence
    assert done.returncode == 2


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [
        ("hydra.output_subdir=null",),
        ("maze=file", "maze.path=/nowhere"),
        ("decisions=1", "views=2"),
    ],
)
def test_a_refused_tour_leaves_no_folder(words: list[str], tmp_path: Path) -> None:
    done = tour(tmp_path, *words)
    assert done.returncode == 2
    assert len(done.stderr.strip().splitlines()) == 1
    assert [*tmp_path.iterdir()] == []


@pytest.mark.slow
@pytest.mark.parametrize(
    ("sent", "said"),
    [(signal.SIGTERM, ""), (signal.SIGINT, "tour: stopped by Ctrl-C")],
)
def test_a_signal_in_mid_run_leaves_no_engine(
    sent: signal.Signals, said: str, tmp_path: Path
) -> None:
    run = subprocess.Popen(
        [sys.executable, str(RECIPE), "decisions=100000"],
        cwd=tmp_path,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert run.stderr is not None
    while "decision/s" not in (text := run.stderr.read(64)):
        assert text, "the recipe ended before its walk began"
    time.sleep(1.0)
    run.send_signal(sent)
    rest = run.stderr.read()
    assert run.wait(30) == 128 + sent
    assert "Traceback" not in rest
    assert said in rest.splitlines()[-1:] or not said
    run.stderr.close()
    mine = f"PPid:\t{run.pid}\n"
    for status in Path("/proc").glob("[0-9]*/status"):
        try:
            assert mine not in status.read_text()
        except (FileNotFoundError, ProcessLookupError):
            continue
    assert not os.path.exists(f"/proc/{run.pid}")
