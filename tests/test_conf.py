"""Every recipe composes, every option of every group is valid and explained."""

import dataclasses
import importlib
import math
import re
import sys
from collections.abc import Callable, Iterator
from itertools import takewhile
from operator import attrgetter
from pathlib import Path

import pytest
import yaml
from hydra import compose, initialize_config_dir
from hydra.errors import ConfigCompositionException, HydraException
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException

from tests.composed import CONF, by_hydra, composed, register_once, settings
from toponav.builders.pretraining import pretraining_folder
from toponav.config import (
    RECIPES,
    ExploreConfig,
    NavigateConfig,
    PretrainConfig,
    SettingsError,
)
from toponav.methods import REWARDS, make_world

FILES = sorted(CONF.rglob("*.yaml"))
SCALES = ["smoke", "laptop", "paper"]
LOSSES = ["ppo", "a3c", "trpo"]
HYDRAS_OWN = {"defaults", "hydra"}
#: How many keys in a row a comment explains at most, if it has an "and".
MOST_KEYS = 3
#: How the head of a file says where its keys are explained.
ELSEWHERE = re.compile(r"What the keys mean: (\S+\.yaml)|(\S+\.yaml) explains each key")
#: The words of a setting: ("maze", "goal") is maze.goal.
Name = tuple[str, ...]
#: A setting, and whether a comment explains it.
Found = tuple[Name, bool]
#: What an option cannot do without.
NEEDED = {("world", "gym"): ["world.id=CartPole-v1"]}


def outcome(
    compose_words: Callable[..., DictConfig], recipe: str, words: tuple[str, ...]
) -> tuple[object, str]:
    """The settings of a command line, or what is said against it."""
    try:
        config = compose_words(recipe, *words)
    except (HydraException, OmegaConfBaseException) as error:
        return type(error), str(error)
    return OmegaConf.to_container(config), ""


def maze_of(recipe: str) -> tuple[str, ...]:
    """Navigating takes the maze of a run unless one is named."""
    return ("maze=maze1",) if recipe in ("navigate", "practise") else ()


def options() -> list[tuple[str, str]]:
    """Group and option of every file in a group, bases left out."""
    return [
        (path.parent.name, path.stem)
        for path in FILES
        if path.parent.parent == CONF and path.stem not in ("base", "file", "run")
    ]


@pytest.mark.parametrize("recipe", RECIPES)
def test_each_recipe_composes_to_its_schema(recipe: str) -> None:
    assert isinstance(settings(recipe, *maze_of(recipe)), RECIPES[recipe])


@pytest.mark.parametrize(
    "recipe", ["pretrain", "explore", "navigate", "practise", "tour"]
)
def test_runs_of_the_same_second_have_folders_of_their_own(recipe: str) -> None:
    register_once()
    found = []
    with initialize_config_dir(str(CONF), version_base="1.3"):
        for _ in range(2):
            words = list(maze_of(recipe))
            config = compose(recipe, overrides=words, return_hydra_config=True)
            found.append((config.hydra.run.dir, config.hydra.sweep.dir))
    assert found[0][0] != found[1][0]
    assert found[0][1] != found[1][1]


