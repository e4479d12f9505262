"""Documents name what exists: files, classes, settings and their values."""

import ast
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

import pytest
import yaml
from hydra.errors import ConfigCompositionException
from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException

from tests.composed import composed as by_choices
from toponav.config import SettingsError

ROOT = Path(__file__).parent.parent
TEXT = (ROOT / "docs" / "fidelity.md").read_text(encoding="utf-8")
PAPER = "## What scale=paper does not do to the letter"
PAGES = ["README.md", "docs/house.md", "docs/extending.md", "docs/glossary.md"]
PAGES += [str(path.relative_to(ROOT)) for path in (ROOT / "docs/methods").glob("*.md")]
#: What a document's command lines have beside settings and files.
FLAGS = {"-m"}
#: Command lines by which the known settings are collected, and on which others build.
BASES = [
    ("explore", ()),
    ("explore", ("scale=paper",)),
    ("explore", ("reward=rnd",)),
    ("explore", ("reward=icm",)),
    ("explore", ("reward=vime",)),
    ("explore", ("reward=ex2",)),
    ("explore", ("loss=trpo",)),
    ("explore", ("loss=dqn", "reward=extrinsic")),
    ("explore", ("loss=drqn", "reward=extrinsic")),
    ("explore", ("loss=nav_a3c", "reward=extrinsic")),
    ("explore", ("loss=nav_a3c_d2l", "reward=extrinsic")),
    ("pretrain", ()),
    ("pretrain", ("scale=paper",)),
    ("navigate", ("maze=maze1",)),
    ("navigate", ("maze=maze1", "navigate=paper")),
    ("navigate", ("maze=maze1", "navigator=trained")),
    ("tour", ()),
    ("report", ()),
    ("reproduce", ()),
]


@cache
def composed(recipe: str, overrides: tuple[str, ...]) -> dict[str, Any]:
    """All settings of a valid command line, groups too, by dotted name."""
    choices = tuple(word for word in overrides if is_choice(word))
    config = by_choices(recipe, *choices)
    # As `by_choices` puts values in, but what it refuses, Hydra need not see again.
    for word in overrides:
        if word not in choices:
            name, _, value = word.partition("=")
            OmegaConf.update(config, name, yaml.safe_load(value), force_add=False)
    OmegaConf.to_object(config)
    return dict(flat(OmegaConf.to_container(config, resolve=True)))


def is_choice(word: str) -> bool:
    """Whether it chooses one option of a group of ``conf/``."""
    return conf(word.partition("=")[0]).is_dir()


def conf(name: str) -> Path:
    return ROOT / "conf" / name


def flat(node: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in node.items():
        yield prefix + name, value
        if isinstance(value, dict):
            yield from flat(value, f"{prefix}{name}.")


@cache
def names_in(path: Path) -> frozenset[str]:
    """What a module defines, members as ``Class.member``, and its texts."""
    found: set[str] = set()

    def visit(node: ast.AST, prefix: str) -> None:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.ClassDef | ast.FunctionDef):
                found.add(prefix + child.name)
                if isinstance(child, ast.ClassDef):
                    visit(child, f"{prefix}{child.name}.")
                else:
                    every = (*child.args.args, *child.args.kwonlyargs)
                    found.update(one.arg for one in every)
            for target in getattr(child, "targets", [getattr(child, "target", None)]):
                if isinstance(target, ast.Name):
                    found.add(prefix + target.id)

    tree = ast.parse(path.read_text(encoding="utf-8"))
    visit(tree, "")
    texts = (one.value for one in ast.walk(tree) if isinstance(one, ast.Constant))
    return frozenset(found | {one for one in texts if isinstance(one, str)})


def is_path(word: str) -> bool:
    return "/" in word and "=" not in word


def modules_of(line: str) -> list[Path]:
    named = re.findall(r"`((?:toponav|recipes|tests)/[\w/]+\.py)`", line)
    return [ROOT / path for path in named if (ROOT / path).is_file()]


def composes(words: tuple[str, ...]) -> bool:
    """Whether a recipe takes settings with these values, together."""
    for recipe, base in BASES:
        given = words
        if recipe == "navigate":
            given = tuple(word.replace("scale=", "navigate=") for word in words)
        if not takes(recipe, base, given):
            continue
        try:
            composed(recipe, (*base, *given))
        except (ConfigCompositionException, OmegaConfBaseException, SettingsError):
            continue
        return True
    return False


@cache
def takes(recipe: str, base: tuple[str, ...], words: tuple[str, ...]) -> bool:
    """Whether a recipe has all these groups, options and settings, whatever the values.

    To see by a composition that it has not takes much longer.
    """
    groups = re.findall(
        r"^  - (\w+):", conf(f"{recipe}.yaml").read_text(), re.MULTILINE
    )
    chosen = {word.partition("=")[0] for word in words if is_choice(word)}
    known = composed(recipe, base).keys() | chosen
    return chosen <= set(groups) and all(
        conf(f"{name}/{value}.yaml").is_file()
        if name in chosen
        else name in known or name.partition(".")[0] in chosen
        for name, _, value in (word.partition("=") for word in words)
    )


def alternatives(words: list[str]) -> Iterator[tuple[str, ...]]:
    """The settings of each run of a sweep."""
    swept = [re.split(r",(?![^\[]*\])", word.partition("=")[2]) for word in words]
    for number in range(max(map(len, swept), default=0)):
        yield tuple(
            f"{word.partition('=')[0]}={values[min(number, len(values) - 1)]}"
            for word, values in zip(words, swept, strict=True)
        )


