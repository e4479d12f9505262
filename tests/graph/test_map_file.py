"""The file of a map: bit-equal, atomic, readable without this package."""

import functools
import io
import json
import operator
import os
import subprocess
import zipfile

import networkx
import numpy as np
import pytest
import torch
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from tests.graph.grey_world import episode, make_map
from toponav.graph import MapFileError, load_map, save_map


@pytest.fixture
def state():
    torch.manual_seed(0)
    topological_map = make_map()
    topological_map.add_episode(episode(0, 20, 60, 20, views=True))
    state = topological_map.state_dict()
    # Anything that float32 and bytes can hold.
    state["embeddings"] = torch.randn_like(state["embeddings"]) * 1e-20
    state["images"] = torch.randint(0, 256, (3, 5, 4, 3), dtype=torch.uint8)
    state["edge_similarity"] = torch.tensor([0.1, float("nan"), 1 / 3])[
        : len(state["edges"])
    ]
    return state | {"network_version": 3, "tc_threshold": 0.1 + 0.7}


def same(one, other):
    assert one.keys() == other.keys()
    for name, value in one.items():
        if isinstance(value, torch.Tensor):
            assert value.dtype == other[name].dtype, name
            assert value.shape == other[name].shape, name
            assert value.numpy().tobytes() == other[name].numpy().tobytes(), name
        else:
            assert value == other[name], name


def test_it_loads_to_the_last_bit(state, tmp_path) -> None:
    save_map(state, tmp_path / "map.zip", about={"maze": "maze1"})
    loaded, about = load_map(tmp_path / "map.zip")
    same(state, loaded)
    assert about == {"maze": "maze1"}
    make_map().load_state_dict(loaded)


def test_poses_are_kept_and_may_be_missing(state, tmp_path) -> None:
    number = len(state["origins"])
    known = torch.randn(number, 2)
    known[1] = torch.nan
    save_map(state | {"positions": known}, tmp_path / "map.zip")
    loaded, _ = load_map(tmp_path / "map.zip")
    assert torch.equal(loaded["positions"].nan_to_num(), known.nan_to_num())
    assert loaded["positions"].isnan().equal(known.isnan())
    # An earlier version wrote none, and no headings.
    for name in ("positions", "headings"):
        del state[name]
    save_map(state, tmp_path / "map.zip")
    loaded, _ = load_map(tmp_path / "map.zip")
    assert loaded["positions"].isnan().all()
    topological_map = make_map()
    topological_map.load_state_dict(state)
    assert topological_map.waypoints.poses.shape == (number, 3)
    assert topological_map.waypoints.poses.isnan().all()


def test_one_map_gives_one_file(state, tmp_path) -> None:
    for name in ("a.zip", "b.zip"):
        save_map(state, tmp_path / name)
    assert (tmp_path / "a.zip").read_bytes() == (tmp_path / "b.zip").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["a.zip", "b.zip"]


def test_a_map_without_views_and_an_empty_one_are_files_too(tmp_path) -> None:
    topological_map = make_map()
    for number in range(2):
        save_map(topological_map.state_dict(), tmp_path / f"{number}.zip")
        same(topological_map.state_dict(), load_map(tmp_path / f"{number}.zip")[0])
        topological_map.add_episode(episode(0, 50))


def test_others_read_it_without_this_package(state, tmp_path) -> None:
    save_map(state, tmp_path / "map.zip")
    with zipfile.ZipFile(tmp_path / "map.zip") as archive:
        graph = networkx.node_link_graph(
            json.loads(archive.read("graph.json")), edges="edges"
        )
        embeddings = np.load(io.BytesIO(archive.read("embeddings.npy")))
        view = np.asarray(Image.open(io.BytesIO(archive.read("views/000001.png"))))
    assert sorted(graph.edges) == [tuple(pair) for pair in state["edges"].tolist()]
    assert graph.nodes[2] == {"environment": 0, "observation": 2}
    assert (embeddings == state["embeddings"].numpy()).all()
    assert (view == state["images"][1].numpy()).all()


def test_waypoints_and_edges_are_entries_on_lines_of_their_own(state, tmp_path) -> None:
    save_map(state, tmp_path / "map.zip")
    with zipfile.ZipFile(tmp_path / "map.zip") as archive:
        lines = archive.read("graph.json").decode().splitlines()
    for name, num in (("id", 3), ("source", len(state["edges"]))):
        found = [line for line in lines if f'"{name}": ' in line]
        assert len(found) == num > 0
        assert all(line.count('": ') <= 2 for line in found[1:])


def test_a_write_that_fails_leaves_the_old_file(state, tmp_path) -> None:
    path = tmp_path / "map.zip"
    save_map(state, path)
    before = path.read_bytes()
    broken = state | {"images": state["images"].float()}
    with pytest.raises(ValueError, match=r"uint8 \[H, W, 3\], got torch.float32 \[5"):
        save_map(broken, path)
    assert path.read_bytes() == before
    assert list(tmp_path.iterdir()) == [path]


