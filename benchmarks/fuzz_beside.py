"""Damaged files beside maps for `fuzz`, and of policies, controllers and trials."""

import io
import random
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from fuzz_cases import Case, require_same, same_value, taking_little
from fuzz_damage import damage
from torch import Tensor, nn

from toponav.builders import (
    PLACES_FILE,
    POSES_FILE,
    TRIALS_FILE,
    MapNetworks,
    load_controller,
    load_new_policy,
    load_places,
    load_poses,
    load_trials,
    make_controller,
    name_contents,
    next_path,
    save_controller,
    save_places,
    save_policy,
    save_trials,
)
from toponav.graph import EdgeTrials
from toponav.graph.poses import BEARINGS, DISTANCES
from toponav.modules import GroundNetwork, OffsetNetwork, PlaceNetwork
from toponav.runs import save_atomically

#: Waypoints, numbers of an embedding, and edges of the map to which all belong.
NUM, SIZE, EDGES = 6, 8, torch.tensor([[0, 1], [1, 2], [2, 3], [0, 5]])
#: What stands in the place of tensors, and of words and numbers.
TENSORS: dict[str, Callable[[Tensor], object]] = {
    "nan": lambda one: one * torch.nan,
    "infinite": lambda one: one + torch.inf,
    "far": lambda one: one.double() + 1e300,
    "complex": lambda one: one + 0j,
    "half": lambda one: one.half(),
    "longer": lambda one: torch.cat([one, one]),
    "repeated": lambda one: one.flatten()[:1].clone().expand(one.shape),
    "huge": lambda _: torch.zeros(1, dtype=torch.int8).expand(10**6, 500),
    "sparse": lambda one: one.to_sparse(),
    "words": lambda _: ["x"] * 10**5,
}
NUMBERS = [
    *(-1, 0, 20_000, 10**6, 10**30, 10**480, 16.5, float("nan"), True, "x", "x\ny"),
    *(None, [1], {}, torch.zeros(2, 2), [torch.zeros(9)] * 10**4),
]
ARRAYS: dict[str, Callable[[], np.ndarray]] = {
    "nan": lambda: np.full((NUM, 3), np.nan, np.float32),
    "infinite": lambda: np.full((NUM, 3), np.inf),
    "far": lambda: np.full((NUM, 3), 1e300),
    "complex": lambda: np.ones((NUM, 3), np.complex64),
    "turned": lambda: np.ones((NUM, 3), ">f4"),
    "flat": lambda: np.ones(3 * NUM, np.float32),
    "short": lambda: np.ones((NUM - 1, 3), np.float32),
    "words": lambda: np.full((NUM, 3), "x"),
    "objects": lambda: np.full((NUM, 3), None),
}
Read = Callable[[], Mapping[str, Tensor]]


def places(folder: Path) -> Read:
    """``places.pt`` of a map; returns what reads its weights."""
    ground = GroundNetwork(SIZE, len(BEARINGS), len(DISTANCES), hidden=4)
    offsets = OffsetNetwork(NUM, SIZE, hidden=4)
    networks = MapNetworks(PlaceNetwork(NUM, SIZE, hidden=4), offsets, ground)
    save_places(networks, path := folder / PLACES_FILE)

    def read() -> Mapping[str, Tensor]:
        sizes = {"num_places": NUM, "embedding_size": SIZE}
        found = vars(load_places(path, **sizes, setting="run"))
        return nn.ModuleDict(found).state_dict()

    return read


def policy(folder: Path) -> Read:
    """``policy.pt``, of the smallest network that could be one."""
    make = partial(nn.LSTM, SIZE, 4)
    save_policy(folder, make().state_dict())
    return lambda: load_new_policy(folder, make, setting="run").state_dict()


def controller(folder: Path) -> Read:
    """``controller.pt`` of a practice."""
    save_controller(make_controller(SIZE, 3), folder)
    sizes = {"embedding_size": SIZE, "num_actions": 3}
    return lambda: load_controller(folder, **sizes, setting="run").state_dict()


