"""From a layout to a WAD."""

import hashlib
import os
import subprocess
import sys

import pytest
from hypothesis import given, settings, strategies as st

from tests.envs.doom_files import blocks_of, lumps_of
from tests.envs.layouts import GATE, HALL, LANE, RING
from toponav.envs import Layout, load_maze
from toponav.envs.engines.doom.level.compile import compile_maze
from toponav.envs.engines.doom.level.udmf import wall_edges
from toponav.envs.game import Look

_DIGEST = """
import hashlib
from toponav.envs import load_maze
from toponav.envs.engines.doom.level.compile import compile_maze
from toponav.envs.game import Look
maze = compile_maze(load_maze("maze1"), Look(texture_seed=3))
print(hashlib.sha256(maze.wad).hexdigest())
"""


def textmap_of(layout: Layout, **art: float) -> str:
    lumps = dict(lumps_of(compile_maze(layout, Look(**art)).wad))
    return lumps["TEXTMAP"].decode()


def walls_of(layout: Layout, **art: float) -> list[str]:
    """Texture names of all wall edges."""
    sides = blocks_of(textmap_of(layout, **art), "sidedef")
    names = (side.get("texturemiddle", "").strip('"') for side in sides)
    return [name for name in names if name]


def num_painted(layout: Layout, paintings: float) -> int:
    walls = walls_of(layout, paintings=paintings, marks=0.0)
    return sum(name.startswith("MP") for name in walls)


def test_the_lumps_stand_in_the_engines_order() -> None:
    maze = compile_maze(LANE)
    names = [name for name, _ in lumps_of(maze.wad)]
    assert names[:5] == ["PLAYPAL", "COLORMAP", "DECORATE", "ZMAPINFO", "TX_START"]
    assert names[-4:] == [maze.map_name, "TEXTMAP", "BEHAVIOR", "ENDMAP"]
    assert [n for n in names if n.startswith("S_")] == ["S_START", "S_END"]
    assert names.index("TX_END") < names.index("S_START")
    # The engine ignores case, and takes the last of two lumps of one name.
    assert len(set(names)) == len(names)
    assert all(name == name.upper() for name in names)


def test_every_texture_that_is_used_is_there() -> None:
    # The engine draws nothing for an unknown one and says nothing.
    for layout in (RING, load_maze("maze3")):
        lumps = [name for name, _ in lumps_of(compile_maze(layout).wad)]
        art = set(lumps[lumps.index("TX_START") + 1 : lumps.index("TX_END")])
        text = textmap_of(layout)
        used = {
            value.strip('"')
            for kind in ("sidedef", "sector")
            for block in blocks_of(text, kind)
            for key, value in block.items()
            if key.startswith("texture")
        }
        assert used - {"F_SKY1"} <= art
        assert art - used <= {"MZSKY", "MZDOOR"}


def test_the_map_is_named_after_its_content() -> None:
    # A name that another file has (MAP01) would load that file's map.
    mazes = [compile_maze(layout) for layout in (LANE, HALL, RING)]
    names = {maze.map_name for maze in mazes}
    assert len(names) == 3
    assert all(len(name) == 8 and name.startswith("MZ") for name in names)
    assert (
        f"map {mazes[0].map_name} ".encode() in dict(lumps_of(mazes[0].wad))["ZMAPINFO"]
    )


@pytest.mark.slow
@pytest.mark.parametrize("hash_seed", ["0", "1"])
def test_another_process_writes_the_same_bytes(hash_seed: str) -> None:
    child = subprocess.run(
        [sys.executable, "-c", _DIGEST],
        env={**os.environ, "PYTHONHASHSEED": hash_seed},
        capture_output=True,
        text=True,
        timeout=120,
        check=True,
    )
    expected = compile_maze(load_maze("maze1"), Look(texture_seed=3)).wad
    assert child.stdout.strip() == hashlib.sha256(expected).hexdigest()


def test_the_seed_changes_the_look_and_not_the_rooms() -> None:
    first, second = (compile_maze(GATE, Look(texture_seed=seed)) for seed in (0, 1))
    assert first.wad != second.wad
    corners = [
        blocks_of(dict(lumps_of(maze.wad))["TEXTMAP"].decode(), "vertex")
        for maze in (first, second)
    ]
    assert corners[0] == corners[1]


@settings(max_examples=20, deadline=None)
@given(share=st.floats(0.0, 1.0))
def test_the_asked_share_of_edges_is_painted(share: float) -> None:
    # The hall of 3 x 3 cells has 12 edges.
    assert num_painted(HALL, share) == round(share * len(wall_edges(HALL)))


def test_a_large_maze_hangs_paintings_twice() -> None:
    # Four combs of 35 teeth, each tooth with three walls.
    comb = ["*" + " *" * 35, "*" + " " * 69 + "*"]
    layout = Layout("\n".join(["*" * 71, *comb * 4, "*" * 71]))
    edges = len(wall_edges(layout))
    assert edges > 256
    assert num_painted(layout, 1.0) == edges
    names = [
        name for name, _ in lumps_of(compile_maze(layout, Look(paintings=1.0)).wad)
    ]
    assert sum(name.startswith("MP") for name in names) == 256


@settings(max_examples=20, deadline=None)
@given(share=st.floats(0.0, 1.0))
def test_the_asked_share_of_edges_is_marked(share: float) -> None:
    walls = walls_of(HALL, paintings=0.0, marks=share)
    marked = [name for name in walls if not name.startswith("MW")]
    assert len(marked) == round(share * len(wall_edges(HALL)))
    # No two alike.
    assert len(set(marked)) == len(marked)


def test_every_marked_wall_is_another_picture() -> None:
    lumps = lumps_of(compile_maze(HALL, Look(paintings=0.0, marks=1.0)).wad)
    pictures = [content for name, content in lumps if name.startswith("N0")]
    assert len(set(pictures)) == len(pictures) == len(wall_edges(HALL))


@pytest.mark.parametrize("art", ["paintings", "marks"])
@pytest.mark.parametrize("share", [-0.01, 1.01, float("nan")])
def test_a_share_out_of_range_is_refused(art: str, share: float) -> None:
    with pytest.raises(ValueError, match=rf"{art} must lie in \[0, 1\], got {share}"):
        Look(**{art: share})
