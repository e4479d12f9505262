"""Who may import whom: rooms meet in tensordict keys, not in imports.

Floor 0 (``keys``, ``config``) imports nothing of ours but itself, a room on floor 1
only floor 0 and itself, floor 2 (``builders``, ``launch``) everything below. Nobody
imports a recipe.
"""

import ast
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parent.parent
FLOOR_0 = {"keys", "config"}
FLOOR_2 = {"builders", "launch"}
SOURCES = sorted((REPOSITORY / "toponav").rglob("*.py"))


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
        module: its dotted name, e.g. ``toponav.envs.scene``.
        source: its text.
    """
    room = module.split(".")[1] if "." in module else ""
    broken = []
    for line, name in imported(source):
        first, *rest = name.split(".")
        if first == "":
            broken.append(f"{module}:{line} imports relatively: {name}")
        elif first == "recipes":
            broken.append(f"{module}:{line} imports a recipe: {name}")
        elif first == "toponav" and not may_import(room, rest[0] if rest else ""):
            broken.append(f"{module}:{line} imports across the house: {name}")
    return broken


def may_import(room: str, other: str) -> bool:
    if room in FLOOR_0:
        return other == room
    if room in FLOOR_2:
        return other != ""
    return other in FLOOR_0 or (other == room and room != "")


def module_name(path: Path) -> str:
    parts = path.relative_to(REPOSITORY).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@pytest.mark.parametrize("path", SOURCES, ids=module_name)
def test_every_module_imports_what_its_floor_allows(path: Path) -> None:
    assert broken_rules(module_name(path), path.read_text(encoding="utf-8")) == []


def test_all_rooms_are_looked_at() -> None:
    rooms = {module_name(path).partition(".")[2].split(".")[0] for path in SOURCES}
    assert {"keys", "envs", "transforms", "modules", "objectives", "data"} <= rooms
    assert {"collectors", "config", "evaluation", "graph", "builders"} <= rooms


@pytest.mark.parametrize(
    ("module", "source"),
    [
        ("toponav.keys", "import numpy"),
        ("toponav.envs", "from toponav.envs.layout import Layout"),
        ("toponav.envs.scene", "from toponav.keys import PIXELS"),
        ("toponav.envs.scene", "from toponav import keys"),
        ("toponav.data.pairs", "import toponav.data.chunks"),
        ("toponav.config.tour", "from toponav.config.maze import MazeConfig"),
        ("toponav.builders", "from toponav.envs import DoomMazeEnv"),
        ("toponav.launch", "from toponav import config"),
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
        ("toponav.config.maze", "from toponav.keys import PIXELS", "across"),
        ("toponav.collectors.mailbox", "from toponav.transforms import x", "across"),
        ("toponav.envs.scene", "from toponav.data.pairs import x", "across"),
        ("toponav.envs.scene", "from toponav import data", "across"),
        ("toponav.envs.scene", "import toponav.modules.resnet as r", "across"),
        ("toponav.envs.scene", "from toponav.builders import make_env", "across"),
        ("toponav.envs.scene", "def f():\n    import toponav.graph", "across"),
        ("toponav.envs.scene", "import toponav", "across"),
        ("toponav", "from toponav.envs import Layout", "across"),
        ("toponav.envs.scene", "from . import layout", "relatively"),
        ("toponav.envs.doom.acs", "from ..layout import Layout", "relatively"),
        ("toponav.builders", "from recipes.tour import main", "recipe"),
        ("toponav.envs", "import recipes", "recipe"),
    ],
)
def test_the_rule_is_seen_to_fail(module: str, source: str, why: str) -> None:
    (sentence,) = broken_rules(module, source)
    assert why in sentence
    assert sentence.startswith(f"{module}:{len(source.splitlines())} ")
