"""The file of a map: a zip archive that opens without this package.

Inside are ``graph.json`` (settings, nodes and edges in the node-link form that
networkx, D3 and others read), ``embeddings.npy``, ``prepared.npy`` and
``views/000000.png`` and so on.
"""

import io
import json
import math
import os
import zipfile
from collections.abc import Collection, Iterable, Mapping
from itertools import chain, islice
from pathlib import Path
from typing import IO, Any

import numpy as np
import torch
from torch import Tensor

from toponav.graph.views import encode_view, naming, open_view

_FORMAT, _VERSION = "toponav map", 2
_COUNTS, _SIMILARITIES = ("version", "network_version"), ("tc_threshold", "tc_reach")
_NUMBERS = (*_COUNTS, *_SIMILARITIES)
_ARRAYS = ("embeddings", "prepared")
_POSE = ("x", "y", "heading")
_EDGE = ("source", "target", "traversals", "traversals_back", "similarity")
# Bytes that a file may hold for each of its own, and of any file: what is larger was
# made to fill the memory. Most pixels along a view's side.
_EXPANSION, _ANY_FILE, _LONGEST_SIDE = 100, 64_000_000, 4096
# The same of an array, which is not compressed. Most numbers of an embedding.
_ARRAY_EXPANSION, _ANY_ARRAY, _WIDEST = 10, 64_000_000, 65_536
# The same of the graph, for each of its compressed bytes (maps have 5 to 14). Most of
# any: of a million waypoints. Bytes of an entry, which has 45 at least, and of words.
_GRAPH_EXPANSION, _ANY_GRAPH, _LARGEST_GRAPH = 60, 1_000_000, 256_000_000
_SHORTEST_ENTRY, _WORDS = 30, 1000
#: Every entry has this date, so that equal maps give equal files.
_DATE = (1980, 1, 1, 0, 0, 0)


class MapFileError(ValueError):
    """A file that is no map."""


def save_map(
    state: Mapping[str, Any],
    path: Path | str,
    *,
    about: Mapping[str, str] | None = None,
    views: Iterable[Tensor | bytes] | None = None,
) -> None:
    """Write a `TopologicalMap.state_dict` and words ``about`` it, atomically.

    ``views`` are the waypoints', if the state is without: as they are, or as PNG.
    """
    path = Path(path)
    if views is None:
        views = state["images"]
    pictures = iter(views)
    first = list(islice(pictures, 1))
    fresh = path.with_name(f".{path.stem}.{os.getpid()}{path.suffix}")
    try:
        with naming(path), fresh.open("wb") as file:
            with zipfile.ZipFile(file, "w") as archive:
                _write(archive, "graph.json", _graph(state, about or {}, first))
                for name in _ARRAYS:
                    buffer = io.BytesIO()
                    np.save(buffer, np.asarray(state[name]), allow_pickle=False)
                    _write(archive, f"{name}.npy", buffer.getvalue())
                for number, view in enumerate(chain(first, pictures)):
                    data = view if isinstance(view, bytes) else encode_view(view)
                    _write(archive, _view_name(number), data)
            file.flush()
            os.fsync(file.fileno())
        fresh.replace(path)
    finally:
        fresh.unlink(missing_ok=True)


def load_map(path: Path | str) -> tuple[dict[str, Any], dict[str, str]]:
    """Read the state and the words of a file that `save_map` wrote, exactly.

    Raises `MapFileError` if it is missing, damaged, no map or of another version.
    """
    path = Path(path)
    if not path.is_file():
        raise MapFileError(f"a map must be a file, got {path}, which is none")
    try:
        with zipfile.ZipFile(path) as archive:
            return _read(archive, path)
    except MapFileError:
        raise
    except Exception as bad:  # damage can make any of the readers fail in any way
        raise MapFileError(
            f"a map must be a file that was written completely, got the damaged {path} "
            f"({str(bad).strip()[:80]})"
        ) from bad


