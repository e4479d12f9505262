"""Who may import whom: rooms meet in tensordict keys, not in imports.

The floors of the house are listed from the ground up in `FLOORS`. A room imports rooms
on lower floors, by their faces (``from toponav.graph import TopologicalMap``, not
``from toponav.graph.topological_map import ...``), and itself. Rooms inside a room have
faces too. Recipes, benchmarks and examples import any room, and nobody imports them.
"""

import ast
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parent.parent
#: From the ground up; rooms of one floor do not import each other.
FLOORS: list[set[str]] = [
    {"keys", "worlds", "views", "actions", "parts", "interrupts", "config"},
    {
        "collectors",
        "data",
        "envs",
        "graph",
        "ground_truth",
        "modules",
        "objectives",
        "transforms",
    },
    {"metrics", "policies", "runs"},
    {"plotting"},
    {"builders"},
    {"methods"},
    {"training"},
    {"reports"},
    {"refusals"},
    {"experiments"},
    {"launch"},
]
FLOOR_OF = {room: number for number, rooms in enumerate(FLOORS) for room in rooms}
#: Rooms inside a room that have a face of their own.
FACES = {
    ".".join(path.parent.relative_to(REPOSITORY / "toponav").parts)
    for path in (REPOSITORY / "toponav").glob("*/**/__init__.py")
} - set(FLOOR_OF)
#: Folders of scripts, which may import every room, and which nobody imports.
SCRIPTS = ("recipes", "benchmarks", "examples")
PACKAGE = sorted((REPOSITORY / "toponav").rglob("*.py"))
SCRIPT_FILES = [
    path for folder in SCRIPTS for path in sorted((REPOSITORY / folder).glob("*.py"))
]
SOURCES = [*PACKAGE, *SCRIPT_FILES]


def imported(source: str) -> list[tuple[int, str]]:
    """Line and full dotted name of everything that a source imports, anywhere.

    Names that a relative import leaves open start with a dot.
    """
    found = []
    for node in ast.walk(ast.parse(source)):
        if isinstance(node, ast.Import):
            found += [(node.lineno, alias.name) for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            base = "." * node.level + (node.module or "")
            found += [(node.lineno, f"{base}.{alias.name}") for alias in node.names]
    return found


def broken_rules(module: str, source: str) -> list[str]:
    """What a module's imports do wrong, one sentence each.

    Args:
        module: its dotted name, e.g. ``toponav.envs.scene`` or ``recipes.explore``.
        source: its text.
    """
    broken = []
    for line, name in imported(source):
        first, *rest = name.split(".")
        if first == "":
            broken.append(f"{module}:{line} imports relatively: {name}")
        elif first in SCRIPTS:
            broken.append(f"{module}:{line} imports a script: {name}")
        elif first != "toponav":
            continue
        elif not may_import(module, rest[0] if rest else ""):
            broken.append(f"{module}:{line} imports across the house: {name}")
        elif is_deep(module, rest):
            broken.append(f"{module}:{line} imports past a face: {name}")
    return broken


def room_of(module: str) -> str:
    return module.split(".")[1] if "." in module else ""


def may_import(module: str, other: str) -> bool:
    if module.split(".")[0] in SCRIPTS:
        return other in FLOOR_OF
    room = room_of(module)
    if room not in FLOOR_OF or other not in FLOOR_OF:
        return False
    return room == other or FLOOR_OF[other] < FLOOR_OF[room]


def is_deep(module: str, name: list[str]) -> bool:
    """Whether a name is taken from inside a room, nested or not, past its face."""
    # The last part is what is imported; what stands before it is where from.
    source = ".".join(name[:-1])
    rooms = [".".join(name[:end]) for end in range(1, len(name) - 1)]
    return source not in FACES and any(
        room in {*FLOOR_OF, *FACES} and not f"{module}.".startswith(f"toponav.{room}.")
        for room in rooms
    )


def module_name(path: Path) -> str:
    parts = path.relative_to(REPOSITORY).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@pytest.mark.parametrize("path", SOURCES, ids=module_name)
def test_every_module_imports_what_its_floor_allows(path: Path) -> None:
    assert broken_rules(module_name(path), path.read_text(encoding="utf-8")) == []


def test_all_rooms_are_looked_at() -> None:
    rooms = {module_name(path).partition(".")[2].split(".")[0] for path in PACKAGE}
    assert rooms - {""} == set(FLOOR_OF)


def test_the_scripts_and_nested_rooms_are_looked_at() -> None:
    names = {module_name(path) for path in SCRIPT_FILES}
    assert {"recipes.explore", "recipes.navigate", "benchmarks.env_speed"} <= names
    assert "examples.novelty_on_another_env" in names
    assert {"envs.engines.doom.level", "graph.navigation"} <= FACES


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("toponav.keys", "import numpy"),
        ("toponav.envs", "from toponav.envs.layout import Layout"),
        ("toponav.envs.scene", "from toponav.keys import PIXELS"),
        ("toponav.envs.scene", "from toponav import keys"),
        ("toponav.data.held_out", "import toponav.data.episodes"),
        ("toponav.config.explore", "from toponav.config.groups import MazeConfig"),
        ("toponav.builders", "from toponav.envs import MazeEnv"),
        ("toponav.launch", "from toponav import config"),
        ("toponav.graph", "from toponav.graph.navigation import Navigator"),
        ("recipes.navigate", "from toponav.methods.navigators import CHOSEN"),
        ("examples.some", "from toponav.transforms import Coverage"),
        ("toponav.envs.scene", "import recipes_of_others"),
    ],
)
def test_the_rule_allows(module: str, source: str) -> None:
    assert broken_rules(module, source) == []


@pytest.mark.parametrize(
    ("module", "source", "why"),
    [
        ("toponav.keys", "from toponav.config import x", "across"),
        ("toponav.config", "import toponav.envs", "across"),
        ("toponav.config.groups", "from toponav.keys import PIXELS", "across"),
        ("toponav.collectors.mailbox", "from toponav.transforms import x", "across"),
        ("toponav.envs.scene", "from toponav.data.pairs import x", "across"),
        ("toponav.envs.scene", "from toponav import data", "across"),
        ("toponav.envs.scene", "import toponav.modules.resnet as r", "across"),
        ("toponav.envs.scene", "from toponav.builders import make_env", "across"),
        ("toponav.envs.scene", "def f():\n    import toponav.graph", "across"),
        ("toponav.envs.scene", "import toponav", "across"),
        ("toponav", "from toponav.envs import Layout", "across"),
        ("toponav.envs.scene", "from . import layout", "relatively"),
        (
            "toponav.envs.engines.doom.level.acs",
            "from ..layout import Layout",
            "relatively",
        ),
        ("toponav.builders", "from recipes.tour import main", "script"),
        ("toponav.envs", "import recipes", "script"),
        ("benchmarks.env_speed", "from examples.some import x", "script"),
        ("toponav.graph", "from toponav.graph.navigation.plans import Plans", "past"),
        (
            "toponav.envs.engines.doom.game",
            "from toponav.envs.engines.doom.level.udmf import slot_tag",
            "past",
        ),
        ("benchmarks.env_speed", "from toponav.envs.scene import Scene", "past"),
        ("recipes.tour", "from toponav.envs.engines.doom.spec import WORLD", "past"),
    ],
)
def test_the_rule_is_seen_to_fail(module: str, source: str, why: str) -> None:
    (sentence,) = broken_rules(module, source)
    assert why in sentence
    assert sentence.startswith(f"{module}:{len(source.splitlines())} ")
