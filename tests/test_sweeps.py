"""What the launcher sees to, for every recipe: folders, locks, sweeps that go on."""

import subprocess
from pathlib import Path
from unittest.mock import patch

import pytest
import yaml
from omegaconf import OmegaConf

from tests.forked import run_forked
from tests.sweeps import files_of, make_folder
from toponav.config import SettingsError
from toponav.launch import folders, jobs
from toponav.launch.folders import save_whole
from toponav.runs import alone_in, log_uniform, write_text


def tour(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    return run_forked("tour", *words, "scale=smoke", "maze=maze1", cwd=folder)


@pytest.mark.slow
def test_a_run_has_its_folder_to_itself(tmp_path: Path) -> None:
    (tmp_path / "run" / "config").mkdir(parents=True)
    with alone_in(tmp_path / "run" / "config"):
        done = tour(tmp_path, "hydra.run.dir=run")
        # The folder of the other run, which has written nothing yet, is left alone.
        assert (tmp_path / "run" / "config" / ".lock").exists()
    assert done.returncode == 2
    assert done.stderr.strip() == (
        "tour: a run must have its folder to itself, got one that another run is "
        f"writing to: '{tmp_path}/run'"
    )
    done = tour(tmp_path, "hydra.run.dir=run")
    assert done.returncode == 0, done.stderr
    assert not list(tmp_path.rglob("*.lock"))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("result", "hint"),
    [("checkpoint.pt", " (did you mean resume='{}'?)"), ("walk.gif", "")],
)
def test_results_of_another_run_are_left_alone(
    tmp_path: Path, result: str, hint: str
) -> None:
    # The other run's seed is its own, whoever made it.
    folder = tmp_path / "seed-0"
    kept = make_folder(folder, result)
    done = tour(tmp_path, "hydra.run.dir='seed-${seed}'")
    assert done.returncode == 2
    assert done.stderr == (
        "tour: hydra.run.dir must name a folder without results of another run, got "
        f"'{folder}'{hint.format(folder)}\n"
    )
    assert files_of(folder) == kept


@pytest.mark.slow
def test_a_run_is_resumed_by_one_process_at_a_time(tmp_path: Path) -> None:
    folder = tmp_path / "run"
    kept = make_folder(folder, "checkpoint.pt")
    with alone_in(folder / "config"):
        words = (f"resume={folder}", "scale=smoke", "collect.decisions=128")
        done = run_forked("explore", *words, cwd=tmp_path)
        assert files_of(folder) == kept | {"config/.lock": b""}
    assert done.returncode == 2
    assert done.stderr == (
        "explore: a run must have its folder to itself, got one that another run is "
        f"writing to: '{folder}'\n"
    )


@pytest.mark.slow
def test_a_refused_run_leaves_nothing(tmp_path: Path) -> None:
    done = tour(tmp_path, "video=avi")
    assert done.returncode == 2, done.stderr
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_sweep_goes_on_after_a_job_that_fails(tmp_path: Path) -> None:
    done = tour(tmp_path, "-m", "video=avi,gif", "hydra.sweep.dir=sweep")
    assert done.returncode == 2
    lines = done.stderr.strip().splitlines()
    (sentence,) = [line for line in lines if "must be" in line]
    assert sentence.startswith("tour: video must be")
    assert sentence.endswith("(video=avi tour=smoke maze=maze1)")
    assert lines[-1] == "tour: not all jobs of the sweep succeeded"
    assert "Traceback" not in done.stderr
    (job,) = [path for path in (tmp_path / "sweep").iterdir() if path.is_dir()]
    assert (job / "walk.gif").is_file()


def refusal_of_the_first(done: subprocess.CompletedProcess[str]) -> str:
    """What is said of the first of two jobs; the other goes on, to its own mistake."""
    assert done.returncode == 2
    first, second, last = done.stderr.splitlines()
    assert second.startswith("tour: video must be")
    assert last == "tour: not all jobs of the sweep succeeded"
    return first


@pytest.mark.parametrize(
    ("result", "hint"),
    [("checkpoint.pt", " (did you mean resume='{}'?)"), ("walk.gif", "")],
)
def test_a_sweep_that_is_started_again_leaves_its_runs_alone(
    tmp_path: Path, result: str, hint: str
) -> None:
    folder = tmp_path / "sweep" / "seed-0"
    kept = make_folder(folder, result, "config/hydra.yaml", "tour.log")
    words = (
        "-m",
        "seed=0,1",
        "hydra.sweep.dir=sweep",
        "hydra.sweep.subdir=seed-${seed}",
    )
    done = tour(tmp_path, *words, "video=avi")
    assert refusal_of_the_first(done) == (
        "tour: hydra.sweep.dir must name a folder without results of another run, got "
        f"'{folder}'{hint.format(folder)} (seed=0 video=avi tour=smoke maze=maze1)"
    )
    assert files_of(folder) == kept


