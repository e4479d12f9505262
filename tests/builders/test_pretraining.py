import os
import shutil
import sys
import threading
from pathlib import Path
from unittest.mock import Mock

import pytest
import torch
from hydra.core.override_parser.overrides_parser import OverridesParser

from tests.composed import settings
from tests.explored import RING
from tests.exploring import explore_settings, world_of
from tests.models import WORLD
from toponav.builders import load_networks, make_networks, prepare_networks, pretraining
from toponav.builders.networks import save_networks
from toponav.builders.pretraining import pretraining_folder, pretraining_overrides
from toponav.config import ExploreConfig, PretrainConfig, SettingsError, TrainingError

# Stands for the recipe: notes that it ran, and leaves the networks that it is given.
SCRIPT = """
import shutil, sys
from pathlib import Path
folder = [word for word in sys.argv if word.startswith("hydra.run.dir=")]
words = folder or [word for word in sys.argv if word.startswith("resume=")]
folder = Path(words[0].partition("=")[2].strip("'"))
with open({noted!r}, "a") as file:
    file.write(sys.argv[1] + "\\n")
{rest}
"""
LEAVE = "shutil.copy({networks!r}, folder / 'networks.pt')"


def config_folder(folder: Path) -> str:
    return f"pretraining.folder={folder}/pretrain"


@pytest.fixture
def config(tmp_path: Path) -> ExploreConfig:
    found = explore_settings(config_folder(tmp_path))
    networks = make_networks(found.model, WORLD)
    networks.thresholds = {"reward_threshold": 0.5}
    save_networks(networks, tmp_path / "made.pt")
    (tmp_path / "run").mkdir()
    return found


def write_script(folder: Path, rest: str = LEAVE) -> Path:
    """A stand-in of the recipe; what it ran with is in ``noted``."""
    script = folder / "pretrain.py"
    rest = rest.format(networks=str(folder / "made.pt"))
    script.write_text(SCRIPT.format(noted=str(folder / "noted"), rest=rest))
    return script


def test_a_pretraining_with_the_same_settings_is_found_again(
    config: ExploreConfig, tmp_path: Path
) -> None:
    script = write_script(tmp_path)
    for _ in range(2):
        networks = prepare_networks(config, world_of(config), tmp_path / "run", script)
        assert networks.thresholds == {"reward_threshold": 0.5}
    assert (tmp_path / "noted").read_text() == "maze=maze3\n"
    assert load_networks(tmp_path / "run").model == config.model
    other = explore_settings(config_folder(tmp_path), "pretraining.seed=1")
    prepare_networks(other, world_of(other), tmp_path / "run", script)
    assert (tmp_path / "noted").read_text() == "maze=maze3\nmaze=maze3\n"


def test_a_layout_that_was_edited_gets_a_pretraining_of_its_own(
    config: ExploreConfig, tmp_path: Path
) -> None:
    layout, script = tmp_path / "ring.txt", write_script(tmp_path)
    words = ("maze=file", f"maze.path={layout}", config_folder(tmp_path))
    folders = []
    for text in (RING, RING, RING.replace("* *a*", "*  a*")):
        layout.write_text(text)
        found = explore_settings(*words)
        prepare_networks(found, world_of(found), tmp_path / "run", script)
        folders.append(pretraining_folder(found))
    assert (tmp_path / "noted").read_text() == 2 * "maze=file\n"
    assert folders[0] == folders[1] != folders[2]
    assert [one.name.rpartition("-")[0] for one in folders] == 3 * ["ring-smoke"]


def test_what_the_overrides_name_is_told_by_its_content(tmp_path: Path) -> None:
    layout, other = tmp_path / "ring.txt", tmp_path / "other.txt"
    model = explore_settings().model
    other.write_text(RING)

    def name(*words: str) -> str:
        given = ",".join(f"'{word}'" for word in words)
        config = explore_settings("maze=maze1", f"pretraining.overrides=[{given}]")
        return pretraining_folder(config).name

    lines = [
        ("maze=file", f"maze.path={layout}"),
        ("maze.name=file", f"maze.path={layout}"),
        ("mazes=[maze1,file]", f"maze.path={layout}"),
        (f"init_from={tmp_path}",),
        (f"init_from={tmp_path}/networks.pt",),
    ]
    before, after = [], []
    for seed, found in enumerate((before, before, after)):
        layout.write_text(RING if found is before else RING.replace("* *a*", "*  a*"))
        if seed != 1:
            torch.manual_seed(seed)
            save_networks(make_networks(model, WORLD), tmp_path / "networks.pt")
        found.append([name(*words) for words in lines])
    assert before[0] == before[1]
    keys = [*before[0], *after[0]]
    assert len(set(keys)) == len(keys)
    assert keys[0].startswith("ring-smoke-")
    # A run that is gone, and a package's.
    assert name("init_from=gone") != name("init_from=package:maze3")