@pytest.mark.parametrize(
    ("recipe", "words"),
    [
        ("explore", ("scale=smoke", "reward=count", "reward.alpha=0.3", "maze=maze1")),
        ("explore", ("loss=trpo", r"loss.max_kl=\${log_uniform:1e-4,5e-3}")),
        ("navigate", ("maze=maze1", "navigate=smoke", "navigator=random", "run=abc")),
        ("tour", ("maze.blocked=[a,'b']", "maze.path=null", "maze.loops=1e-1")),
        ("tour", ("seed=1", "seed=2", "maze.path='a b'", "++maze.rows=7")),
        ("tour", ("seed=${views}", "video='${maze.path}'", "maze=maze1", "height=99")),
        # What Hydra refuses, or what is one line's of a sweep.
        ("tour", ("maze.lops=0.3",)),
        ("tour", ("seed=one",)),
        ("tour", ("seed=1,2",)),
        ("tour", ("maze.blocked=[a",)),
        ("tour", ("maze=none_such", "seed=1")),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else value,
)
def test_what_tests_share_is_what_hydra_composes(
    recipe: str, words: tuple[str, ...]
) -> None:
    assert outcome(composed, recipe, words) == outcome(by_hydra, recipe, words)


def test_who_changes_composed_settings_has_a_copy() -> None:
    composed("tour", "seed=1").maze.rows = 99
    assert composed("tour", "seed=1").maze.rows != 99


@pytest.mark.parametrize("recipe", RECIPES)
def test_each_recipe_has_a_script_and_a_file(recipe: str) -> None:
    assert (CONF / f"{recipe}.yaml").exists()
    assert (CONF.parent / "recipes" / f"{recipe}.py").exists()


@pytest.mark.slow
@pytest.mark.parametrize(("group", "option"), options())
def test_each_option_of_each_group_is_valid(group: str, option: str) -> None:
    recipes = [
        name for name in RECIPES if f"- {group}:" in (CONF / f"{name}.yaml").read_text()
    ]
    assert recipes, f"no recipe uses the group {group}"
    for recipe in recipes:
        maze = () if group == "maze" else maze_of(recipe)
        needed = NEEDED.get((group, option), [])
        settings(recipe, f"{group}={option}", *maze, *needed)


def package_of(path: Path, text: str) -> Name:
    """Where the settings of a file are put: those of conf/loss into `loss`."""
    said = re.search(r"# @package (\S+)", text)
    if said is None:
        return path.parent.relative_to(CONF).parts
    return () if said[1] == "_global_" else tuple(said[1].split("."))


def head_of(lines: list[str]) -> list[str]:
    """The comments before all else, which say what a file is for."""
    return list(takewhile(lambda line: line.startswith("#"), lines))


def have_comments(text: str, package: Name = ()) -> dict[Name, bool]:
    """Whether a comment of a file explains it, of each key that has a value.

    A comment stands above one key, above several in a row, which it joins by an "and",
    or above a mapping, whose keys then need none of their own.
    """
    lines = text.splitlines()
    head = len(head_of(lines))

    def walk(mapping: yaml.MappingNode, name: Name, left: float) -> Iterator[Found]:
        # ``left``: how many more keys the comment above them may explain.
        for key, value in mapping.value:
            above = [line.strip() for line in lines[head : key.start_mark.line]]
            comment = [*takewhile(lambda line: line.startswith("#"), reversed(above))]
            if comment:
                left = MOST_KEYS if re.search(r"\band\b", " ".join(comment)) else 1
            elif not above or not above[-1]:
                left = 0
            inner = (*name, key.value)
            if not name and key.value in HYDRAS_OWN:
                left = 0
            elif isinstance(value, yaml.MappingNode) and not value.flow_style:
                yield from walk(value, inner, math.inf if comment else 0)
                left = 0
            else:
                yield inner, left > 0
                left -= 1

    found = dict(walk(yaml.compose(text), (), 0))
    return {(*package, *name): said for name, said in found.items()}


def explained_elsewhere(path: Path) -> set[Name]:
    """What the file explains that a file's head names for that, if it names one."""
    head = head_of(path.read_text().splitlines())
    said = ELSEWHERE.search(" ".join(line.strip("# ") for line in head))
    if said is None:
        return set()
    name = said[1] or said[2]
    other = CONF.parent / name if "/" in name else path.parent / name
    text = other.read_text()
    found = have_comments(text, package_of(other, text))
    return {name for name, explained in found.items() if explained}


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(CONF)))
def test_each_key_has_a_comment_above_it(path: Path) -> None:
    text = path.read_text()
    found = have_comments(text, package_of(path, text))
    missing = {name for name, explained in found.items() if not explained}
    missing -= explained_elsewhere(path)
    assert sorted(".".join(name) for name in missing) == []


@pytest.mark.parametrize(
    ("text", "missing"),
    [
        # The head says what the file is for, and explains no key.
        ("# Head.\na: 1\n", ["a"]),
        ("# Head.\na:\n  b: 1\n", ["b"]),
        ("# Head.\n\n# A.\na: 1\n", []),
        ("a:\n  # B.\n  b: 1\n  c:\n    d: 1\n    # E.\n    e: [1]\n", ["d"]),
        ("a:\n  # B and e.\n  b:\n    - c: 1\n      d: 2\n  e: 1\n", []),
        # A blank line or a mapping ends what a comment explains.
        ("a:\n  # B and c.\n  b: 1\n  c: 2\n\n  d: 3\n", ["d"]),
        ("a:\n  # B.\n  b: 1\n  c:\n    # D.\n    d: 1\n  e: 2\n", ["e"]),
        # Several are joined by an "and", three at most.
        ("a:\n  # B,\n  # and c.\n  b: 1\n  c: 2\n", []),
        ("a:\n  # B.\n  b: 1\n  c: 2\n", ["c"]),
        ("a:\n  # B, c and d.\n  b: 1\n  c: 2\n  d: 3\n  e: 4\n", ["e"]),
        # One comment may explain all keys of a mapping.
        ("b: 0\n# Seconds.\na:\n  b: 1\n  c: 2\n  d: 3\n  e: 4\n", ["b"]),
        ("# Head.\ndefaults:\n  - a\nhydra:\n  b: 1\n", []),
    ],
)
def test_a_key_without_a_comment_is_seen(text: str, missing: list[str]) -> None:
    found = have_comments(text)
    assert [name[-1] for name, explained in found.items() if not explained] == missing


