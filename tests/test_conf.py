"""Every recipe composes, every option of every group is valid and explained."""

import dataclasses
from pathlib import Path

import pytest
import yaml
from hydra import compose, initialize_config_dir
from omegaconf import OmegaConf

from toponav.config import RECIPES, SettingsError, register

CONF = Path(__file__).parent.parent / "conf"
FILES = sorted(CONF.rglob("*.yaml"))
HYDRAS_OWN = {"defaults", "hydra"}


def settings(recipe: str, *overrides: str) -> object:
    register()
    with initialize_config_dir(str(CONF), version_base="1.3"):
        return OmegaConf.to_object(compose(recipe, overrides=list(overrides)))


def options() -> list[tuple[str, str]]:
    """Group and option of every file in a group, bases left out."""
    return [
        (path.parent.name, path.stem)
        for path in FILES
        if path.parent != CONF and path.stem not in ("base", "file")
    ]


@pytest.mark.parametrize("recipe", RECIPES)
def test_each_recipe_composes_to_its_schema(recipe: str) -> None:
    assert isinstance(settings(recipe), RECIPES[recipe])


@pytest.mark.parametrize("recipe", RECIPES)
def test_each_recipe_has_a_script_and_a_file(recipe: str) -> None:
    assert (CONF / f"{recipe}.yaml").exists()
    assert (CONF.parent / "recipes" / f"{recipe}.py").exists()


@pytest.mark.parametrize(("group", "option"), options())
def test_each_option_of_each_group_is_valid(group: str, option: str) -> None:
    recipes = [
        name for name in RECIPES if f"- {group}:" in (CONF / f"{name}.yaml").read_text()
    ]
    assert recipes, f"no recipe uses the group {group}"
    for recipe in recipes:
        settings(recipe, f"{group}={option}")


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(CONF)))
def test_each_key_has_a_comment_above_it(path: Path) -> None:
    lines = path.read_text().splitlines()
    known = {key for key in yaml.safe_load(path.read_text()) if key not in HYDRAS_OWN}
    for number, line in enumerate(lines):
        key = line.split(":")[0]
        # Keys of one paragraph share its comment; a mapping explains its own keys.
        if key not in known or line.endswith(":"):
            continue
        above = number - 1
        while lines[above].split(":")[0] in known:
            above -= 1
        assert lines[above].startswith("#"), f"{path}: {key} has no comment above it"


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
        ("maze.paintings=1.5", r"maze.paintings must lie in \[0, 1\], got 1.5"),
        ("maze.marks=-1", r"maze.marks must lie in \[0, 1\], got -1"),
        ("maze.episode_length=0", "maze.episode_length must be at least 1 decision"),
        ("maze.loops=2", r"maze.loops must lie in \[0, 1\], got 2"),
        ("maze.rows=0", "maze.rows must be at least 1, got 0"),
        ("maze=file", "maze.path must name a layout file when maze=file, got None"),
        ("views=13", r"views must lie in \[1, 12\], got 13"),
        ("decisions=0", "decisions must be at least 1, got 0"),
        ("video=avi", "video must be mp4 or gif, got avi"),
    ],
)
def test_a_value_out_of_range_is_refused(override: str, message: str) -> None:
    with pytest.raises(SettingsError, match=message):
        settings("tour", override)
