"""The numbers of a world, and an engine's name, stand in the rooms of engines alone.

Others get a `WorldSpec` from the world that a run is in, or from the engine that its
settings name.
"""

import ast
import re
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
NAMES |= {"num_actions", "step", "turn", "step_length", "turn_angle", "tics"}
SPEC = load_engine(DEFAULT_ENGINE).world
assert SPEC.motion is not None
#: Numbers that are rarely anything else, wherever they stand in code or settings.
BARE = {*SPEC.view_size, SPEC.motion.cell_size, SPEC.motion.step}
#: The same numbers that are something else, by file and, in settings, by key.
ALLOWED = {
    "benchmarks/coverage.py": "128 episodes",
    "benchmarks/fault_kills.py": "128 + signal: the exit status",
    "benchmarks/map_growth.py": "120 decisions",
    "benchmarks/map_levers.py": "120 decisions",
    "benchmarks/sanity_trpo.py": "128 decisions and samples",
    "examples/curious_minigrid.py": "128 features of a layer, and decisions",
    "toponav/builders/processes.py": "120 letters of a message",
    "toponav/ground_truth/distances.py": "1/128 cell, a weight, not in map units",
    "toponav/interrupts.py": "128 + signal: the exit status",
    "toponav/launch/jobs.py": "128 + signal: the exit status",
    "toponav/methods/rewards/ex2.py": "128 pairs of an update",
    "toponav/metrics/tc_report.py": "120 degrees between two headings",
    "toponav/modules/encoders.py": "128 channels",
    "toponav/modules/pair_networks.py": "128 features of a projection",
    "toponav/modules/steering_network.py": "128 features of a layer",
    "toponav/plotting/style.py": "120 dots per inch",
    "toponav/plotting/video.py": "160: grey",
    "toponav/runs/locks.py": "128 + signal: the exit status",
    "conf/explore/laptop.yaml": "seconds between pictures and checkpoints",
    "conf/model/resnet18.yaml": "128 features of a projection",
    "conf/model/small.yaml": "128 features of a projection",
    "conf/model/tiny.yaml": "128 features of a layer",
    "conf/pretrain/laptop.yaml": "seconds between checkpoints",
    "conf/practise/laptop.yaml": "128 decisions of a rollout",
    "conf/practise/smoke.yaml": "128 decisions",
    "conf/reward/ex2.yaml": "128 pairs of an update",
    "conf/pretrain/smoke.yaml": "decisions in a batch and an episode",
    "conf/scale/smoke.yaml": "128 pairs per update",
}
SETTINGS = sorted((ROOT / "conf").rglob("*.yaml"))
_BYTES = SPEC.view_size[0] * SPEC.view_size[1] * 3


def _near(numbers: str, words: str) -> str:
    """Such a number up to two words before or after such a word."""
    gap, number = r"\W+(?:[a-z]\w*\W+){0,2}", rf"(?<![\w.])(?:{numbers})(?![\w.]\d)\b"
    return rf"{number}{gap}\b(?:{words})\b|\b(?:{words})\b{gap}{number}"


#: What comments and docstrings may not say.
SENTENCES = {
    "the size of a view": r"\b{} ?x ?{}\b|\b{} ?x ?{}\b".format(
        *SPEC.view_size, *reversed(SPEC.view_size)
    ),
    "the bytes of a view": rf"\b({round(_BYTES / 1e3)}|{round(_BYTES / 4e3)}) kB",
    "the tics of a decision": _near("4|four", "tics?"),
    "the reward of a goal": _near(f"{SPEC.goal_reward:g}|ten", "rewards?"),
    "the reward of an apple": rf"\bapples?\b.*\breward {SPEC.apple_reward:g}\b",
}


def sentences(source: str) -> list[str]:
    """What the text of a source says of a world, comments and docstrings included."""
    return [
        f"{number} says {what}"
        for number, line in enumerate(source.splitlines(), start=1)
        for what, pattern in SENTENCES.items()
        if re.search(pattern, line, re.IGNORECASE)
    ]