def test_a_file_names_the_one_that_explains_its_keys() -> None:
    smoke = explained_elsewhere(CONF / "explore/smoke.yaml")
    assert ("map", "tc_reach") in smoke
    assert ("maze", "episode_length") not in smoke
    # By its path, from a group that is put into another.
    assert ("loss", "replay") in explained_elsewhere(CONF / "scale/loss/paper_dqn.yaml")
    rewards = CONF / "scale/reward"
    assert ("reward", "eta") in explained_elsewhere(rewards / "paper_icm.yaml")
    assert explained_elsewhere(CONF / "explore/laptop.yaml") == set()


def test_a_maze_file_gives_all_values_of_the_schema() -> None:
    maze = settings("tour").maze
    given = {field.name for field in dataclasses.fields(maze)}
    assert given == set(yaml.safe_load((CONF / "maze/base.yaml").read_text())) - {
        "defaults"
    } | {"name"}


@pytest.mark.parametrize(
    ("override", "message"),
    [
        ("maze.apples=-1", "maze.apples must be at least 0, got -1"),
        ("seed=-1", r"seed must lie in \[0, 4294967295\], got -1"),
        ("maze.seed=99999999999999999999", r"maze.seed must lie in \[0, 42949"),
        ("maze.paintings=1.5", r"maze.paintings must lie in \[0, 1\], got 1.5"),
        ("maze.marks=-1", r"maze.marks must lie in \[0, 1\], got -1"),
        ("maze.episode_length=0", "maze.episode_length must be at least 1, got 0"),
        ("maze.loops=2", r"maze.loops must lie in \[0, 1\], got 2"),
        ("maze.rows=0", "maze.rows must be at least 1, got 0"),
        ("maze=file", "maze.path must name a layout file when maze=file, got None"),
        ("views=13", r"views must lie in \[1, 12\], got 13"),
        ("decisions=0", "decisions must be at least 1, got 0"),
        ("video=avi", "video must be one of mp4, gif, got avi"),
    ],
)
def test_a_value_out_of_range_is_refused(override: str, message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        settings("tour", override)


def words_for_hydra(
    recipe: str, words: tuple[str, ...], monkeypatch: pytest.MonkeyPatch
) -> list[str]:
    """What a recipe's script makes of its command line before Hydra reads it."""
    seen: list[str] = []
    script = importlib.import_module(f"recipes.{recipe}")
    monkeypatch.setenv("HYDRA_FULL_ERROR", "1")
    monkeypatch.setattr("signal.signal", lambda *_: None)
    monkeypatch.setattr("sys.unraisablehook", sys.unraisablehook)
    monkeypatch.setattr(
        "hydra.main", lambda **_: lambda _: lambda: seen.extend(sys.argv[1:])
    )
    monkeypatch.setattr("sys.argv", [f"{recipe}.py", *words])
    script.main()
    return seen


@pytest.mark.parametrize("scale", SCALES)
@pytest.mark.parametrize("recipe", RECIPES)
def test_each_recipe_composes_at_each_scale(
    recipe: str, scale: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = (f"scale={scale}", *maze_of(recipe))
    found = settings(recipe, *words_for_hydra(recipe, words, monkeypatch))
    usual = settings(recipe, *maze_of(recipe))
    assert (found == usual) == (scale == "laptop")


# A file of settings is named by two of the three at most (conf/explore.yaml): each pair
# is here, and all three of them in a third of all ways.
@pytest.mark.parametrize(
    ("scale", "loss", "reward"),
    [
        (scale, LOSSES[(i + j) % len(LOSSES)], reward)
        for i, scale in enumerate(SCALES)
        for j, reward in enumerate(REWARDS)
    ],
)
def test_each_method_composes_at_each_scale(scale: str, loss: str, reward: str) -> None:
    found = settings("explore", f"scale={scale}", f"loss={loss}", f"reward={reward}")
    assert (found.reward.name, found.loss.name) == (reward, loss)


def test_a_scale_changes_what_is_of_one_method_alone() -> None:
    paper = settings("explore", "scale=paper")
    assert (paper.loss.name, paper.reward.threshold, paper.reward.persistence) == (
        "a3c",
        "tc",
        1,
    )
    # What the command line says comes last.
    chosen = settings("explore", "scale=paper", "loss=ppo", "reward.threshold=0.5")
    assert (chosen.loss.name, chosen.reward.threshold) == ("ppo", "0.5")
    assert settings("explore", "scale=smoke").loss.rollout == 32


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        # The numbers of the rivals' own papers and code (docs/methods).
        (["reward=vime"], {"reward.update_rate": 0.1, "reward.minibatch": 10}),
        # 8 mazes * 500 decisions = 4,000 for a step, if all wait for each other.
        (["loss=trpo"], {"loss.rollout": 500, "collect.mode": "sync"}),
        (["loss=dqn"], {"loss.target_every": 10_000, "policy.hidden": 512}),
        (["loss=drqn"], {"loss.batch": 32, "loss.every": 4, "policy.hidden": 512}),
        (["loss=nav_a3c"], {"loss.final_lr": 1, "loss.max_grad_norm": 1e9}),
        # 3.33 * 64 places: the mean is weighed, and theirs is a sum.
        (["loss=nav_a3c_d2l"], {"loss.depth_coeff": 213.12, "loss.final_lr": 1}),
    ],
    ids=lambda value: value[0] if isinstance(value, list) else "",
)
def test_rivals_have_the_numbers_of_their_own_papers_at_the_papers_scale(
    words: list[str], expected: dict[str, object]
) -> None:
    paper = settings("explore", "scale=paper", *words)
    laptop = settings("explore", *words)
    for name, value in expected.items():
        assert attrgetter(name)(paper) == value, name
        assert attrgetter(name)(laptop) != value, name
    # What the command line says comes last.
    name = next(iter(expected))
    other = settings(
        "explore", "scale=paper", *words, f"{name}={attrgetter(name)(laptop)}"
    )
    assert attrgetter(name)(other) == attrgetter(name)(laptop)


