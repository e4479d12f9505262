import logging
import resource
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from hydra.core.hydra_config import HydraConfig
from omegaconf import OmegaConf

from tests.forked import run_forked
from toponav.config import SettingsError
from toponav.launch import folder_name, named_folder, resumed_arguments
from toponav.launch.folders import folder_setting, log_in_own_folder

RECIPES = Path(__file__).parent.parent / "recipes"


def run_folder(tmp_path: Path, *overrides: str) -> Path:
    folder = tmp_path / "maze=select,seed=0"
    (folder / "config").mkdir(parents=True)
    lines = "".join(f"- {word}\n" for word in overrides) or "[]\n"
    (folder / "config/overrides.yaml").write_text(lines)
    return folder


def test_a_resumed_run_gets_its_own_command_line_and_folder(tmp_path: Path) -> None:
    folder = run_folder(tmp_path, "maze=maze1", "seed=3", "resume=elsewhere")
    words = [f"resume={folder}", "train.updates=9"]
    assert resumed_arguments(words, "pretrain") == [
        "maze=maze1",
        "seed=3",
        "train.updates=9",
        f"resume='{folder}'",
        f"hydra.run.dir='{folder}'",
    ]


@pytest.mark.parametrize(
    "word",
    ["maze=maze2", "maze.rows=9", "++engine=dmlab", "mazes=[maze1]", "world=gym"],
)
def test_a_run_goes_on_in_its_world(tmp_path: Path, word: str) -> None:
    folder = run_folder(tmp_path, "maze=maze1")
    with pytest.raises(SettingsError) as error:
        resumed_arguments([f"resume={folder}", word], "pretrain")
    assert str(error.value) == (
        "resume must go on in the world of its run, without settings of another one, "
        f"got '{word}'"
    )
    # What was given then may be given again.
    again = resumed_arguments(["maze=maze1", f"resume={folder}"], "pretrain")
    assert again[:2] == ["maze=maze1"] * 2


@pytest.mark.parametrize("given", ["'{}'", '"{}"', "{}"])
def test_quotes_around_the_folder_do_not_matter(tmp_path: Path, given: str) -> None:
    folder = run_folder(tmp_path)
    found = resumed_arguments([f"resume={given.format(folder)}"], "pretrain")
    assert found[-1] == f"hydra.run.dir='{folder}'"


@pytest.mark.parametrize("given", ["'{}/it\\'s'", '"{}/it\'s"', "{}/it's"])
def test_a_folder_with_an_apostrophe_is_resumed(tmp_path: Path, given: str) -> None:
    (tmp_path / "it's").symlink_to(run_folder(tmp_path))
    found = resumed_arguments([f"resume={given.format(tmp_path)}"], "pretrain")
    assert found[-1] == f"hydra.run.dir='{tmp_path}/it\\'s'"


@pytest.mark.parametrize("arguments", [[], ["maze=maze1"], ["resume=null"]])
def test_other_command_lines_stay_as_they_are(arguments: list[str]) -> None:
    assert resumed_arguments(arguments, "explore") == arguments


def test_a_folder_that_is_no_run_is_refused(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="resume must name the folder of a run"):
        resumed_arguments([f"resume={tmp_path}"], "explore")


def test_a_run_of_an_earlier_version_is_one_sentence(tmp_path: Path) -> None:
    folder = run_folder(tmp_path, "reward.kind=coverage")
    file = folder / "config/config.yaml"
    file.write_text("reward: {name: rnd, lr: 1.0}\nmaze: {blocked: [a]}\n")
    words = [f"resume={folder}"]
    assert resumed_arguments(words, "explore")
    file.write_text("maze: {name: maze1}\nreward: {kind: coverage}\n")
    with pytest.raises(SettingsError) as error:
        resumed_arguments(words, "explore")
    assert str(error.value) == (
        f"resume must name a run of explore of this version, got '{folder}', which an "
        "earlier version (or another recipe) made with other settings, 'reward.kind'"
    )


@pytest.mark.parametrize(
    ("given", "named"),
    [
        (["multirun/explore"], ["folder='multirun/explore'"]),
        (["folder=runs/a=1,b=2"], ["folder='runs/a=1,b=2'"]),
        (["folder='runs/a=1'"], ["folder='runs/a=1'"]),
        (["it's/here"], ["folder='it\\'s/here'"]),
        (["--help"], ["--help"]),
        (["a", "--cfg", "job", "b=1"], ["folder='a'", "--cfg", "job", "b=1"]),
        (["-c", "job", "a"], ["-c", "job", "folder='a'"]),
        (["--multirun", "a"], ["--multirun", "folder='a'"]),
        (["hydra/job_logging=default"], ["hydra/job_logging=default"]),
        ([], []),
    ],
)
def test_a_folder_may_stand_alone(given: list[str], named: list[str]) -> None:
    assert named_folder(given, "folder") == named


