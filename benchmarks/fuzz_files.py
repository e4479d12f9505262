"""Damaged files for `fuzz`: networks, checkpoints, run folders; and all the others."""

import random
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from fuzz_beside import beside_case
from fuzz_cases import Case, require_same, same_value, taking_little
from fuzz_damage import damage
from fuzz_maps import map_case, nested_map_case
from fuzz_runs import run_case
from fuzz_settings import USUAL, run_recipe

from toponav.builders import load_networks, make_networks, save_networks
from toponav.config import ModelConfig
from toponav.envs import DEFAULT_ENGINE, load_engine
from toponav.runs import reading_checkpoint, save_atomically

HEADER = {"kind": "toponav exploration", "version": 2}
WORLD = load_engine(DEFAULT_ENGINE).world
MODEL = ModelConfig(
    encoder="small",
    embedding_dim=8,
    batch_norm=True,
    share_encoder=True,
    comparator="difference",
    projection_dim=4,
    comparator_hidden=[4],
    locomotion_hidden=[4],
)
#: What stands in the place of weights.
WEIGHTS: dict[str, Callable[[torch.Tensor], object]] = {
    "sparse": lambda one: one.to_sparse(),
    "meta": lambda one: one.to("meta"),
    "complex": lambda one: one + 0j,
    "double": lambda one: one.double(),
    "huge": lambda one: torch.zeros(1).expand(10**6, 10**4),
    "longer": lambda one: torch.cat([one, one]),
    "word": lambda one: "x",
    "none": lambda one: None,
}
#: What stands in the place of a threshold, or of a size of the model.
THRESHOLDS = ["x", None, [1], float("nan"), 5.0, -0.5, {}, torch.zeros(2)]
SIZES = [
    ("comparator_hidden", [40_000, 40_000]),
    ("comparator_hidden", [1] * 100_000),
    ("comparator_hidden", "x"),
    ("locomotion_hidden", [30_000] * 3),
    ("embedding_dim", 10**9),
    ("embedding_dim", "x"),
    ("projection_dim", 10**6),
]


def file_case(number: int, draw: random.Random, work: Path) -> Case:
    """A map, a file beside it, networks, a checkpoint, or what a run left, damaged."""
    # Drawn apart: the cases of other numbers are what they were before there were any.
    beside = random.Random(f"beside {number}")
    if beside.random() < 0.3:
        return beside_case(number, beside, work)
    inside = random.Random(f"inside {number}")
    if inside.random() < 0.3:
        nested = [nested_networks_case, nested_map_case]
        return inside.choice(nested)(number, inside, work)
    of_runs = random.Random(f"of runs {number}")
    if of_runs.random() < 0.5:
        return run_case(number, of_runs, work)
    makers = [map_case, map_case, networks_case, checkpoint_case, folder_case]
    return draw.choice(makers)(number, draw, work)


def nested_networks_case(number: int, draw: random.Random, work: Path) -> Case:
    """``networks.pt`` whose checksums fit, with something else inside."""
    path = work / f"networks-{number}.pt"
    torch.manual_seed(number)
    networks = make_networks(MODEL, WORLD)
    networks.thresholds = {"tc_threshold": 0.9, "reward_threshold": 0.5}
    save_networks(networks, path)
    state: dict[str, Any] = torch.load(path, weights_only=True)
    part = draw.choice(["weights", "thresholds", "model"])
    name = draw.choice(sorted(state[part]))
    if part == "weights":
        names = sorted(key for key, one in state[part].items() if one.ndim)
        name, bad = draw.choice(names), draw.choice(sorted(WEIGHTS))
        state[part][name] = WEIGHTS[bad](state[part][name])
    else:
        bad = draw.choice(THRESHOLDS)
        if part == "model":
            name, bad = draw.choice(SIZES)
        state[part][name] = bad
    save_atomically(state, path)

    def run() -> None:
        with taking_little():
            load_networks(path)
        require_same(False)

    return Case(number, "networks.pt", f"{part} {name}={str(bad)[:40]}", run)


def networks_case(number: int, draw: random.Random, work: Path) -> Case:
    """``networks.pt`` with flipped bytes, text, or weights that are no numbers."""
    path = work / f"networks-{number}.pt"
    torch.manual_seed(number)
    networks = make_networks(MODEL, WORLD)
    way = draw.choice(["flip", "flip", "cut", "insert", "text", "nan", "entries"])
    wanted = {name: one.clone() for name, one in networks.modules.state_dict().items()}
    if way == "nan":
        values = draw.choice(list(networks.modules.parameters())).data
        place = tuple(draw.randrange(length) for length in values.shape)
        values[place] = draw.choice([np.nan, np.inf])
    save_networks(networks, path)
    if way == "entries":
        state = torch.load(path, weights_only=True)
        key = draw.choice(sorted(state))
        bad = draw.choice([None, -1, "x", [1], {}, torch.zeros(3), 10**30])
        state[key] = bad
        way = f"entries {key}={bad}"
        save_atomically(state, path)
    elif way != "nan":
        damage(path, way, draw)

    def run() -> None:
        found = load_networks(path).modules.state_dict()
        require_same(all(same_value(found[name], wanted[name]) for name in wanted))

    return Case(number, "networks.pt", way, run)


def checkpoint_case(number: int, draw: random.Random, work: Path) -> Case:
    """``checkpoint.pt`` with flipped bytes, text, or weights that are no numbers."""
    path = work / f"checkpoint-{number}.pt"
    policy = {"w": torch.arange(3000.0), "b": torch.zeros(3)}
    way = draw.choice(["flip", "flip", "cut", "insert", "text", "nan", "kind"])
    state = {**HEADER, "consumers": {"learner": {"policy": policy}}}
    if way == "nan":
        policy["b"][1] = torch.nan
    if way == "kind":
        state["version"] = draw.choice([1, 3, None, "2", torch.zeros(2)])
    save_atomically(state, path)
    if way not in ("nan", "kind"):
        damage(path, way, draw)

    def run() -> None:
        with reading_checkpoint(path, "resume", HEADER, "an exploration") as found:
            values = found["consumers"]["learner"]["policy"]
        require_same(all(same_value(values[name], policy[name]) for name in policy))

    return Case(number, "checkpoint.pt", way, run)


def folder_case(number: int, draw: random.Random, work: Path) -> Case:
    """A run folder to resume whose settings were damaged."""
    folder = work / f"resumed-{number}"
    (folder / "config").mkdir(parents=True)
    texts = {"config": "seed: 0\nmaze:\n  name: maze1\n", "overrides": "- seed=3\n"}
    for name, text in texts.items():
        (folder / f"config/{name}.yaml").write_text(text)
    file = folder / "config" / f"{draw.choice(list(texts))}.yaml"
    way = draw.choice(["flip", "cut", "insert", "text", "words", "gone"])
    if way == "words":
        words = [
            "[",
            "- {",
            "a: b: c",
            "3",
            "- =3",
            "- 7",
            "- null",
            "!!python/x 1",
            "&a",
        ]
        way = draw.choice([*words, "- - a", "seed: *a", "\t", "- seed=-1", "{1: 2}"])
        file.write_text(way)
    elif way == "gone":
        file.unlink()
    else:
        damage(file, way, draw)
    recipe = draw.choice(["explore", "pretrain"])
    words = ["scale=smoke", *USUAL[recipe], f"resume={folder}"]
    return Case(
        number,
        "run folder",
        f"{recipe} {file.stem} {way}",
        lambda: run_recipe(recipe, words),
        folder,
    )