def test_the_name_changes_hands_in_one_step(state, tmp_path) -> None:
    path = tmp_path / "map.zip"
    save_map(state, path)
    before = path.read_bytes()
    with path.open("rb") as reader:
        save_map(state, path, about={"maze": "another"})
        # Who had the old file open still reads it whole.
        assert reader.read() == before
    assert path.read_bytes() != before


#: In place of the embeddings of the three waypoints.
EMBEDDINGS = {
    "nan": np.full((3, 4), np.nan, np.float32),
    "complex": np.zeros((3, 4), np.complex64),
    "one dimension": np.zeros(3, np.float32),
    "no width": np.zeros((3, 0), np.float32),
}
#: Where in ``graph.json`` something else stands, and what.
GRAPH = {
    "negative": (("edges", 0, "traversals"), -1),
    "threshold": (("graph", "tc_threshold"), 5),
    "word threshold": (("graph", "tc_threshold"), "x"),
    "true threshold": (("graph", "tc_threshold"), True),
    "reach": (("graph", "tc_reach"), 0.95),
    "version": (("graph", "version"), 1.5),
    "network": (("graph", "network_version"), 10**30),
    "about": (("graph", "about"), {"maze": 5}),
    "about list": (("graph", "about"), [["maze", "maze1"]]),
    "views": (("graph", "views"), "x"),
    "id": (("nodes", 1, "id"), 2),
}


def rewrite(path, name, content):
    """Put another content into one entry of the file."""
    with zipfile.ZipFile(path) as archive:
        entries = {entry: archive.read(entry) for entry in archive.namelist()}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        for entry, data in (entries | {name: content}).items():
            archive.writestr(entry, data)


def lying_header() -> bytes:
    """Of an array that promises far more than there is."""
    file = io.BytesIO()
    header = {"descr": "<f4", "fortran_order": False, "shape": (3, 10**9)}
    np.lib.format.write_array_header_1_0(file, header)
    return file.getvalue()


#: Which file of the map, and its bad content.
ENTRIES = {
    "bomb": ("embeddings.npy", lambda: bytes(80_000_000)),
    "liar": ("embeddings.npy", lying_header),
    # 60 kB in the file, and more than a gigabyte as Python would read it.
    "empty objects": ("graph.json", lambda: b"[" + b"{}," * 20_000_000 + b"{}]"),
    "many objects": ("graph.json", lambda: b"[" + b"{}," * 300_000 + b"{}]"),
    "deep": ("graph.json", lambda: b"[" * 100_000 + b"]" * 100_000),
}


def promise_more(path, name):
    """The header of an entry says that it has 1.1 MB, compressed."""
    data = bytearray(path.read_bytes())
    with zipfile.ZipFile(path) as archive:
        at = archive.start_dir
    while data[at + 46 : at + 46 + len(name)] != name.encode():
        at = data.index(b"PK\x01\x02", at + 4)
    data[at + 20 : at + 24] = (1_100_000).to_bytes(4, "little")
    path.write_bytes(data)