def test_settings_of_one_method_are_unknown_to_the_others() -> None:
    for words in (["reward=rnd", "reward.alpha=0.2"], ["loss=a3c", "loss.epochs=3"]):
        with pytest.raises(ConfigCompositionException):
            settings("explore", *words)


@pytest.mark.parametrize(
    ("path", "word"),
    [
        (path, word)
        for path in FILES
        for word in re.findall(r'#.*?"(\w[\w.]*=.+)"', path.read_text())
    ],
    ids=lambda value: value.name if isinstance(value, Path) else "",
)
def test_what_a_comment_recommends_for_a_shell_is_valid(path: Path, word: str) -> None:
    settings(path.parent.name, word)


def test_there_is_such_a_recommendation() -> None:
    text = (CONF / "explore/laptop.yaml").read_text()
    assert '"pretraining.overrides=[' in text


def test_a_layout_of_ones_own_goes_by_the_name_of_its_file() -> None:
    path = CONF.parent / "toponav/envs/layouts/select.txt"
    own = settings("explore", "maze=file", f"maze.path={path}")
    assert own.world.label == make_world(own).name == "select"
    assert pretraining_folder(own).name.startswith("select-laptop-")
    assert settings("explore", "maze=maze1").world.label == "maze1"


def test_the_papers_scale_caps_nothing_and_compares_all_waypoints() -> None:
    found = settings("explore", "scale=paper")
    assert isinstance(found, ExploreConfig)
    assert found.reward.capacity is None
    assert found.map.capacity is None
    assert found.map.nearby is None
    assert found.map.shortlist is None
    assert found.map.untraversed_edge_cost == 1
    walking = settings("navigate", "maze=maze1", "navigate=paper")
    assert isinstance(walking, NavigateConfig)
    assert walking.navigator.untraversed_edge_cost == 1


def test_continued_training_has_the_numbers_of_the_papers_pre_training() -> None:
    exploring = settings("explore", "scale=paper")
    training = settings("pretrain", "scale=paper")
    assert isinstance(exploring, ExploreConfig)
    assert isinstance(training, PretrainConfig)
    for name in ("weight_decay", "locomotion_coeff"):
        assert getattr(exploring.online, name) == getattr(training.train, name), name
