"""The numbers of a world, and an engine's name, stand in the rooms of engines alone.

Others get a `WorldSpec` from the world that a run is in, or from the engine that its
settings name.
"""

import ast
from collections.abc import Iterator
from dataclasses import fields
from pathlib import Path

import pytest

from toponav.envs import DEFAULT_ENGINE, ENGINES, load_engine
from toponav.worlds import Motion, WorldSpec

ROOT = Path(__file__).parent.parent
#: What engines say of themselves, and the list of them.
ENGINE_ROOMS = ROOT / "toponav" / "envs" / "engines"
EXEMPT = {
    # Declares them, and the values of worlds that have none.
    ROOT / "toponav" / "worlds.py",
    # Measures ViZDoom itself: bare engines are the roof.
    ROOT / "benchmarks" / "env_speed.py",
}
FILES = [
    path
    for folder in ("toponav", "recipes", "benchmarks", "examples")
    for path in sorted((ROOT / folder).rglob("*.py"))
    if ENGINE_ROOMS not in path.parents and path not in EXEMPT
]
#: Words that stand for a number of a world, however they are written.
NAMES = {field.name for kind in (WorldSpec, Motion) for field in fields(kind)}
NAMES |= {"num_actions", "step_length", "turn_angle"}
SPEC = load_engine(DEFAULT_ENGINE).world


def constants(node: ast.AST | None) -> list[object]:
    """A number, or all of a tuple or list, if an expression is nothing but that."""
    try:
        value = ast.literal_eval(node) if isinstance(node, ast.expr) else None
    except ValueError:
        return []
    if isinstance(value, tuple | list):
        return [*value]
    return [value] if isinstance(value, int | float) else []


def named_values(tree: ast.AST) -> Iterator[tuple[str, ast.expr | None, int]]:
    """Name, value and line of every assignment, argument and default."""
    for node in ast.walk(tree):
        if isinstance(node, ast.keyword) and node.arg:
            yield node.arg, node.value, node.value.lineno
        elif isinstance(node, ast.Assign):
            for target in node.targets:
                yield ast.unparse(target), node.value, node.lineno
        elif isinstance(node, ast.AnnAssign):
            yield ast.unparse(node.target), node.value, node.lineno
        elif isinstance(node, ast.arguments):
            usual = node.posonlyargs + node.args
            usual = usual[len(usual) - len(node.defaults) :]
            pairs = [*zip(usual, node.defaults, strict=True)]
            pairs += [*zip(node.kwonlyargs, node.kw_defaults, strict=True)]
            yield from ((one.arg, value, one.lineno) for one, value in pairs)


def copied_numbers(source: str) -> list[str]:
    """What a source holds of a world by value, one sentence each."""
    tree, found = ast.parse(source), []
    for node in ast.walk(tree):
        if isinstance(node, ast.Constant) and node.value in ENGINES:
            found.append(f"{node.lineno} names the engine {node.value}")
        elif isinstance(node, ast.Tuple) and constants(node) == [*SPEC.view_size]:
            found.append(f"{node.lineno} has the size of a view")
        elif isinstance(node, ast.ImportFrom | ast.Import):
            names = [getattr(node, "module", None) or "", *(a.name for a in node.names)]
            if any(name.startswith("toponav.envs.engines.") for name in names):
                found.append(f"{node.lineno} imports an engine's room")
    for name, value, line in named_values(tree):
        plain = name.split(".")[-1].lower().strip("_")
        if plain in NAMES and constants(value):
            found.append(f"{line} sets {plain} to {ast.unparse(value or tree)}")
    return found


@pytest.mark.parametrize("path", FILES, ids=lambda path: str(path.relative_to(ROOT)))
def test_no_number_of_a_world_is_copied(path: Path) -> None:
    assert copied_numbers(path.read_text(encoding="utf-8")) == []


def test_the_rule_is_seen_to_fail() -> None:
    for source in (
        'def make(engine: str = "vizdoom"): ...',
        "VIEW = (120, 160)",
        "from toponav.envs.engines.doom import ENGINE",
        "distances(mask, cell_size=128.0)",
        "def make(*, goal_reward=10.0): ...",
        "self._turn = 20.0",
        'WorldSpec(view_size=(64, 64), actions=("left", "right"))',
    ):
        assert copied_numbers(source), source
    assert not copied_numbers("make(engine=config.engine, goal_reward=None)")