def test_keys_of_earlier_versions_are_still_valid() -> None:
    names = {
        "maze=maze3": "maze3-smoke-6499dfce",
        "pretraining.maze=select": "select-smoke-a4a08db9",
        "pretraining.overrides=['train.updates=7']": "maze3-smoke-7252f14a",
    }
    for word, name in names.items():
        maze = "maze=maze1" if name.startswith("select") else "maze=maze3"
        config = settings("explore", "scale=smoke", maze, word)
        assert isinstance(config, ExploreConfig)
        assert pretraining_folder(config).name == name


@pytest.mark.parametrize("word", ["maze=select", "maze.name=select"])
def test_a_maze_in_the_overrides_is_the_one_to_pretrain_in(word: str) -> None:
    words = f"pretraining.overrides=['{word}']"
    config = explore_settings("maze=maze1", "maze.blocked=[a]", words)
    found = settings("pretrain", *pretraining_overrides(config))
    assert isinstance(found, PretrainConfig)
    assert (found.maze.name, found.maze.blocked) == ("select", [])


def test_a_layout_whose_name_has_an_apostrophe_is_pretrained_in(
    config: ExploreConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    layout, commands = tmp_path / "it's.txt", list[list[str]]()
    layout.write_text(RING)
    words = ("maze=file", f'maze.path="{layout}"', config_folder(tmp_path))
    found = explore_settings(*words)
    folder = pretraining_folder(found)

    def run(command: list[str], *_: object) -> None:
        # The first is cut off, the second ends.
        (folder / ("networks.pt" if commands else "checkpoint.pt")).touch()
        commands.append(command[2:])

    monkeypatch.setattr(pretraining, "_run", run)
    with pytest.raises(TrainingError, match="must end with networks"):
        pretraining.pretrain(found, tmp_path, {})
    assert pretraining.pretrain(found, tmp_path, {}) == folder
    parse = OverridesParser.create().parse_overrides
    first, second = (
        {word.key_or_group: word.value() for word in parse(one)} for one in commands
    )
    assert first["maze.path"] == str(layout)
    assert first["hydra.run.dir"] == second["resume"] == str(folder)


def test_one_that_is_found_may_be_in_a_folder_to_read_alone(
    config: ExploreConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    script, world = write_script(tmp_path), world_of(config)
    prepare_networks(config, world, tmp_path / "run", script)
    monkeypatch.setattr(pretraining, "_alone_in", Mock(side_effect=OSError("locked")))
    networks = prepare_networks(config, world, tmp_path / "run", script)
    assert networks.thresholds == {"reward_threshold": 0.5}
    other = explore_settings(f"pretraining.folder={tmp_path}/other")
    with pytest.raises(OSError, match="locked"):
        prepare_networks(other, world, tmp_path / "run", script)


def test_the_main_job_trains_networks_of_its_own_from_nothing() -> None:
    main_job = settings("explore", "maze=maze3", "reward.alpha=0.2")
    assert isinstance(main_job, ExploreConfig)
    assert main_job.pretrained is None
    pretraining = settings("pretrain", *pretraining_overrides(main_job))
    assert isinstance(pretraining, PretrainConfig)
    assert pretraining.init_from is None
    assert pretraining.train.updates == 2000


def test_what_exploring_alone_depends_on_does_not_matter() -> None:
    one = explore_settings("reward.alpha=0.5", "seed=3", "loss.lr=0.01")
    assert pretraining_overrides(one) == pretraining_overrides(explore_settings())
    for override in ("maze.texture_seed=1", "pairs.k=3", "model.projection_dim=7"):
        other = explore_settings(override)
        assert pretraining_overrides(other) != pretraining_overrides(one)


def test_more_settings_of_the_pretraining_can_be_given() -> None:
    config = explore_settings("pretraining.overrides=['train.updates=7']")
    found = settings("pretrain", *pretraining_overrides(config))
    assert isinstance(found, PretrainConfig)
    assert found.train.updates == 7
    assert pretraining_folder(config) != pretraining_folder(explore_settings())


@pytest.mark.parametrize("maze", ["maze3", "random", "file"])
def test_the_command_line_composes_to_the_same_maze_and_model(
    maze: str, tmp_path: Path
) -> None:
    path = tmp_path / "a maze.txt"
    path.write_text("****\n*  *\n****\n")
    words = [f"maze={maze}", "maze.loops=0.25"]
    if maze == "file":
        words.append(f"maze.path='{path}'")
    config = explore_settings(*words)
    found = settings("pretrain", *pretraining_overrides(config))
    assert isinstance(found, PretrainConfig)
    assert (found.maze, found.model, found.pairs) == (
        config.maze,
        config.model,
        config.pairs,
    )


def test_another_maze_can_be_the_one_to_pretrain_in() -> None:
    config = explore_settings(
        "maze=maze1", "maze.blocked=[a]", "pretraining.maze=select"
    )
    found = settings("pretrain", *pretraining_overrides(config))
    assert (found.maze.name, found.maze.blocked) == ("select", [])


def test_one_that_was_cut_off_goes_on(config: ExploreConfig, tmp_path: Path) -> None:
    script = write_script(tmp_path, "(folder / 'checkpoint.pt').touch(); sys.exit(3)")
    with pytest.raises(TrainingError, match="must end well, got exit status 3"):
        prepare_networks(config, world_of(config), tmp_path / "run", script)
    prepare_networks(config, world_of(config), tmp_path / "run", write_script(tmp_path))
    first, second = (tmp_path / "noted").read_text().split()
    assert first == "maze=maze3"
    assert second.startswith(f"resume='{tmp_path}/pretrain/maze3-smoke-")


def test_one_that_is_refused_leaves_nothing(
    config: ExploreConfig, tmp_path: Path
) -> None:
    # The recipe's log and settings, beside the lock of this run.
    rest = "(folder / 'config').mkdir(); (folder / 'pretrain.log').touch(); sys.exit(2)"
    script = write_script(tmp_path, rest)
    with pytest.raises(SettingsError, match="must have settings that it takes, got"):
        prepare_networks(config, world_of(config), tmp_path / "run", script)
    assert list((tmp_path / "pretrain").iterdir()) == []
    # One that went on from a checkpoint keeps it.
    folder = pretraining_folder(config)
    folder.mkdir()
    (folder / "checkpoint.pt").touch()
    script = write_script(tmp_path, "sys.exit(2)")
    with pytest.raises(SettingsError, match="must have settings that it takes, got"):
        prepare_networks(config, world_of(config), tmp_path / "run", script)
    assert (folder / "checkpoint.pt").is_file()


def test_who_waited_for_one_that_was_refused_has_a_folder_and_its_lock(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, opened, held = tmp_path / "pretrain", threading.Event(), []

    def wait() -> None:
        with pretraining._alone_in(folder) as lock:
            there = os.fstat(lock.fileno())
            held.append(os.path.samestat(there, (folder / ".lock").stat()))

    # It looks for engines of others after each time that it did not get the lock.
    monkeypatch.setattr(pretraining, "end_stray_engines", opened.set)
    waiting = threading.Thread(target=wait)
    with pretraining._alone_in(folder):
        waiting.start()
        assert opened.wait(10)
        shutil.rmtree(folder)
    waiting.join(10)
    assert held == [True]


@pytest.mark.slow
def test_engines_of_one_that_was_killed_do_not_keep_the_next_waiting(
    config: ExploreConfig, tmp_path: Path
) -> None:
    killed = """
import os, signal
sys.path.insert(0, {root!r})
from tests.envs.layouts import LANE
from toponav.envs import MazeEnv
env = MazeEnv(LANE, batch_size=1)
os.kill(os.getpid(), signal.SIGKILL)
"""
    killed = killed.format(root=str(Path(__file__).parents[2]))
    with pytest.raises(TrainingError, match="must end well, got exit status -9"):
        prepare_networks(
            config, world_of(config), tmp_path / "run", write_script(tmp_path, killed)
        )
    # Without ending them it would wait until the test runs out of time.
    prepare_networks(config, world_of(config), tmp_path / "run", write_script(tmp_path))


def test_one_that_leaves_nothing_is_told(config: ExploreConfig, tmp_path: Path) -> None:
    with pytest.raises(TrainingError, match="must end with networks, got none"):
        prepare_networks(
            config, world_of(config), tmp_path / "run", write_script(tmp_path, "pass")
        )


def test_one_that_hangs_is_ended(
    config: ExploreConfig, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pretraining, "_IDLE_S", 1.2)
    script = tmp_path / "pretrain.py"
    script.write_text("import time\ntime.sleep(120)\n")
    with pytest.raises(TrainingError, match=r"got no processor time in 1.2 s$"):
        prepare_networks(config, world_of(config), tmp_path, script)


def test_a_run_that_goes_on_keeps_its_networks(tmp_path: Path) -> None:
    config = explore_settings(f"resume={tmp_path}", "pretrained=gone")
    save_networks(make_networks(config.model, WORLD), tmp_path / "networks.pt")
    assert (
        prepare_networks(
            config, world_of(config), tmp_path, Path(sys.executable)
        ).thresholds
        == {}
    )
    with pytest.raises(SettingsError, match="pretrained must name a run with gone"):
        prepare_networks(
            config, world_of(config), tmp_path / "other", Path(sys.executable)
        )