def damaged(path, how):
    data = path.read_bytes()
    if how == "empty":
        path.write_bytes(b"")
    elif how == "cut":
        path.write_bytes(data[: len(data) // 2])
    elif how == "flipped":
        middle = data.index(b"IDAT") + 8
        path.write_bytes(
            data[:middle] + bytes([data[middle] ^ 255]) + data[middle + 1 :]
        )
    elif how == "other":
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("a.txt", "hello")
    elif how == "newer":
        with zipfile.ZipFile(path, "w") as archive:
            entries = {"format": "toponav map", "format_version": 9}
            archive.writestr("graph.json", json.dumps(entries))
    elif how == "list":
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("graph.json", "[1]")
    elif how in ENTRIES:
        name, make_content = ENTRIES[how]
        rewrite(path, name, make_content())
    elif how in EMBEDDINGS:
        file = io.BytesIO()
        np.save(file, EMBEDDINGS[how])
        rewrite(path, "embeddings.npy", file.getvalue())
    elif how in GRAPH:
        (*place, name), value = GRAPH[how]
        with zipfile.ZipFile(path) as archive:
            content = json.loads(archive.read("graph.json"))
        functools.reduce(operator.getitem, place, content)[name] = value
        rewrite(path, "graph.json", json.dumps(content).encode())
    else:
        path.unlink()


@pytest.mark.parametrize(
    ("how", "message"),
    [
        ("gone", "a map must be a file, got "),
        ("empty", "got the damaged "),
        ("cut", "got the damaged "),
        ("flipped", "got the damaged "),
        ("list", "got the damaged "),
        ("bomb", "got the damaged .*a huge entry"),
        ("empty objects", "got the damaged .*a huge graph.json"),
        ("many objects", "got the damaged .*a graph.json of too many entries"),
        ("liar", "got the damaged "),
        ("deep", "got the damaged "),
        ("nan", "got the damaged .*NaN or infinity in its embeddings"),
        ("complex", "got the damaged .*embeddings of complex64"),
        ("one dimension", r"got the damaged .*embeddings of float32 \(3,\)"),
        ("no width", r"got the damaged .*embeddings of float32 \(3, 0\)"),
        ("threshold", "got the damaged .*tc_threshold that is no similarity"),
        ("word threshold", "got the damaged .*tc_threshold that is no similarity"),
        ("true threshold", "got the damaged .*tc_threshold that is no similarity"),
        ("reach", "got the damaged .*tc_reach above tc_threshold"),
        ("version", "got the damaged .*version that is no count"),
        ("network", "got the damaged .*network_version that is no count"),
        ("about", "got the damaged .*words that are none"),
        ("about list", "got the damaged .*words that are none"),
        ("views", "got the damaged "),
        ("id", "got the damaged .*waypoints that are not 0, 1, 2 and so on"),
        ("negative", "got the damaged .* traversals_back that are no counts"),
        ("other", "a map must hold graph.json, got "),
        ("newer", "a map must be of version 2, got .* with toponav map 9"),
    ],
)
def test_what_is_no_map_is_said_in_one_sentence(state, tmp_path, how, message) -> None:
    path = tmp_path / "map.zip"
    save_map(state, path)
    damaged(path, how)
    with pytest.raises(MapFileError, match=message) as caught:
        load_map(path)
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_header_that_promises_more_is_not_believed(state, tmp_path) -> None:
    path = tmp_path / "map.zip"
    save_map(state, path)
    damaged(path, "empty objects")
    promise_more(path, "graph.json")
    with pytest.raises(MapFileError, match="a huge graph"):
        load_map(path)


@pytest.mark.parametrize("width", [90_000, 40_000_000])
def test_an_array_wider_than_embeddings_is_not_read(
    state, tmp_path, monkeypatch, width
) -> None:
    path = tmp_path / "map.zip"
    save_map(state, path)
    header = io.BytesIO()
    shape = {"descr": "<f4", "fortran_order": False, "shape": (3, width)}
    np.lib.format.write_array_header_1_0(header, shape)
    rewrite(path, "embeddings.npy", header.getvalue() + bytes(12 * width))
    # Random bytes make the file so large that the array is a small part of it.
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("x", os.urandom(6_000_000))

    def read(*_: object, **__: object) -> None:
        raise AssertionError("it was read")

    monkeypatch.setattr(np, "load", read)
    with pytest.raises(MapFileError, match=rf"embeddings of float32 \(3, {width}\)"):
        load_map(path)


def test_an_array_far_larger_than_the_file_is_not_read(
    state, tmp_path, monkeypatch
) -> None:
    path = tmp_path / "map.zip"
    save_map(state, path)
    wide = np.zeros((3, 4096), np.float32)
    buffer = io.BytesIO()
    np.save(buffer, wide)
    rewrite(path, "embeddings.npy", buffer.getvalue())
    assert torch.equal(load_map(path)[0]["embeddings"], torch.from_numpy(wide))
    monkeypatch.setattr("toponav.graph.map_file._ANY_ARRAY", 10_000)
    with pytest.raises(MapFileError, match=r"embeddings of float32 \(3, 4096\)"):
        load_map(path)


@pytest.mark.parametrize("kind", ["ICO", "EPS", "BMP"])
def test_views_of_another_format_are_not_even_opened(
    state, tmp_path, monkeypatch, kind
) -> None:
    path = tmp_path / "map.zip"
    save_map(state, path)
    buffer = io.BytesIO()
    # What fits the other views, but for its format.
    options = {"sizes": [(4, 5)]} if kind == "ICO" else {}
    Image.fromarray(state["images"][0].numpy()).save(buffer, kind, **options)
    rewrite(path, "views/000000.png", buffer.getvalue())
    opened = []
    # PIL decodes an icon to open it, and starts Ghostscript to load an EPS.
    monkeypatch.setitem(Image.OPEN, kind, (lambda *_: opened.append(kind), None))
    monkeypatch.setattr(subprocess, "Popen", lambda *_, **__: opened.append("process"))
    with pytest.raises(MapFileError, match=r"got the damaged .*a view that is no PNG"):
        load_map(path)
    assert opened == []


def test_a_view_with_a_text_is_refused(state, tmp_path) -> None:
    path = tmp_path / "map.zip"
    save_map(state, path)
    text, buffer = PngInfo(), io.BytesIO()
    # A megabyte in 1 kB; with 60 of them each view took 60 MB.
    text.add_text("key", "a" * 1_000_000, zip=True)
    Image.fromarray(state["images"][0].numpy()).save(buffer, "PNG", pnginfo=text)
    rewrite(path, "views/000000.png", buffer.getvalue())
    with pytest.raises(MapFileError, match=r"damaged .*a view that holds more than"):
        load_map(path)