def test_a_folder_may_look_like_a_setting(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    run_folder(tmp_path)
    name = "maze=select,seed=0"
    assert named_folder([name], "folder") == [f"folder='{name}'"]


def test_a_command_line_that_was_cut_is_refused(tmp_path: Path) -> None:
    (tmp_path / "config").mkdir()
    for damaged in ("- a=1\n- - b\n-\n", "- a=1\n- =3\n", "- ''\n"):
        (tmp_path / "config" / "overrides.yaml").write_text(damaged)
        with pytest.raises(SettingsError, match="command line was kept whole"):
            resumed_arguments([f"resume={tmp_path}"], "explore")


@contextmanager
def files_up_to(size: int) -> Iterator[None]:
    """As on a disk that is full but for so many bytes a file."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, size))
    yield


def test_settings_that_cannot_be_written_leave_the_former_ones(tmp_path: Path) -> None:
    folder = tmp_path / "run" / "config"
    folder.mkdir(parents=True)
    # The second of the three that Hydra saves, and the only long one.
    former = folder / "hydra.yaml"
    former.write_text("hydra: {}\n")
    done = run_forked(
        "tour", "hydra.run.dir=run", cwd=tmp_path, inside=files_up_to(500)
    )
    assert (done.returncode, done.stderr) == (
        2,
        "tour: hydra.run.dir must name a folder that can be made and written to, got "
        f"'{former}' (File too large)\n",
    )
    assert former.read_text() == "hydra: {}\n"
    assert {one.name for one in folder.iterdir()} == {"config.yaml", "hydra.yaml"}


@pytest.mark.parametrize("given", ["3", "null", "true", "[1,2]", "{a: 1}"])
def test_what_is_no_name_of_a_group_is_one_sentence(tmp_path: Path, given: str) -> None:
    done = run_forked("tour", "scale=smoke", f"maze={given}", cwd=tmp_path)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("tour: maze must be one of file, maze1, maze2, ")
    assert f"got '{given}'" in done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert not list(tmp_path.iterdir())


def test_what_chooses_a_learner_by_the_scale_is_none(tmp_path: Path) -> None:
    done = run_forked("explore", "scale=smoke", "loss=foo", cwd=tmp_path)
    rule = "loss must be one of a3c, dqn, drqn, nav_a3c, nav_a3c_d2l, ppo, trpo, got"
    assert done.stderr.startswith(f"explore: {rule} 'foo'")


@pytest.mark.slow
def test_a_process_of_its_own_ends_with_one_sentence(tmp_path: Path) -> None:
    """What other tests see in a fork of theirs."""
    said = {
        "explore reward.alpha=2": "must lie in [0, 1], got 2 (did you mean 1?)",
        "navigate run=null": "must name the folder of an exploration, got none",
        "tour video=avi": "video must be one of mp4, gif, got avi",
        "report nowhere": "must name the folder of a sweep or a run, got 'nowhere'",
    }
    started = {}
    for line in said:
        recipe, word = line.split()
        started[line] = subprocess.Popen(
            [sys.executable, str(RECIPES / f"{recipe}.py"), word],
            cwd=tmp_path,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
    for line, process in started.items():
        output, errors = process.communicate(timeout=200)
        assert (process.returncode, output) == (2, "")
        assert errors.startswith(f"{line.split()[0]}: ")
        assert errors.endswith(f"{said[line]}\n")
        assert len(errors.splitlines()) == 1
    assert not list(tmp_path.iterdir())


def test_the_log_of_a_sweep_is_opened_where_there_is_no_job(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(HydraConfig.instance(), "cfg", None)
    file = tmp_path / "sweep.log"
    handler = {"class": "logging.FileHandler", "filename": str(file)}
    log_in_own_folder(
        OmegaConf.create(
            {
                "version": 1,
                "handlers": {"file": handler},
                "root": {"handlers": ["file"]},
            }
        )
    )
    logging.getLogger().handlers.pop().close()
    assert file.is_file()


def test_a_long_name_fits_in_bytes_too() -> None:
    # 95 letters of two bytes each: 190 of 255, and a digest that tells it from others.
    folders = [f"init_from=/{'п' * 95}/{'п' * 95}/{seed}" for seed in "ab"]
    names = [folder_name(one) for one in folders]
    assert all(len(name.encode()) <= 200 for name in names)
    assert len({*names}) == 2
    short = f"init_from=/{'п' * 90}"
    assert folder_name(short) == f"init_from=-{'п' * 90}"


@pytest.mark.parametrize("word", ["resume=", "resume=''", "resume=null"])
def test_who_resumes_nothing_names_the_folder_by_its_own_setting(word: str) -> None:
    assert folder_setting([word], sweep=False) == "hydra.run.dir"
    assert folder_setting([word, "resume=runs/one"], sweep=False) == "resume"
