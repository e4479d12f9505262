"""The first picture of a run: a random walk, and what the networks make of it."""

from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import torch
from tensordict import TensorDict

from tests.exploring import explore_settings, world_of
from toponav.builders import World
from toponav.envs.layout import Cell
from toponav.keys import HEADING, POSITION
from toponav.reports import walk_map, write_walk_map


class Nearness:
    """Compares places by how near they are; up to one apart is the same."""

    encoder = None

    def prepare_memory(self, memory: torch.Tensor) -> torch.Tensor:
        return memory

    def compare_prepared(
        self, embedding: torch.Tensor, prepared: torch.Tensor
    ) -> torch.Tensor:
        return 1 / (1 + (embedding.unsqueeze(-2) - prepared).norm(dim=-1))


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> dict[str, Any]:
    """What the picture shows."""
    drawn: dict[str, Any] = {}
    draw = walk_map.draw_topological_map

    def note(poses: Any, edges: Any, *rest: Any, **named: Any) -> Any:
        drawn.update(poses=poses, edges=edges, far=rest[1], title=named["title"])
        return draw(poses, edges, *rest, **named)

    monkeypatch.setattr(walk_map, "draw_topological_map", note)
    return drawn


def validation_of(world: World, here: Cell, there: Cell) -> Any:
    """Of a walk from one cell to another and back, four decisions in each."""
    assert world.layout is not None
    walk = [here] * 4 + [there] * 4 + [here] * 4
    place = torch.tensor([world.layout.centre(cell, 128.0) for cell in walk])
    frames = TensorDict({POSITION: place, HEADING: torch.zeros(12, 1)}, [12])
    pixels = torch.tensor(walk, dtype=torch.float32)
    held_out = SimpleNamespace(length=12, pixels=pixels, frames=frames)
    return SimpleNamespace(
        held_out=[held_out],
        networks=SimpleNamespace(tc=Nearness()),
        embed=lambda encoder, views: views * 10,
        autocast=nullcontext(),
    )


def test_it_shows_what_the_walk_covers_and_a_map_of_it(
    tmp_path: Path, drawn: dict[str, Any]
) -> None:
    world = world_of(explore_settings("maze=maze1"))
    assert world.layout is not None
    mask = torch.as_tensor(world.layout.open_mask)
    # From one cell to its neighbour on the right.
    row, column = next(
        (int(r), int(c)) for r, c in mask.nonzero() if mask[int(r), int(c) + 1]
    )
    validation = validation_of(world, (row, column), (row, column + 1))
    write_walk_map(tmp_path, validation, world, "untrained")
    assert (tmp_path / "walk.png").read_bytes().startswith(b"\x89PNG")
    # One waypoint in each cell, and an edge between them, which is a true one.
    assert drawn["poses"][:, 0].tolist() == [128 * (column + c) for c in (0.5, 1.5)]
    assert drawn["edges"].tolist() == [[0, 1]]
    assert drawn["far"].tolist() == [False]
    share = f"{2 / int(mask.sum()):.0%}"
    assert drawn["title"] == (
        f"maze1, untrained: a random walk of 12 decisions covers {share};\n"
        "2 waypoints, 0 of 1 edges of its map are false"
    )


def test_an_edge_across_a_slot_that_stays_closed_is_false(
    tmp_path: Path, drawn: dict[str, Any]
) -> None:
    for blocked, false in (("", False), ("a", True)):
        words = "maze=maze1", f"maze.blocked=[{blocked}]"
        world = world_of(explore_settings(*words))
        # From the cell to the north of slot a to that to the south.
        validation = validation_of(world, (7, 4), (9, 4))
        write_walk_map(tmp_path, validation, world, "untrained")
        assert drawn["edges"].tolist() == [[0, 1]]
        assert drawn["far"].tolist() == [false]


def test_without_a_plan_there_is_no_picture(tmp_path: Path) -> None:
    world: Any = SimpleNamespace(layout=None, spec=SimpleNamespace(has_truth=False))
    write_walk_map(tmp_path, SimpleNamespace(), world, "untrained")  # type: ignore[arg-type]
    assert list(tmp_path.iterdir()) == []
