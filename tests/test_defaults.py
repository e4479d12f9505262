"""docs/defaults.md has a row for every default, with the value that it has today.

Its links are looked at by `tests/test_links.py`.
"""

import ast
import inspect
import re
import shutil
from collections.abc import Iterator
from dataclasses import fields
from importlib import import_module
from pathlib import Path
from pkgutil import resolve_name
from typing import Any

import pytest
import yaml

ROOT = Path(__file__).parent.parent
CONF = ROOT / "conf"
TEXT = (ROOT / "docs" / "defaults.md").read_text(encoding="utf-8")

EXPLORING = "Exploring: reward, learner, collection"
RIVALS = "Rivals' rewards and learners"
CONSTANTS = "Constants in code"
#: Tables that together have the settings of these files of ``conf/``, by their prefix.
AREAS: dict[tuple[str, ...], dict[str, str]] = {
    ("Networks and pre-training",): {
        "pretrain/laptop": "",
        "scale/laptop": "",
        "model/small": "model.",
    },
    (EXPLORING, "The map as it grows", "The map by poses"): {
        "explore/laptop": "",
        "reward/novelty": "reward.",
        "loss/ppo": "loss.",
    },
    ("Navigator by poses, and goals",): {
        "navigate/laptop": "",
        "navigator/poses": "navigator.",
    },
    ("Topological navigator",): {"navigator/topological": "navigator."},
    ("Practice",): {"practise/laptop": ""},
}
METHODS = {
    "reward": ("coverage", "ex2", "extrinsic", "icm", "random", "rnd", "vime"),
    "loss": ("a3c", "dqn", "drqn", "nav_a3c", "nav_a3c_d2l", "trpo"),
}
#: Groups of which one option is the default, and what says so.
CHOICES = {
    "model": "explore.yaml",
    "reward": "explore.yaml",
    "loss": "loss/laptop.yaml",
    "navigator": "navigate.yaml",
}
#: Where things are, lie or go, and what is made at all.
LEFT_OUT = {
    *("model.name", "reward.name", "loss.name", "navigator.name"),
    *("collect.backend", "collect.device", "ray.address", "map.grow"),
    *("pretraining.scale", "pretraining.folder", "pretraining.overrides"),
    *("evaluate.random_folder", "evaluate.policies", "evaluate.trained"),
    "video.format",
}
#: Dataclasses whose numbers all have a row, but for the seed and what is given to them.
RULES = (
    "toponav.graph.poses.pose_graph:PoseRules",
    "toponav.graph.poses.confirmation:ConfirmRules",
    "toponav.graph.poses.moves:MoveRules",
    "toponav.graph.poses.support:SupportRules",
    "toponav.training.place_training:PlaceRules",
    "toponav.training.place_training:OffsetRules",
    "toponav.training.ground_training:GroundRules",
)
#: The words with which a row begins.
KINDS = (
    *("paper", "other work", "measured", "told", "test maze"),
    *("limit", "not compared", "no effect"),
)
#: Sizes of pieces of work, and what arithmetic, files or the room for them need.
NO_CHOICE = {
    "toponav/graph/calibration.py": {"_CHUNK", "_WIDEST", "_MOST_TRIALS"},
    "toponav/graph/consolidation.py": {"_PAIRS"},
    "toponav/graph/discovery.py": {"_BLOCK", "_ROUNDING"},
    "toponav/graph/map_file.py": {
        *("_VERSION", "_EXPANSION", "_ANY_FILE", "_LONGEST_SIDE", "_DATE"),
        "_WIDEST",
        "_ANY_ARRAY",
        "_ARRAY_EXPANSION",
        *("_GRAPH_EXPANSION", "_ANY_GRAPH", "_LARGEST_GRAPH"),
        *("_SHORTEST_ENTRY", "_WORDS"),
    },
    "toponav/graph/navigation/localiser.py": {"_AT_ONCE"},
    "toponav/graph/navigation/pose_belief.py": {"_LEAST"},
    "toponav/graph/navigation/progress.py": {"_FARTHEST"},
    "toponav/graph/poses/closures.py": {"_CHUNK"},
    "toponav/graph/poses/cover.py": {"_CHUNK", "_EVEN"},
    "toponav/graph/poses/least_squares.py": {"_ANCHOR", "_PRECISION", "_MOST_STEPS"},
    "toponav/graph/poses/moves.py": {"_LEAST"},
    "toponav/graph/views.py": {"_PIECE"},
    "toponav/graph/waypoints.py": {"_VIEWS", "_PAIRS", "_ROUNDING"},
    "toponav/training/continued_training.py": {"_ROW_EVERY"},
    "toponav/training/explorer.py": {"COVERAGE_LEVELS"},
    "toponav/training/map_growth.py": {"_POSES", "_PLACES", "_OFFSETS", "_GROUND"},
    "toponav/training/place_training.py": {"_CHUNK"},
    "toponav/training/pretraining.py": {"_VIEWS_AT_ONCE"},
    "toponav/training/recalibration.py": {"_VIEWS"},
    "toponav/training/room.py": {
        *("_MB", "_FLOAT", "_HALF", "_SMALL_MB", "_PAGES", "_ENTRIES", "_CHECKPOINTS"),
        "_LONGEST_TMPDIR",
    },
}


