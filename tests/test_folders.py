"""Folders in which no run can be: one sentence each, and nothing is left behind."""

import shutil
from pathlib import Path

import pytest

from tests.config.test_read_yaml import BOMB
from tests.explored import make_run
from tests.forked import run_forked
from tests.sweeps import make_exploration

#: A name that no file system takes.
LONG = "y" * 300
SENTENCE = "hydra.run.dir must name a folder that can be made and written to, got"


def files(folder: Path) -> list[str]:
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*"))


@pytest.mark.parametrize(
    ("where", "reason"),
    [
        ("file/run", "'file/run' (Not a directory)"),
        ("file", "'file' (File exists)"),
        ("/dev/null/run", "'/dev/null/run' (Not a directory)"),
        ("/proc/run", "'/proc/run' (No such file or directory)"),
        (f"new/deep/{LONG}", f"'new/deep/{LONG}' (File name too long)"),
        ("'a\0b'", "embedded null byte"),
    ],
)
def test_an_impossible_run_folder_is_one_sentence(
    tmp_path: Path, where: str, reason: str
) -> None:
    (tmp_path / "file").touch()
    done = run_forked("tour", f"hydra.run.dir={where}", "scale=smoke", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (2, f"tour: {SENTENCE} {reason}\n")
    assert files(tmp_path) == ["file"]


def test_that_of_a_sweep_goes_by_its_own_name(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    words = ("scale=smoke", "hydra.sweep.dir=file/sweep", "seed=0,1", "-m")
    done = run_forked("tour", *words, cwd=tmp_path)
    assert (done.returncode, done.stderr) == (
        2,
        "tour: hydra.sweep.dir must name a folder that can be made and written to, got "
        "'file/sweep' (Not a directory)\n",
    )
    assert files(tmp_path) == ["file"]


def test_a_refused_run_in_the_working_directory_leaves_it_as_it_was(
    tmp_path: Path,
) -> None:
    (tmp_path / "mine").touch()
    words = ("hydra.run.dir=''", "scale=smoke", "decisions=0")
    done = run_forked("tour", *words, cwd=tmp_path)
    assert done.stderr == "tour: decisions must be at least 1, got 0\n"
    assert files(tmp_path) == ["mine"]


TAKES = "must be settings that pretrain takes:"
WHOLE = f"pretraining.overrides {TAKES}"


@pytest.mark.parametrize(
    ("word", "sentence"),
    [
        ("overrides=['train.lr=-1']", f"{WHOLE} train.lr must be above 0, got -1.0"),
        ("overrides=['train.foo=1']", f"{WHOLE} 'train.foo' must be a setting of pret"),
        ("overrides=['+train.foo=1']", f"{WHOLE} 'train.foo' must be a setting of pre"),
        (
            "overrides=['maze.blocked=[z]']",
            f"{WHOLE} maze: blocked slots must be",
        ),
        ("overrides=['init_from=no']", f"{WHOLE} init_from must name a run with no, g"),
        (
            "overrides=['train.lr']",
            "pretraining.overrides must hold words such as",
        ),
        (
            "scale=no",
            "pretraining must be settings that pretrain takes: scale must be ",
        ),
        (
            "maze=file",
            "pretraining must be settings that pretrain takes: maze.path mus",
        ),
    ],
)
def test_a_pretraining_that_would_be_refused_is_one_sentence_and_leaves_nothing(
    tmp_path: Path, word: str, sentence: str
) -> None:
    done = run_forked("explore", "scale=smoke", f"pretraining.{word}", cwd=tmp_path)
    assert done.stderr.startswith(f"explore: {sentence}")
    assert (done.returncode, done.stderr.count("\n")) == (2, 1)
    assert files(tmp_path) == []


@pytest.mark.parametrize("seeds", ["0", "0,1"])
def test_a_sweep_whose_jobs_are_all_refused_says_so_once_each_and_leaves_nothing(
    tmp_path: Path, seeds: str
) -> None:
    words = ("scale=smoke", "decisions=0", f"seed={seeds}", "-m")
    done = run_forked("tour", *words, cwd=tmp_path)
    said = [
        "tour: decisions must be at least 1, got 0 "
        f"(tour=smoke decisions=0 seed={seed})"
        for seed in seeds.split(",")
    ]
    if len(said) > 1:
        said.append("tour: not all jobs of the sweep succeeded")
    assert (done.returncode, done.stderr.splitlines()) == (2, said)
    assert files(tmp_path) == []


@pytest.mark.parametrize(
    "where", [(), ("hydra.sweep.dir=sweep",), ("hydra.sweep.dir=.",)]
)
def test_a_sweep_with_a_job_that_cannot_be_composed_leaves_nothing(
    tmp_path: Path, where: tuple[str, ...]
) -> None:
    words = ("scale=smoke", "decisions=2,x", *where, "-m")
    done = run_forked("tour", *words, cwd=tmp_path)
    assert (done.returncode, done.stderr) == (
        2,
        "tour: decisions: Value 'x' of type 'str' could not be converted to Integer\n",
    )
    assert files(tmp_path) == []


def test_words_of_a_job_with_line_breaks_are_said_in_one_line(tmp_path: Path) -> None:
    done = run_forked("report", "folder='a\nb'", "-m", cwd=tmp_path)
    rule = "folder must name the folder of a sweep or a run, got 'a b'"
    assert (done.returncode, done.stderr) == (2, f"report: {rule} (folder='a b')\n")


def test_a_sweep_in_batches_of_no_job_is_one_sentence(tmp_path: Path) -> None:
    words = ("seed=0,1", "hydra.sweeper.max_batch_size=0", "-m")
    done = run_forked("tour", *words, cwd=tmp_path)
    assert (done.returncode, done.stderr) == (
        2,
        "tour: hydra.sweeper.max_batch_size must be null or at least 1, got 0\n",
    )
    assert files(tmp_path) == []


@pytest.mark.parametrize("name", ["hydra.sweeper.params=", "hydra.sweeper={params:"])
def test_a_sweep_by_hydras_own_settings_is_one_sentence(
    tmp_path: Path, name: str
) -> None:
    word = f"{name}{{seed:'0,1'}}{'}' * name.count('{')}"
    done = run_forked("tour", word, "-m", cwd=tmp_path)
    said = f"tour: a sweep must be given by settings such as seed=0,1, got '{word}'\n"
    assert (done.returncode, done.stderr) == (2, said)


def test_a_method_by_the_name_of_another_is_one_sentence(tmp_path: Path) -> None:
    words = ("reward=random", "reward.name=novelty", "scale=smoke")
    done = run_forked("explore", *words, cwd=tmp_path)
    assert (done.returncode, done.stderr) == (
        2,
        "explore: reward.name must stay as reward=<name> sets it, with its settings, "
        "got 'novelty' (did you mean reward=novelty?)\n",
    )
    assert files(tmp_path) == []


def test_flags_stand_before_all_settings_or_after_them(tmp_path: Path) -> None:
    done = run_forked("tour", "seed=1", "-m", "decisions=0", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (
        2,
        "tour: flags such as -m must come before all settings or after them, got one "
        "before decisions=0\n",
    )


@pytest.mark.slow
@pytest.mark.parametrize("garbled", ["seed: [1\n", "\0\1", "- a\n", "a: !!python/x y"])
def test_a_garbled_config_of_a_run_is_one_sentence(
    tmp_path: Path, garbled: str
) -> None:
    make_run(tmp_path / "run")
    (tmp_path / "run/config/overrides.yaml").write_text("[]\n")
    explored = make_exploration(tmp_path / "sweep", best=[0.9])
    for folder in (tmp_path / "run", explored):
        (folder / "config/config.yaml").write_text(garbled)
    before = files(tmp_path)
    for line, damaged in (
        ("explore resume=run", "run"),
        ("pretrain resume=run", "run"),
        ("navigate run=run", "run"),
        ("report sweep", str(explored.relative_to(tmp_path))),
    ):
        recipe, word = line.split()
        done = run_forked(recipe, word, "scale=smoke", cwd=tmp_path)
        assert done.returncode == 2
        (sentence,) = done.stderr.splitlines()
        assert sentence.startswith(
            f"{recipe}: a run folder must hold the settings of a run, got the damaged "
            f"{damaged}/config/config.yaml ("
        )
        assert files(tmp_path) == before


def test_a_map_of_another_maze_is_one_sentence(tmp_path: Path) -> None:
    """Such as after the layout's file was changed."""
    make_run(tmp_path / "run")
    layout = "*****\n*** *\n*** *\n*** *\n*****\n"
    (tmp_path / "run/ring.txt").write_text(layout)
    before = files(tmp_path)
    done = run_forked("navigate", "run=run", "scale=smoke", cwd=tmp_path)
    assert (done.returncode, done.stderr) == (
        2,
        "navigate: run must name an exploration whose map is one of its maze, got "
        "'run' with waypoints inside the walls of ring (was its layout changed?)\n",
    )
    assert files(tmp_path) == before
    shutil.rmtree(tmp_path / "run")


def test_settings_of_a_run_that_stand_for_millions_of_words_are_one_sentence(
    tmp_path: Path,
) -> None:
    file = tmp_path / "run/config/config.yaml"
    file.parent.mkdir(parents=True)
    file.write_text(BOMB)
    done = run_forked("navigate", "run=run", "scale=smoke", cwd=tmp_path, timeout=60)
    assert (done.returncode, done.stderr) == (
        2,
        "navigate: a run folder must hold the settings of a run, got the damaged "
        "run/config/config.yaml (it has an alias, '*a')\n",
    )
    assert files(tmp_path) == ["run", "run/config", "run/config/config.yaml"]


@pytest.mark.parametrize(
    ("word", "given"),
    [
        ("hydra.output_subdir=null", "null"),
        ("++hydra.output_subdir=.hydra", "'.hydra'"),
        ("hydra.output_subdir=", "''"),
        ("~hydra.output_subdir", "null"),
        ("hydra={output_subdir:null}", "null"),
        ("hydra.output_subdir=config,null", "several"),
    ],
)
def test_a_run_keeps_its_settings_where_others_look_for_them(
    tmp_path: Path, word: str, given: str
) -> None:
    """Its lock and its results are seen there, and `resume` reads them."""
    done = run_forked("tour", word, "decisions=1", cwd=tmp_path, timeout=60)
    assert (done.returncode, done.stderr) == (
        2,
        "tour: hydra.output_subdir must be 'config', where a run keeps its settings, "
        f"got {given}\n",
    )
    assert files(tmp_path) == []


def test_a_sweep_keeps_its_settings_there_too(tmp_path: Path) -> None:
    words = ("hydra.output_subdir=null", "decisions=1", "seed=0,1", "-m")
    done = run_forked("tour", *words, cwd=tmp_path, timeout=60)
    assert done.returncode == 2
    assert done.stderr.startswith("tour: hydra.output_subdir must be 'config', where")
    assert len(done.stderr.splitlines()) == 1
    assert files(tmp_path) == []