def _graph(
    state: Mapping[str, Any], about: Mapping[str, str], views: Collection[object]
) -> bytes:
    counts = torch.cat([state["edges"], state["traversals"]], 1).tolist()
    rows = zip(counts, state["edge_similarity"].tolist(), strict=True)
    edges = [(*row, None if math.isnan(value) else value) for row, value in rows]
    content = {
        "format": _FORMAT,
        "format_version": _VERSION,
        "directed": False,
        "multigraph": False,
        "graph": {
            **{name: state[name] for name in _NUMBERS},
            "views": len(views) > 0,
            "about": dict(about),
        },
        "nodes": _nodes(state),
        "edges": [dict(zip(_EDGE, edge, strict=True)) for edge in edges],
    }
    # One entry a line; with ``indent`` Python would encode them, ten times slower.
    return json.dumps(content, separators=(",\n", ": "), allow_nan=False).encode()


def _nodes(state: Mapping[str, Any]) -> list[dict[str, float]]:
    """A node a waypoint; ``x``, ``y``, ``heading`` are left out if not known."""
    unknown = torch.full((len(state["origins"]), 1), torch.nan)
    headings = state.get("headings", unknown[:, 0]).unsqueeze(1)
    positions = state.get("positions", unknown.expand(-1, 2))
    poses = torch.cat([positions, headings], 1).tolist()
    rows = zip(state["origins"].tolist(), poses, strict=True)
    return [
        {"id": number, "environment": env, "observation": observation}
        | {name: one for name, one in zip(_POSE, pose, strict=True) if one == one}
        for number, ((env, observation), pose) in enumerate(rows)
    ]


def _read(
    archive: zipfile.ZipFile, path: Path
) -> tuple[dict[str, Any], dict[str, str]]:
    if "graph.json" not in archive.namelist():
        raise MapFileError(f"a map must hold graph.json, got {path} without")
    room = max(_EXPANSION * path.stat().st_size, _ANY_FILE)
    _check(sum(entry.file_size for entry in archive.infolist()) <= room, "a huge entry")
    entry = archive.getinfo("graph.json")
    # A header may say what it likes.
    compressed = min(entry.compress_size, path.stat().st_size)
    fair = max(_GRAPH_EXPANSION * compressed, _ANY_GRAPH)
    _check(entry.file_size <= min(fair, _LARGEST_GRAPH), "a huge graph.json")
    data = archive.read("graph.json")
    # Of empty entries Python would make 24 times as many bytes.
    entries = data.count(b"{") + data.count(b"[")
    few = entries <= len(data) / _SHORTEST_ENTRY + _WORDS
    _check(few, "a graph.json of too many entries")
    content = json.loads(data)
    if (content.get("format"), content.get("format_version")) != (_FORMAT, _VERSION):
        raise MapFileError(
            f"a map must be of version {_VERSION}, got {path} with "
            f"{content.get('format', 'something else')} "
            f"{content.get('format_version', '')}"
        )
    nodes, edges, graph = content["nodes"], content["edges"], content["graph"]
    state = _numbers(graph)
    ids = [node["id"] for node in nodes]
    _check(ids == list(range(len(nodes))), "waypoints that are not 0, 1, 2 and so on")
    most = max(_ARRAY_EXPANSION * path.stat().st_size, _ANY_ARRAY)
    for name in _ARRAYS:
        state[name] = _array(archive, name, len(nodes), most)
    names = [_view_name(at) for at in range(len(nodes))] if graph["views"] else []
    state["images"] = _views([archive.read(name) for name in names], room)
    state["origins"] = _columns(nodes, "environment", "observation")
    poses = [[node.get(name) for name in _POSE] for node in nodes]
    known = [one for pose in poses for one in pose if one is not None]
    _check(all(abs(one) < math.inf for one in known), "no pose")
    # None becomes NaN.
    found = torch.from_numpy(np.array(poses, np.float32).reshape(-1, len(_POSE)))
    state["positions"], state["headings"] = found[:, :2], found[:, 2]
    state["edges"] = _columns(edges, *_EDGE[:2])
    ends = {frozenset(pair) for pair in state["edges"].tolist() if len(set(pair)) == 2}
    _check(len(ends) == len(edges), "an edge twice, or from a waypoint to itself")
    _check(max(map(max, ends), default=-1) < len(nodes), "an edge to no waypoint")
    state["traversals"] = _columns(edges, *_EDGE[2:4])
    values = [edge["similarity"] for edge in edges]
    # None becomes NaN.
    similarity = np.array(values, np.float32)
    known = [value for value in values if value is not None]
    _check(all(0 <= value <= 1 for value in known), "a similarity outside [0, 1]")
    state["edge_similarity"] = torch.from_numpy(similarity)
    about = graph["about"]
    words = isinstance(about, dict) and all(
        isinstance(one, str) for one in about.values()
    )
    _check(words, "words that are none")
    return state, about