def test_a_sweep_in_batches_goes_on_after_one_that_fails(tmp_path: Path) -> None:
    words = ("decisions=0", "seed=0,1", "hydra.sweeper.max_batch_size=1")
    done = tour(tmp_path, "-m", *words)
    assert done.returncode == 2
    first, second, last = done.stderr.splitlines()
    assert first.endswith("(decisions=0 seed=0 tour=smoke maze=maze1)")
    assert second.endswith("(decisions=0 seed=1 tour=smoke maze=maze1)")
    assert last == "tour: not all jobs of the sweep succeeded"
    assert not list(tmp_path.iterdir())


def test_a_sweep_leaves_the_settings_of_a_run_in_progress_alone(tmp_path: Path) -> None:
    folder = tmp_path / "sweep" / "0"
    kept = make_folder(folder, "config/hydra.yaml")
    words = ("-m", "seed=0,1", "hydra.sweep.dir=sweep", "hydra.sweep.subdir=${seed}")
    with alone_in(folder / "config"):
        done = tour(tmp_path, *words, "video=avi")
        assert files_of(folder) == kept | {"config/.lock": b""}
    assert refusal_of_the_first(done) == (
        "tour: a run must have its folder to itself, got one that another run is "
        f"writing to: '{folder}' (seed=0 video=avi tour=smoke maze=maze1)"
    )


@pytest.mark.slow
def test_draws_of_a_sweep_are_plain_numbers_in_its_runs(tmp_path: Path) -> None:
    words = ["-m", "seed=3,4", "maze.paintings=${log_uniform:0.1,0.9}"]
    done = tour(tmp_path, *words, "hydra.sweep.dir=sweep")
    assert done.returncode == 0, done.stderr
    drawn = []
    for number in (3, 4):
        (folder,) = (tmp_path / "sweep").glob(f"*seed={number}*")
        config = yaml.safe_load((folder / "config" / "config.yaml").read_text())
        drawn.append(config["maze"]["paintings"])
        root = OmegaConf.create({"seed": number})
        assert drawn[-1] == log_uniform(0.1, 0.9, _root_=root)
        words = yaml.safe_load((folder / "config" / "overrides.yaml").read_text())
        assert f"maze.paintings={drawn[-1]}" in words
    assert drawn[0] != drawn[1]
    done = tour(tmp_path, "maze.paintings=${log_uniform:2,1}", "hydra.run.dir=bad")
    assert (done.returncode, done.stderr) == (
        2,
        "tour: log_uniform must have two bounds, above 0 and the lower one first, got "
        "2,1\n",
    )
    assert not (tmp_path / "bad").exists()


@pytest.mark.slow
def test_half_a_file_of_a_run_that_was_killed_is_removed(tmp_path: Path) -> None:
    kept = ["run/notes.1", "run/.hidden", "run/more/.checkpoint.4242.pt"]
    halves = ["run/.checkpoint.4242.pt", "run/logs/csv/scalars/.loss.4242.csv"]
    for name in kept + halves:
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()
    done = tour(tmp_path, "hydra.run.dir=run")
    assert done.returncode == 0, done.stderr
    assert [name for name in kept + halves if (tmp_path / name).exists()] == kept


@pytest.mark.slow
def test_a_run_holds_its_folder_before_anything_is_written_there(
    tmp_path: Path,
) -> None:
    seen = tmp_path / "seen"

    def note(cfg: object, filename: str, output_dir: Path) -> None:
        try:
            with alone_in(output_dir):
                found = "free"
        except SettingsError:
            found = "held"
        with seen.open("a") as file:
            file.write(f"{filename}: {found}\n")
        save_whole(cfg, filename, output_dir)

    inside = patch.object(jobs, "save_whole", note)
    words = ("scale=smoke", "maze=maze1", "hydra.run.dir=run")
    done = run_forked("tour", *words, cwd=tmp_path, inside=inside)
    assert done.returncode == 0, done.stderr
    assert seen.read_text() == (
        "config.yaml: held\nhydra.yaml: held\noverrides.yaml: held\n"
    )
    assert not list(tmp_path.rglob("*.lock"))


@pytest.mark.slow
def test_all_that_hydra_writes_of_a_sweep_is_whole_or_absent(tmp_path: Path) -> None:
    written = tmp_path / "written"

    def note(path: Path, text: str) -> None:
        with written.open("a") as file:
            file.write(f"{path.name}\n")
        write_text(path, text)

    inside = patch.object(folders, "write_text", note)
    words = ("scale=smoke", "maze=maze1", "hydra.sweep.dir=sweep", "seed=0", "-m")
    done = run_forked("tour", *words, cwd=tmp_path, inside=inside)
    assert done.returncode == 0, done.stderr
    found = {path.name for path in (tmp_path / "sweep").rglob("*.yaml")}
    assert set(written.read_text().splitlines()) == found
    assert "multirun.yaml" in found
    content = OmegaConf.load(tmp_path / "sweep/multirun.yaml")
    assert OmegaConf.select(content, "hydra.sweep.dir") == "sweep"
