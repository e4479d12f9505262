"""The pretrain recipe, run as its users run it."""

import csv
import json
import os
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from unittest.mock import patch

import psutil
import pytest
import torch

from recipes import pretrain as recipe
from tests.forked import run_forked
from toponav.builders import load_networks
from toponav.reports import EXPLORE, PRETRAIN, Schedule

RECIPE = Path(__file__).parent.parent / "recipes" / "pretrain.py"
#: Runs it with a line of the schedule at every occasion, not every minute.
EAGER = """
import runpy, sys
from toponav.reports import schedule
schedule._AGAIN_S = 0
del sys.argv[0]
runpy.run_path(sys.argv[0], run_name="__main__")
"""
SMOKE = ("scale=smoke", "model.embedding_dim=32", "train.threads=1")


def command(*overrides: str) -> list[str]:
    return [sys.executable, str(RECIPE), *overrides]


def pretrain(*overrides: str) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        command(*overrides), capture_output=True, text=True, timeout=250, check=False
    )


def rows(folder: Path) -> list[dict[str, str]]:
    """Measurements of a run, without the times, which no two runs share."""
    with (folder / "metrics.csv").open() as file:
        found = list(csv.DictReader(file))
    return [
        {name: value for name, value in row.items() if name != "seconds"}
        for row in found
    ]


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a whole run in one maze."""
    folder = tmp_path_factory.mktemp("run") / "select"
    words = [*SMOKE, f"hydra.run.dir={folder}"]
    done = subprocess.run(
        [sys.executable, "-c", EAGER, str(RECIPE), *words],
        capture_output=True,
        text=True,
        timeout=250,
        check=False,
        # As an exploration starts it.
        env=os.environ | Schedule({PRETRAIN: 9.0, EXPLORE: 60.0}).environment(),
    )
    assert done.returncode == 0, done.stderr
    assert done.stdout.startswith("select: TC ")
    begins = "phase 1 of 2: pre-train, then explore; all done in about "
    # Once an update: the exploration has said it before.
    assert done.stderr.count(begins) == 20
    assert "1,024 decisions, 20 updates" in done.stdout
    return folder


@pytest.mark.slow
def test_it_leaves_networks_measurements_and_pictures(run: Path) -> None:
    networks = load_networks(run)
    assert set(networks.thresholds) == {"tc_threshold", "tc_reach", "reward_threshold"}
    assert all(0 < threshold < 1 for threshold in networks.thresholds.values())
    views = torch.zeros(2, 120, 160, 3, dtype=torch.uint8)
    assert networks.tc(views, views).isfinite().all()
    measured = rows(run)
    assert [row["update"] for row in measured] == ["10", "20"]
    assert measured[-1]["decisions"] == "1024"
    report = json.loads((run / "report.json").read_text())
    assert 0.4 < report["mazes"]["select"]["accuracy"] < 1
    assert report["thresholds"]["tc_threshold"]["target"] == 0.125
    assert (run / "report.png").stat().st_size > 10_000
    assert (run / "curves.png").stat().st_size > 10_000
    assert (run / "walk.png").stat().st_size > 10_000
    assert list((run / "logs/tensorboard").iterdir())
    assert (run / "logs/csv/scalars/pretrain/loss_tc.csv").exists()


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
def test_a_run_that_was_ended_goes_on_to_the_same_end(
    run: Path, tmp_path: Path, number: int
) -> None:
    folder = tmp_path / "maze=select,seed=0"  # as a sweep names folders
    said = tmp_path / "said"
    # Who is asked to stop saves first; who is killed has saved before.
    every = 0.01 if number == signal.SIGKILL else 60
    with said.open("wb") as file:
        process = subprocess.Popen(
            command(*SMOKE, f"train.save_every_s={every}", f"hydra.run.dir='{folder}'"),
            stdout=subprocess.DEVNULL,
            stderr=file,
        )
    try:
        deadline = time.monotonic() + 200
        # The loop looks at a signal; before it begins, one ends the run at once.
        while not (
            (folder / "checkpoint.pt").exists()
            if number == signal.SIGKILL
            else b"collect, " in said.read_bytes()
        ):
            assert process.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.05)
    finally:
        process.send_signal(number)
        status = process.wait()
    # The first picture does not wait for an update.
    assert (folder / "walk.png").exists()
    first = "select, 0 of 20 updates: a random walk of "
    assert first in said.read_text()
    assert f" of its map are false ({folder / 'walk.png'})" in said.read_text()
    assert not (folder / "networks.pt").exists()
    assert (folder / "checkpoint.pt").exists()
    if number == signal.SIGTERM:
        assert status == 128 + number
        assert (
            said.read_text().strip().endswith("stopped; resume=<run folder> continues")
        )
        assert "Traceback" not in said.read_text()
    done = pretrain(f"resume={folder}")
    assert done.returncode == 0, done.stderr
    assert rows(folder) == rows(run)


@pytest.mark.slow
def test_one_that_goes_on_and_is_cut_off_has_no_report(
    run: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "run"
    shutil.copytree(run, folder)
    cut_off = patch.object(recipe, "write_reports", side_effect=KeyboardInterrupt)
    words = (f"resume={folder}", "train.updates=22")
    done = run_forked("pretrain", *words, inside=cut_off)
    assert done.returncode == 128 + signal.SIGINT, done.stderr
    assert rows(folder)[-1]["update"] == "22"
    # The report that it had is of fewer updates.
    assert not (folder / "report.json").exists()


@pytest.mark.slow
def test_a_worker_that_dies_ends_the_run_with_a_checkpoint(
    run: Path, tmp_path: Path
) -> None:
    folder, said = tmp_path / "run", tmp_path / "said"
    words = (*SMOKE, "train.save_every_s=1000", f"hydra.run.dir={folder}")
    with said.open("wb") as file:
        process = subprocess.Popen(
            command(*words), stdout=subprocess.DEVNULL, stderr=file
        )
    try:
        deadline = time.monotonic() + 200
        # It has collected something, and has more to collect.
        while b"collect, 256 decisions" not in said.read_bytes():
            assert process.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.02)
        for child in psutil.Process(process.pid).children():
            if any("spawn_main" in word for word in child.cmdline()):
                child.kill()
        assert process.wait(100) == 1
    finally:
        process.kill()
        process.wait()
    entries = said.read_text()
    assert "Traceback" not in entries
    assert (
        entries.strip()
        .splitlines()[-1]
        .startswith(
            "pretrain: the collecting processes must live as long as the run, got: "
        )
    )
    done = pretrain(f"resume={folder}")
    assert done.returncode == 0, done.stderr
    assert rows(folder) == rows(run)


@pytest.mark.slow
def test_networks_of_a_run_are_measured_in_other_mazes(
    run: Path, tmp_path: Path
) -> None:
    folder = tmp_path / "both"
    done = run_forked(
        "pretrain",
        *SMOKE,
        "mazes=[maze1,maze2]",
        f"init_from={run}",
        "train.updates=0",
        "validate.decisions=60",
        f"hydra.run.dir={folder}",
    )
    assert done.returncode == 0, done.stderr
    assert "\nmaze2: TC " in done.stdout
    assert (folder / "report_maze2.png").exists()
    assert "tc_accuracy_maze1" in rows(folder)[0]
    before, after = load_networks(run), load_networks(folder)
    weight = before.tc.comparator.project.weight
    assert torch.equal(after.tc.comparator.project.weight, weight)


@pytest.mark.slow
def test_a_loss_that_explodes_stops_the_run(tmp_path: Path) -> None:
    words = (*SMOKE, "train.lr=1e30", f"hydra.run.dir={tmp_path}/run")
    done = run_forked("pretrain", *words)
    assert done.returncode == 1
    message = done.stderr.strip().splitlines()[-1]
    assert message.startswith("pretrain: ")
    assert "must be finite, got" in message
    assert "Traceback" not in done.stderr
    assert not (tmp_path / "run/networks.pt").exists()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("overrides", "sentence"),
    [
        (
            ["model.encoder=vit"],
            "model.encoder must be one of small, resnet18, got vit",
        ),
        (
            ["pairs.k=40", "pairs.chunk_len=41"],
            "maze.episode_length must be more than M * k = 200 decisions",
        ),
        (["resume=nowhere"], "resume must name the folder of a run, got 'nowhere'"),
        (["init_from=nowhere"], "init_from must name a run with nowhere"),
        (["mazes=[maze1,maze9]"], "maze must be one of maze1, maze2, maze3, select"),
        (["device=abacus"], "device must be auto, cpu or a GPU that this machine has"),
        (["scale=tiny"], "scale must be one of laptop, paper, smoke, got 'tiny'"),
    ],
)
def test_what_is_wrong_is_said_in_one_sentence(
    tmp_path: Path, overrides: list[str], sentence: str
) -> None:
    words = ["maze.episode_length=150", *overrides, f"hydra.run.dir={tmp_path}/run"]
    done = run_forked("pretrain", *SMOKE, *words)
    assert done.returncode == 2
    assert f"pretrain: {sentence}" in done.stderr
    assert "Traceback" not in done.stderr


@pytest.mark.slow
def test_a_run_without_a_checkpoint_cannot_go_on(tmp_path: Path) -> None:
    (tmp_path / "config").mkdir()
    overrides = "\n".join(f"- {word}" for word in SMOKE)
    (tmp_path / "config/overrides.yaml").write_text(overrides)
    done = run_forked("pretrain", f"resume={tmp_path}")
    assert done.returncode == 2
    assert f"resume must name a run with checkpoint.pt, got {tmp_path}" in done.stderr
    (tmp_path / "checkpoint.pt").write_bytes(b"PK\x03\x04 cut off")
    done = pretrain(f"resume={tmp_path}")
    assert done.returncode == 2
    assert "resume must name a complete file" in done.stderr