def names_actions(node: ast.AST) -> bool:
    """Whether it lists more actions of the engine than left and right."""
    if isinstance(node, ast.Dict):
        items = [key for key in node.keys if key is not None]
    else:
        items = node.elts if isinstance(node, ast.Tuple | ast.List | ast.Set) else []
    names = {item.value for item in items if isinstance(item, ast.Constant)}
    return len(names & {*SPEC.actions}) > 1 and names != {"left", "right"}


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
        elif isinstance(node, ast.Constant) and type(node.value) in (int, float):
            if node.value in BARE:
                found.append(f"{node.lineno} has the bare number {node.value}")
        elif names_actions(node):
            found.append(f"{getattr(node, 'lineno', 0)} names actions")
        elif isinstance(node, ast.ImportFrom | ast.Import):
            names = [getattr(node, "module", None) or "", *(a.name for a in node.names)]
            if any(name.startswith("toponav.envs.engines.") for name in names):
                found.append(f"{node.lineno} imports an engine's room")
    for name, value, line in named_values(tree):
        plain = name.split(".")[-1].lower().strip("_")
        if plain in NAMES and constants(value):
            found.append(f"{line} sets {plain} to {ast.unparse(value or tree)}")
    return found + sentences(source)


def copied_settings(source: str) -> list[str]:
    """What a YAML file holds of a world by value, one sentence each."""
    found = sentences(source)
    for number, line in enumerate(source.splitlines(), start=1):
        key, _, value = line.partition("#")[0].partition(":")
        values = {float(one) for one in re.findall(r"(?<![\w.])\d+\.?\d*\b", value)}
        if values & BARE:
            found.append(f"{number} has the bare number {value.strip()}")
        if key.strip() in NAMES - {"view_size"} and values:
            found.append(f"{number} sets {key.strip()} to {value.strip()}")
    return found


@pytest.mark.parametrize(
    "path", FILES + SETTINGS, ids=lambda path: str(path.relative_to(ROOT))
)
def test_no_number_of_a_world_is_copied(path: Path) -> None:
    look = copied_settings if path in SETTINGS else copied_numbers
    found = look(path.read_text(encoding="utf-8"))
    if str(path.relative_to(ROOT)) in ALLOWED:
        others = [text for text in found if "bare number" not in text]
        assert found, "it needs no place in ALLOWED"
        found = others
    assert found == []


def test_the_rule_is_seen_to_fail() -> None:
    for source in (
        'def make(engine: str = "vizdoom"): ...',
        "VIEW = (120, 160)",
        "from toponav.envs.engines.doom import ENGINE",
        "distances(mask, cell_size=128.0)",
        "def make(*, goal_reward=10.0): ...",
        "self._turn = 20.0",
        'WorldSpec(view_size=(64, 64), actions=("left", "right"))',
        "cells = position / 128",
        "distance = 33.1 * decisions",
        "view[:, :, :160]",
        "height = 120.0",
        'STEERED_BY = ("forward", "left", "right")',
        'EFFECTS = {"forward": 1.0, "backward": -1.0}',
        "wait()  # one decision is four engine tics",
        "# Pays a reward of 10 for each.",
        '"""Views of 120 x 160 pixels."""',
    ):
        assert copied_numbers(source), source
    for source in (
        "# Apples: reward 1 each, gone when touched.",
        "# A frame takes 58 kB, or 14 kB for halved ones.",
        "size: [120, 160]",
        "turn: 20",
        "cell: 128.0  # map units",
    ):
        assert copied_settings(source), source
    assert not copied_numbers("make(engine=config.engine, goal_reward=None)")
    assert not copied_numbers("# Rewards of 0.1 and 100, 1.5 of a reward, 40 tics")
    assert not copied_settings("episode_length: 1200  # decisions")