@cache
def known_settings() -> frozenset[str]:
    return frozenset(name for base in BASES for name in composed(*base))


def wrong_words(span: str, line: str) -> list[str]:
    """What in one piece of code of a line does not exist."""
    words = [word for word in span.split() if word not in FLAGS]
    known = known_settings()
    wrong = []
    for word in words:
        name = word.partition("=")[0]
        if is_path(word):
            good = (ROOT / word).exists()
        elif word.startswith("toponav."):
            good = resolves(word)
        elif "=" in word:
            # A choice of a whole group is composed below.
            good = name in known or is_choice(word)
        else:
            good = word in known or any(
                word in names_in(path) for path in modules_of(line)
            )
        if not good:
            wrong.append(word)
    settings = [word.replace("<run>", "run") for word in words if "=" in word]
    if settings and not wrong:
        wrong += [" ".join(run) for run in alternatives(settings) if not composes(run)]
    return wrong


def resolves(name: str) -> bool:
    try:
        resolve_name(name)
    except (ImportError, AttributeError):
        return False
    return True


def spans() -> list[tuple[str, str]]:
    """Every piece of code with the line it stands in, once."""
    found = [
        (span, line)
        for line in TEXT.splitlines()
        for span in re.findall("`(.+?)`", line)
    ]
    return list(dict.fromkeys(found))


def table(heading: str) -> list[list[str]]:
    section = TEXT.split(heading)[1].split("\n## ")[0]
    rows = [line for line in section.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in row.strip("|").split("|")] for row in rows[2:]]


def test_what_it_names_exists() -> None:
    wrong = {
        word: line[:60] for span, line in spans() for word in wrong_words(span, line)
    }
    assert wrong == {}


@pytest.mark.parametrize("name", PAGES)
def test_files_and_objects_of_other_pages_exist(name: str) -> None:
    text = (ROOT / name).read_text(encoding="utf-8")
    spans = re.findall(
        r"`([^`<*\s]+)`", re.sub(r"```.*?```", "", text, flags=re.DOTALL)
    )
    rooms = ("toponav/", "recipes/", "conf/", "tests/", "docs/", "benchmarks/")
    # The learner of the guide's example.
    paths = [one for one in spans if one.startswith(rooms) and "reinforce" not in one]
    assert [one for one in paths if not (ROOT / one).exists()] == []
    objects = [one for one in spans if re.fullmatch(r"toponav(\.\w+)+", one)]
    assert [one for one in objects if not resolves(one)] == []


@pytest.mark.parametrize(
    "span",
    [
        "toponav/graph/nothing.py",
        "toponav.graph.Nothing",
        "NoSuchClass",
        "A3CLoss.nothing",
        "reward.nothing",
        "reward.alpha=2",
        "loss=nothing",
        "map.edges=both,sideways",
    ],
)
def test_a_wrong_name_is_seen(span: str) -> None:
    assert wrong_words(span, "in `toponav/objectives/a3c_loss.py`")


def test_right_names_pass() -> None:
    line = "`A3CLoss.forward` in `toponav/objectives/a3c_loss.py`"
    right = ["A3CLoss.forward", "toponav.graph.Navigator", "-m reward.alpha=0,0.5"]
    right += ["loss=a3c loss.eps=0.2", "-m maze.blocked=[],[a,b]", "scale=paper"]
    assert [wrong_words(span, line) for span in right] == [[]] * len(right)


def test_readings_are_numbered_without_a_gap() -> None:
    rows = table("## The 48 readings")
    assert [row[0] for row in rows] == [str(number) for number in range(1, 49)]
    assert all(len(row) == 6 and all(row) for row in rows)


def pairs(cell: str) -> dict[str, str]:
    words = " ".join(re.findall("`(.+?)`", cell)).split()
    return dict(word.split("=", 1) for word in words if "=" in word)


@pytest.mark.parametrize("row", table(PAPER), ids=lambda row: row[0][:40])
def test_scale_paper_has_what_the_table_says(row: list[str]) -> None:
    _, where, has, letter, why = row
    assert why
    recipe = "explore" if where == "all" else where
    scale = (
        ("maze=maze1", "navigate=paper") if recipe == "navigate" else ("scale=paper",)
    )
    paper = composed(recipe, scale)
    for name, value in pairs(has).items():
        found = paper[f"{name}.name" if isinstance(paper[name], dict) else name]
        assert found == yaml.safe_load(value), name
    for name, value in pairs(letter).items():
        other = composed(recipe, (*scale, f"{name}={value}"))
        assert other[name] != paper[name], name


def test_every_equation_figure_and_table_of_the_paper_has_a_row() -> None:
    """The paper has 15 numbered equations, 22 figures and 9 tables."""
    first = re.findall(r"^\| ([^|]+) \|", TEXT, flags=re.MULTILINE)
    named = " ".join(first)
    rows = {
        int(one)
        for cell in first
        for one in re.findall(r"\b\d+\b", cell)
        if re.fullmatch(r"[\d, ]+", cell)
    }
    assert set(range(1, 16)) <= rows
    for word, last in (("Fig", 22), ("Table", 9)):
        found: set[int] = set()
        for numbers in re.findall(rf"{word}s?\.? ([\d, ]+(?:(?:to|and) \d+)?)", named):
            given = [int(one) for one in re.findall(r"\d+", numbers)]
            found |= (
                set(range(given[0], given[-1] + 1)) if "to" in numbers else set(given)
            )
        assert set(range(1, last + 1)) <= found, word