def trials(folder: Path) -> Read:
    """``edge_trials.pt`` of a practice."""
    kept = EdgeTrials(EDGES)
    kept.add(EDGES, torch.arange(4) % 2 > 0, torch.arange(4) + 3)
    save_trials(kept, folder)
    return lambda: load_trials(folder, EDGES, setting="run").state_dict()


#: Files of `save_atomically`, and what writes each.
SAVED: dict[str, Callable[[Path], Read]] = {
    PLACES_FILE: places,
    "policy.pt": policy,
    "controller.pt": controller,
    TRIALS_FILE: trials,
}


def beside_case(number: int, draw: random.Random, work: Path) -> Case:
    """One of these files with other bytes, or whole with something else inside."""
    folder = work / f"beside-{number}"
    folder.mkdir()
    torch.manual_seed(number)
    inside = draw.random() < 0.6
    way = draw.choice(["flip", "flip", "cut", "insert", "text"])
    name = draw.choice([*sorted(SAVED), POSES_FILE])
    if name == POSES_FILE:
        read, path = write_poses(folder, checked=not inside)
    else:
        read, path = SAVED[name](folder), folder / name
    wanted = read()
    if not inside:
        damage(path, way, draw)
    elif name == POSES_FILE:
        way = replace_array(path, draw)
    else:
        way = replace_entry(path, draw)

    def run() -> None:
        with taking_little():
            found = read()
        same = all(same_value(found[name], wanted[name]) for name in wanted)
        require_same(same and not inside)

    return Case(number, name, way, run)


def write_poses(folder: Path, *, checked: bool) -> tuple[Read, Path]:
    """``map_poses.npy``, named by its map as today, or as in earlier versions not."""
    path = next_path(folder / POSES_FILE) if checked else folder / POSES_FILE
    np.save(path, np.arange(3 * NUM, dtype=np.float32).reshape(NUM, 3))
    about = name_contents(folder) if checked else {}

    def read() -> Mapping[str, Tensor]:
        found = load_poses(folder, about, num_waypoints=NUM, setting="run")
        return {"poses": found}

    return read, path


def replace_array(path: Path, draw: random.Random) -> str:
    """Another array in the place of the poses, or a header that promises too much."""
    way = draw.choice([*ARRAYS, "liar", "bracket"])
    file = io.BytesIO()
    if way == "liar":
        shape = draw.choice([(10**9, 3), (10**12, 3), (10**18, 3), (-NUM, 3)])
        about = {"descr": "<f4", "fortran_order": False, "shape": shape}
        np.lib.format.write_array_header_1_0(file, about)
        content = file.getvalue()
    elif way == "bracket":
        content = path.read_bytes().replace(b", 3)", draw.choice([b",((3", b",3L)"]))
    else:
        np.save(file, ARRAYS[way](), allow_pickle=True)
        content = file.getvalue()
    path.write_bytes(content)
    return way


def replace_entry(path: Path, draw: random.Random) -> str:
    """Something else in the place of one entry; its checksums fit."""
    state: dict[str, Any] = torch.load(path, weights_only=True)
    part, key = draw.choice(sorted(entries(state)))
    inside = state[part] if part else state
    if isinstance(inside[key], Tensor):
        bad = draw.choice(sorted(TENSORS))
        inside[key] = TENSORS[bad](inside[key])
    else:
        inside[key] = bad = draw.choice(NUMBERS)
    save_atomically(state, path)
    return f"{part} {key}={str(bad)[:40]}"


def entries(state: Mapping[str, Any]) -> list[tuple[str, str]]:
    """Where the entries of a file are: in which part, if in any, and their names."""
    return [
        place
        for key, value in state.items()
        for place in (
            [(key, inside) for inside in value]
            if isinstance(value, Mapping)
            else [("", key)]
        )
    ]
