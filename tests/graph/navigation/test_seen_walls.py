"""What a view says of the path before an agent, and how often it must say so."""

import pytest
import torch

from toponav.graph.navigation.seen_walls import SeenWalls, closed_ahead
from toponav.graph.poses import spots

EAST = torch.zeros(1, 3)
STRAIGHT = torch.tensor([[[2.0, 0.0], [9.0, 0.0]]])


def chance(is_free, pose=EAST) -> torch.Tensor:
    """What a view from ``pose`` says where ``is_free`` is the truth, by x and y."""
    x, y = spots(pose).unbind(3)
    return torch.where(is_free(x, y), 0.9, 0.05)


def wall_at(east):
    """A corridor of three steps, which ends at ``east``."""
    return lambda x, y: (y.abs() < 1.5) & (x < east)


@pytest.mark.parametrize(
    ("east", "closed"),
    # Points of the path are 2, 3, 4 and 5 steps ahead. Free spots are at half steps, and
    # the nearest point with none within 1.2 steps is closed; a step is added.
    [(0.9, 3.0), (1.9, 4.0), (3.7, 6.0), (4.5, None), (9.0, None)],
)
def test_a_wall_across_the_path_is_seen(east, closed) -> None:
    seen = closed_ahead(EAST, STRAIGHT, chance(wall_at(east)))
    if closed is None:
        assert seen.isnan().all()
    else:
        assert seen.tolist() == pytest.approx(torch.tensor([[closed, 0.0]]))


def test_a_path_round_a_corner_is_free() -> None:
    path = torch.tensor([[[2.0, 0.0], [2.0, 6.0]]])

    def ahead(x, y):
        return (y.abs() < 1) & (x < 3)

    def corner(x, y):
        return ahead(x, y) | (((x - 2).abs() < 1) & (y > 0))

    assert closed_ahead(EAST, path, chance(corner)).isnan().all()
    # Without the corridor to the left the point four steps away is closed, at (2, 12 **
    # 0.5), and the one three steps away is 1.24 steps from the last free spots.
    seen = closed_ahead(EAST, path, chance(ahead))
    x, y = seen[0].tolist()
    assert 2 * 5 / 4 - 0.3 < x < 2 * 5 / 4 + 0.3
    assert 2.5 < y < 5.5


def test_what_is_beside_or_behind_the_view_is_not_seen() -> None:
    nothing = torch.zeros(1, 13, 12)
    for degrees, is_seen in ((0, True), (70, True), (80, False), (180, False)):
        pose = torch.tensor([[0.0, 0.0, degrees]])
        assert closed_ahead(pose, STRAIGHT, nothing).isfinite().all() == is_seen
    # A path that ends after one step leads nowhere that could be closed.
    short = torch.tensor([[[0.5, 0.0], [1.0, 0.0]]])
    assert closed_ahead(EAST, short, nothing).isnan().all()


def test_a_place_must_be_seen_several_times() -> None:
    walls = SeenWalls(2, sightings=3)
    pose, path = EAST.expand(2, 3), STRAIGHT.expand(2, 2, 2)
    both = torch.cat([chance(wall_at(1.9)), chance(wall_at(9.0))])
    for _ in range(2):
        assert walls.look(pose, path, both).isnan().all()
    # Free once, which does not matter, and then a third time of the first agent alone.
    assert walls.look(pose, path, both.flip(0)).isnan().all()
    assert walls.look(pose, path, both)[0].tolist() == pytest.approx([4.0, 0.0])
    walls.forget(torch.tensor([True, False]))
    assert walls.look(pose, path, both).isnan().all()


def test_other_places_and_long_ago_do_not_count() -> None:
    walls = SeenWalls(1, sightings=2)
    for east in (1.0, 3.7, 9.0, 9.0, 9.0, 9.0, 9.0, 9.0, 9.0, 9.0, 1.0):
        found = walls.look(EAST, STRAIGHT, chance(wall_at(east)))
        assert found.isnan().all()
    assert walls.look(EAST, STRAIGHT, chance(wall_at(1.0))).isfinite().all()


@pytest.mark.parametrize("number", [0, 11])
def test_the_number_of_sightings_is_checked(number) -> None:
    with pytest.raises(ValueError, match=f"must be 1 to 10, got {number}"):
        SeenWalls(1, sightings=number)