def table(heading: str) -> list[list[str]]:
    section = TEXT.split(f"\n## {heading}\n")[1].split("\n## ")[0]
    rows = [line for line in section.splitlines() if line.startswith("|")]
    return [[cell.strip() for cell in row.strip("|").split("|")] for row in rows[2:]]


HEADINGS = [heading for area in AREAS for heading in area] + [RIVALS, CONSTANTS]


def spans(cell: str) -> list[str]:
    return re.findall("`(.+?)`", cell)


def on_the_page(*headings: str) -> dict[str, dict[str, Any]]:
    """Settings and values of tables, by the method that they are said to be of."""
    found: dict[str, dict[str, Any]] = {}
    for heading in headings:
        for names, values, *_ in table(heading):
            method, colon, own = names.partition(":")
            known = found.setdefault(spans(method)[0] if colon else "", {})
            pairs = zip(spans(own if colon else names), spans(values), strict=True)
            for name, value in pairs:
                assert name not in known, f"{name} has two rows"
                known[name] = yaml.safe_load(value)
    return found


def leaves(node: dict[str, Any], prefix: str) -> Iterator[tuple[str, Any]]:
    for name, value in node.items():
        if isinstance(value, dict):
            yield from leaves(value, f"{prefix}{name}.")
        elif name != "defaults":
            yield prefix + name, value


def in_files(files: dict[str, str], conf: Path = CONF) -> dict[str, Any]:
    """The settings of files of ``conf/`` that need a row."""
    found: dict[str, Any] = {}
    for name, prefix in files.items():
        text = (conf / f"{name}.yaml").read_text(encoding="utf-8")
        found |= dict(leaves(yaml.safe_load(text), prefix))
    return {name: found[name] for name in found.keys() - LEFT_OUT}


def chosen(group: str) -> str:
    """The option of a group that ``conf/`` takes by default."""
    options = yaml.safe_load((CONF / CHOICES[group]).read_text())["defaults"]
    if group == "loss":
        return str(options[0])
    return str(next(one[group] for one in options if group in one))


def differences(page: dict[str, Any], conf: dict[str, Any]) -> dict[str, Any]:
    """Names that only one of both has, or whose values differ: page, then conf."""
    names = page.keys() | conf.keys()
    both = {name: (page.get(name, "-"), conf.get(name, "-")) for name in names}
    return {
        name: (one, other)
        for name, (one, other) in both.items()
        if (one, type(one)) != (other, type(other))
    }


def settings_of(area: tuple[str, ...]) -> dict[str, Any]:
    return {
        name: value
        for name, value in on_the_page(*area)[""].items()
        if name not in CHOICES
    }


@pytest.mark.parametrize("area", AREAS, ids=lambda area: area[0])
def test_every_default_has_a_row_with_its_value(area: tuple[str, ...]) -> None:
    assert differences(settings_of(area), in_files(AREAS[area])) == {}


def test_every_setting_of_a_rival_has_a_row_with_its_value() -> None:
    page = on_the_page(RIVALS)
    for group, methods in METHODS.items():
        for method in methods:
            conf = in_files({f"{group}/{method}": f"{group}."})
            assert differences(page.pop(f"{group}={method}", {}), conf) == {}, method
    assert page == {}


def test_every_method_is_on_the_page() -> None:
    names = {
        path.stem
        for group in METHODS
        for path in (CONF / group).glob("*.yaml")
        if path.stem not in ("laptop", "paper", "smoke")
    }
    assert names == {*METHODS["reward"], *METHODS["loss"], "novelty", "ppo"}


@pytest.mark.parametrize("group", CHOICES)
def test_the_default_of_each_group_has_a_row(group: str) -> None:
    tables = [on_the_page(*area)[""] for area in AREAS]
    assert [one[group] for one in tables if group in one] == [chosen(group)]


