"""Damaged maps for `fuzz`: other bytes, other arrays, other words, or too much."""

import io
import json
import random
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from fuzz_cases import Case, require_same, same_value
from fuzz_damage import damage, rewrite

from toponav.graph import load_map, save_map

#: What stands in the place of settings and words of a map.
WRONG: list[tuple[str, Any]] = [
    ("tc_threshold", 5),
    ("tc_threshold", 1.0),
    ("tc_reach", 0.95),
    ("tc_reach", True),
    ("version", 1.5),
    ("network_version", 10**30),
    ("about", {"maze": 5}),
    ("about", [["maze", "maze1"]]),
    ("views", "x"),
]


def map_state(draw: random.Random) -> dict[str, Any]:
    """A small map with views."""
    generator = torch.Generator().manual_seed(draw.randrange(2**31))
    num, edges = 6, torch.tensor([[0, 1], [1, 2], [2, 3], [0, 5]])
    return {
        "embeddings": torch.randn(num, 8, generator=generator),
        "prepared": torch.randn(num, 4, generator=generator),
        "images": torch.randint(
            0, 256, (num, 6, 5, 3), dtype=torch.uint8, generator=generator
        ),
        "origins": torch.arange(2 * num).reshape(num, 2),
        "edges": edges,
        "traversals": torch.arange(8).reshape(4, 2),
        "edge_similarity": torch.tensor([0.5, float("nan"), 1.0, 0.25]),
        "version": 4,
        "network_version": 1,
        "tc_threshold": 0.9,
        "tc_reach": 0.7,
    }


def map_case(number: int, draw: random.Random, work: Path) -> Case:
    """``map.zip`` with flipped bytes, other arrays, other words, or too much."""
    path, state = work / f"map-{number}.zip", map_state(draw)
    save_map(state, path)
    way = draw.choice(
        ["flip", "cut", "insert", "array", "array", "graph", "graph", "bomb"]
    )
    must_refuse = False
    if way == "array":
        way, must_refuse = replace_array(path, draw), True
    elif way == "graph":
        way, must_refuse = replace_graph(path, draw), True
    elif way == "bomb":
        size = draw.choice([10**8, 10**9])
        name = draw.choice(["embeddings.npy", "graph.json", "views/000000.png", "x"])
        way, must_refuse = f"bomb {name} {size}", True
        rewrite(path, {name: bytes(size)})
    else:
        damage(path, way, draw)

    def run() -> None:
        found, _ = load_map(path)
        same = all(same_value(found[name], state[name]) for name in state)
        require_same(same and not must_refuse)

    return Case(number, "map.zip", way, run)


def nested_map_case(number: int, draw: random.Random, work: Path) -> Case:
    """``map.zip`` of which one part is too wide, of no width, or no such value."""
    path = work / f"map-{number}.zip"
    save_map(map_state(draw), path)
    way = draw.choice(["wide", "no width", "value", "value", "value"])
    if way == "wide":
        width = draw.choice([70_000, 10**6, 4 * 10**6])
        buffer = io.BytesIO()
        np.lib.format.write_array_header_1_0(
            buffer, {"descr": "<f4", "fortran_order": False, "shape": (6, width)}
        )
        rewrite(path, {"embeddings.npy": buffer.getvalue() + bytes(24 * width)})
        with zipfile.ZipFile(path, "a") as archive:  # so that it is no bomb by size
            archive.writestr("x", draw.randbytes(24 * width // 50))
        way = f"embeddings {width} wide"
    elif way == "no width":
        buffer = io.BytesIO()
        np.save(buffer, np.zeros((6, 0), np.float32))
        rewrite(
            path, {f"{draw.choice(['embeddings', 'prepared'])}.npy": buffer.getvalue()}
        )
    else:
        with zipfile.ZipFile(path) as archive:
            content = json.loads(archive.read("graph.json"))
        key, bad = draw.choice(WRONG)
        content["graph"][key] = bad
        rewrite(path, {"graph.json": json.dumps(content).encode()})
        way = f"graph {key}={bad!r}"

    def run() -> None:
        load_map(path)
        require_same(False)

    return Case(number, "map.zip", way, run)


def replace_array(path: Path, draw: random.Random) -> str:
    """Another array in the place of one of the map's."""
    name = draw.choice(["embeddings", "prepared"])
    arrays: dict[str, Callable[[], np.ndarray]] = {
        "nan": lambda: np.full((6, 8), np.nan, np.float32),
        "infinite": lambda: np.full((6, 8), np.inf, np.float32),
        "complex": lambda: np.ones((6, 8), np.complex64),
        "flat": lambda: np.ones(6, np.float32),
        "deep": lambda: np.ones((6, 2, 2), np.float32),
        "short": lambda: np.ones((5, 8), np.float32),
        "double": lambda: np.ones((6, 8)),
        "words": lambda: np.array([["a"] * 8] * 6),
        "whole": lambda: np.ones((6, 8), np.int64),
        "none": lambda: np.ones((), np.float32),
        "objects": lambda: np.array([[None] * 8] * 6),
    }
    which = draw.choice([*arrays, "liar"])
    buffer = io.BytesIO()
    if which == "liar":  # its header promises far more than there is
        shape = draw.choice([(6, 10**9), (6, 10**18), (10**9, 8), (-6, 8)])
        np.lib.format.write_array_header_1_0(
            buffer, {"descr": "<f4", "fortran_order": False, "shape": shape}
        )
    else:
        np.save(buffer, arrays[which](), allow_pickle=True)
    rewrite(path, {f"{name}.npy": buffer.getvalue()})
    return f"{name} {which}"


def replace_graph(path: Path, draw: random.Random) -> str:
    """One value of ``graph.json`` by another one."""
    with zipfile.ZipFile(path) as archive:
        content = json.loads(archive.read("graph.json"))
    bad: Any = draw.choice([-1, 10**30, 1.5, "x", [], {}, True, float("nan"), 10**9])
    where = draw.choice(["nodes", "edges", "graph", "deep", "whole"])
    if where == "deep":
        data = b"[" * 100_000 + b"]" * 100_000
    else:
        key = where
        if where == "whole":
            key = draw.choice(["nodes", "edges", "graph", "format", "format_version"])
            content[key] = bad
        elif where == "graph":
            key = draw.choice(
                ["version", "network_version", "tc_threshold", "tc_reach"]
            )
            bad = -1 if bad is True or (isinstance(bad, int) and bad > 1) else bad
            content["graph"][key] = -0.5 if bad == 1.5 else bad
        else:
            row = draw.choice(content[where])
            key = draw.choice(sorted(set(row) - {"id"}))
            # Any origin is a count, and no similarity is none of these.
            row[key] = -1 if bad in (10**9, True) else bad
        where = f"{where} {key}={bad!r}"
        data = json.dumps(content).encode()
    rewrite(path, {"graph.json": data})
    return where