def _numbers(graph: Mapping[str, Any]) -> dict[str, Any]:
    """The counts and the thresholds of a map, which are as `MapRules` has them."""
    for name in _COUNTS:
        whole = type(graph[name]) is int and 0 <= graph[name] < 2**63
        _check(whole, f"{name} that is no count")
    for name in _SIMILARITIES:
        number = type(graph[name]) in (int, float)
        _check(number and 0 <= graph[name] < 1, f"{name} that is no similarity")
    threshold, reach = (graph[name] for name in _SIMILARITIES)
    _check(reach <= threshold, "tc_reach above tc_threshold")
    _check(isinstance(graph["views"], bool), "views that are neither there nor not")
    return {name: graph[name] for name in _NUMBERS}


def _array(archive: zipfile.ZipFile, name: str, number: int, most: int) -> Tensor:
    """Finite float32 ``[W, D]`` for that ``number`` W of nodes, of ``most`` bytes.

    Its header says what it is before memory is taken for it.
    """
    entry = f"{name}.npy"
    with archive.open(entry) as file:
        shape, kind = _header(file)
    if len(shape) > 0 and shape[0] != number:
        raise ValueError(f"{number} nodes, {shape[0]} {name}")
    flat = len(shape) == 2 and 1 <= shape[1] <= _WIDEST
    size = math.prod(shape) * kind.itemsize
    held = 0 <= size <= min(most, archive.getinfo(entry).file_size)
    fits = kind == np.float32 and held and (flat or not (number or size))
    _check(fits, f"{name} of {kind} {shape}")
    with archive.open(entry) as file:
        array = np.load(file, allow_pickle=False)
    _check(np.isfinite(array).all(), f"NaN or infinity in its {name}")
    return torch.from_numpy(array)


def _header(file: IO[bytes]) -> tuple[tuple[int, ...], np.dtype[Any]]:
    """Shape and dtype of an array that `numpy.save` wrote."""
    reading = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }
    shape, _, kind = reading[np.lib.format.read_magic(file)](file)
    return shape, kind


def _views(files: list[bytes], room: int) -> Tensor:
    """Pictures of one size, uint8 ``[W, H, W, 3]``, no more than there is room for."""
    pictures = [open_view(data) for data in files]
    kinds = {(picture.size, picture.mode) for picture in pictures}
    _check(len(kinds) <= 1 and all(mode == "RGB" for _, mode in kinds), "unlike views")
    for (width, height), _ in kinds:
        fits = max(width, height) <= _LONGEST_SIDE
        _check(fits and 3 * width * height * len(files) <= room, "huge views")
    found = [np.array(picture) for picture in pictures]
    return torch.from_numpy(np.stack(found)) if found else torch.empty(0)


def _check(holds: object, given: str) -> None:
    if not holds:
        raise ValueError(given)


def _columns(rows: list[dict[str, int]], *names: str) -> Tensor:
    """Counts of whole numbers, int64 ``[N, 2]``."""
    values = [[row[name] for name in names] for row in rows]
    whole = all(type(one) is int and one >= 0 for row in values for one in row)
    _check(whole, f"{' and '.join(names)} that are no counts")
    return torch.tensor(values, dtype=torch.int64).reshape(-1, 2)


def _view_name(number: int) -> str:
    return f"views/{number:06d}.png"


def _write(archive: zipfile.ZipFile, name: str, data: bytes) -> None:
    # A PNG is compressed already, and numbers of networks hardly become shorter.
    kind = zipfile.ZIP_DEFLATED if name.endswith(".json") else zipfile.ZIP_STORED
    archive.writestr(zipfile.ZipInfo(name, _DATE), data, kind)