@pytest.mark.parametrize(
    ("line", "found"),
    [
        ("persistence: 99", 99),
        ("persistence: 3.0", 3.0),
        ("persistence: null", None),
        ("patience: 3", "-"),
    ],
)
def test_a_changed_default_is_seen(line: str, found: Any, tmp_path: Path) -> None:
    conf = shutil.copytree(CONF, tmp_path / "conf")
    file = conf / "reward" / "novelty.yaml"
    file.write_text(re.sub("(?m)^persistence: .*$", line, file.read_text()))
    area = next(area for area in AREAS if EXPLORING in area)
    page = settings_of(area)
    wrong = differences(page, in_files(AREAS[area], conf))
    assert wrong["reward.persistence"] == (page["reward.persistence"], found)


def value_of(module: str, name: str) -> Any:
    """A constant, or the default of an argument of a function or a class."""
    owner, _, argument = name.partition(".")
    found = getattr(import_module(module), owner)
    return inspect.signature(found).parameters[argument].default if argument else found


def module_name(path: str) -> str:
    return path.removesuffix(".py").replace("/", ".")


@pytest.mark.parametrize("row", table(CONSTANTS), ids=lambda row: row[1][:40])
def test_constants_have_the_values_of_the_page(row: list[str]) -> None:
    (path,) = spans(row[0])
    for name, value in zip(spans(row[1]), spans(row[2]), strict=True):
        assert value_of(module_name(path), name) == ast.literal_eval(value), name


def constants_on_the_page() -> dict[str, list[str]]:
    found: dict[str, list[str]] = {}
    for path, names, *_ in table(CONSTANTS):
        found.setdefault(spans(path)[0], []).extend(spans(names))
    return found


@pytest.mark.parametrize("rules", RULES)
def test_every_number_of_the_rules_has_a_row(rules: str) -> None:
    module, _, name = rules.partition(":")
    named = constants_on_the_page()[f"{module.replace('.', '/')}.py"]
    own = {one.name for one in fields(resolve_name(rules))}
    wanted = {f"{name}.{one}" for one in own - {"seed", "above", "confirm"}}
    assert {one for one in named if one.startswith(f"{name}.")} == wanted


def assigned(path: Path) -> set[str]:
    """Names in capitals that a module assigns."""
    nodes = ast.parse(path.read_text(encoding="utf-8")).body
    names = {
        one.id
        for node in nodes
        if isinstance(node, ast.Assign | ast.AnnAssign)
        for one in ast.walk(node)
        if isinstance(one, ast.Name) and isinstance(one.ctx, ast.Store)
    }
    return {name for name in names if re.fullmatch("_?[A-Z][A-Z_]*", name)}


def is_number(value: Any) -> bool:
    if isinstance(value, tuple):
        return bool(value) and all(is_number(one) for one in value)
    return isinstance(value, int | float) and not isinstance(value, bool)


def test_every_number_in_graph_and_training_has_a_row_or_is_no_choice() -> None:
    named = constants_on_the_page()
    missing = {}
    for path in (*ROOT.glob("toponav/graph/**/*.py"), *ROOT.glob("toponav/training/*")):
        if path.suffix != ".py" or path.name == "__init__.py":
            continue
        name = path.relative_to(ROOT).as_posix()
        module = import_module(module_name(name))
        numbers = {one for one in assigned(path) if is_number(getattr(module, one))}
        left_out = NO_CHOICE.get(name, set())
        assert left_out <= numbers, f"{name} has no {left_out - numbers}"
        if rest := numbers - left_out - {*named.get(name, ())}:
            missing[name] = rest
    assert missing == {}


@pytest.mark.parametrize("heading", HEADINGS)
def test_rows_say_where_their_values_come_from(heading: str) -> None:
    known = {"select", "generated", "own", "none", "then", "looked", "at"}
    known |= {"maze1", "maze2", "maze3"}
    for row in table(heading):
        assert len(row) == 4 + (heading == CONSTANTS)
        assert all(row), row
        origin, mazes = row[-2:]
        assert re.match(rf"({'|'.join(KINDS)})([:;. ]|$)", origin), origin
        assert set(re.findall(r"\w+", mazes)) <= known, mazes
        # Others decided where a test maze was only looked at.
        is_chosen_there = bool(re.match(r"maze[123](?!.*looked at)", mazes))
        assert is_chosen_there == origin.startswith("test maze"), row


def test_the_words_with_which_rows_begin_are_explained() -> None:
    section = TEXT.split("\n| word | what it means |\n")[1].split("\n\n")[0]
    assert re.findall(r"(?m)^\| \*(.+?)\* \|", section) == [*KINDS]


def test_what_was_chosen_on_a_test_maze_is_said_first() -> None:
    names = {
        name
        for heading in HEADINGS
        for row in table(heading)
        if row[-2].startswith("test maze")
        for name in spans(row[heading == CONSTANTS])
    }
    said = TEXT.split("First chosen on a test maze:")[1].split("\n## ")[0]
    assert names == set(spans(said))
