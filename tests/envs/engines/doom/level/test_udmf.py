"""The geometry that the engine is given."""

import pytest
from hypothesis import given, settings

from tests.envs.doom_files import blocks_of
from tests.envs.layouts import GATE, LANE, RING, drawn_layouts, random_layouts
from toponav.envs import Layout
from toponav.envs.engines.doom.level.udmf import Surfaces, slot_tag, textmap, wall_edges
from toponav.envs.engines.doom.spec import CELL_SIZE


def surfaces(layout: Layout) -> Surfaces:
    """One region, and a texture named after each edge's number."""
    walls = {edge: f"W{i}" for i, edge in enumerate(wall_edges(layout))}
    regions = dict.fromkeys(layout.cells, 0)
    return Surfaces(walls=walls, floors=["FLOOR"], regions=regions, door="DOOR")


def test_a_lane_has_eight_walls_around_one_sector() -> None:
    # Three cells in a row: 3 north, 3 south, 1 east, 1 west; 8 corners.
    text = textmap(LANE, surfaces(LANE))
    assert text.startswith('namespace = "ZDoom";\n')
    lines = blocks_of(text, "linedef")
    assert len(lines) == len(wall_edges(LANE)) == 8
    assert all(line["blocking"] == "true" for line in lines)
    assert all("sideback" not in line for line in lines)
    assert len(blocks_of(text, "vertex")) == 8
    assert len(blocks_of(text, "sector")) == 1
    textures = [side["texturemiddle"] for side in blocks_of(text, "sidedef")]
    assert textures == [f'"W{i}"' for i in range(8)]


def test_the_player_starts_in_the_first_cell() -> None:
    (thing,) = blocks_of(textmap(LANE, surfaces(LANE)), "thing")
    assert thing == {"x": "192.0", "y": "192.0", "angle": "0", "type": "1"}


def test_a_slot_is_a_sector_of_its_own_behind_two_doors() -> None:
    text = textmap(GATE, surfaces(GATE))
    assert [sector.get("id") for sector in blocks_of(text, "sector")] == [None, "1"]
    doors = [line for line in blocks_of(text, "linedef") if "sideback" in line]
    assert len(doors) == 2
    assert all(line["twosided"] == "true" for line in doors)
    sides = blocks_of(text, "sidedef")
    for door in doors:
        pair = [sides[int(door[side])] for side in ("sidefront", "sideback")]
        assert {side["sector"] for side in pair} == {"0", "1"}
        assert all(side["texturebottom"] == '"DOOR"' for side in pair)


def test_slots_are_tagged_from_one_in_the_alphabets_order() -> None:
    assert [slot_tag(RING, letter) for letter in "ab"] == [1, 2]
    with pytest.raises(ValueError, match="not in list"):
        slot_tag(RING, "c")


@settings(max_examples=60, deadline=None)
@given(layout=random_layouts() | drawn_layouts())
def test_the_room_lies_on_the_right_of_every_wall(layout: Layout) -> None:
    text = textmap(layout, surfaces(layout))
    corners = [
        (int(vertex["x"]), int(vertex["y"])) for vertex in blocks_of(text, "vertex")
    ]
    assert len(set(corners)) == len(corners)
    walls = [line for line in blocks_of(text, "linedef") if "sideback" not in line]
    assert len(walls) == len(wall_edges(layout))
    for wall in walls:
        (x0, y0), (x1, y1) = (corners[int(wall[end])] for end in ("v1", "v2"))
        # A step to the right of (dx, dy) is (dy, -dx).
        right = ((x0 + x1) / 2 + (y1 - y0) / 4, (y0 + y1) / 2 - (x1 - x0) / 4)
        left = ((x0 + x1) / 2 - (y1 - y0) / 4, (y0 + y1) / 2 + (x1 - x0) / 4)
        assert layout.open_mask[layout.cell_of(*right, CELL_SIZE)]
        assert not layout.open_mask[layout.cell_of(*left, CELL_SIZE)]


@settings(max_examples=60, deadline=None)
@given(layout=random_layouts() | drawn_layouts())
def test_every_side_and_sector_exists(layout: Layout) -> None:
    # A reference to something missing kills the engine.
    text = textmap(layout, surfaces(layout))
    sides, sectors = blocks_of(text, "sidedef"), blocks_of(text, "sector")
    used = [
        int(line[key])
        for line in blocks_of(text, "linedef")
        for key in ("sidefront", "sideback")
        if key in line
    ]
    assert sorted(used) == list(range(len(sides)))
    assert {int(side["sector"]) for side in sides} <= set(range(len(sectors)))
