"""`map_quality`: a map judged by the truth."""

import math

import pytest
import torch

from toponav.ground_truth import GroundTruthDistances
from toponav.metrics.map_quality import covered_cells, edge_lengths, map_quality

# Two corridors of six cells, joined at their west ends by a third.
MASK = torch.tensor([[1, 1, 1, 1, 1, 1], [1, 0, 0, 0, 0, 0], [1, 1, 1, 1, 1, 1]]).bool()


@pytest.fixture(scope="module")
def distances() -> GroundTruthDistances:
    return GroundTruthDistances(MASK, cell_size=128.0)


def at(*places: tuple[int, int, float]) -> torch.Tensor:
    """Poses in the middles of cells: row, column and heading."""
    return torch.tensor(
        [[(col + 0.5) * 128, (2.5 - row) * 128, turn] for row, col, turn in places]
    )


def test_cells_with_a_waypoint_are_covered(distances) -> None:
    covered = covered_cells(distances, at((0, 0, 0), (0, 0, 90), (2, 5, 0)))
    assert covered.nonzero().flatten().tolist() == [0, 12]
    assert not covered_cells(distances, torch.zeros(0, 3)).any()


def test_an_edge_through_a_wall_is_as_long_as_the_way_around(distances) -> None:
    poses = at((0, 5, 0), (2, 5, 0), (0, 3, 0))
    lengths = edge_lengths(distances, poses, torch.tensor([[0, 1], [0, 2]]))
    # Around: at least 5 + 2 + 5 cells but for the corners; straight: 2 cells.
    assert 10 * 128 < lengths[0] < 12 * 128
    assert lengths[1] == pytest.approx(2 * 128)


def test_false_edges_are_those_that_are_far_on_foot(distances) -> None:
    poses = at((0, 2, 0), (0, 5, 0), (2, 2, 0), (0, 0, 0), (2, 0, 0))
    # 0-1 spans three cells, 0-2 a wall; 0-3 two cells; 3-4 two.
    edges = torch.tensor([[0, 1], [0, 2], [0, 3], [3, 4]])
    quality = map_quality(distances, poses, edges, torch.tensor([1.0, 3.0, 1.0, 1.0]))
    assert quality.false_edges == pytest.approx(1 / 4)
    assert quality.false_walked_edges == 0
    assert (quality.waypoints, quality.edges) == (5, 4)
    assert quality.coverage == pytest.approx(5 / 13)
    assert (quality.components, quality.largest_component) == (1, 1.0)
    # Without 0-1 its end 1 is a part of its own.
    assert quality.true_components == 2
    # Costs do not say what was walked if that is given.
    walked = torch.tensor([False, True, True, True])
    again = map_quality(distances, poses, edges, torch.ones(4), walked=walked)
    assert again.false_walked_edges == pytest.approx(1 / 3)
    # Closer than that, the edge of three cells is false as well.
    tight = map_quality(distances, poses, edges, torch.ones(4), far_cells=2.5)
    assert tight.false_edges == tight.false_walked_edges == pytest.approx(1 / 2)


def test_an_edge_is_missing_where_no_short_path_joins_close_views(distances) -> None:
    # 0, 1 and 2 lie a cell apart and look east; 3 lies on 0 and looks west.
    poses = at((0, 0, 0), (0, 1, 20), (0, 2, 350), (0, 0, 180))
    one_edge = torch.tensor([[0, 1]])
    # Close pairs: 0-1 and 1-2, from both ends; 1-2 has no path.
    quality = map_quality(distances, poses, one_edge, torch.ones(1))
    assert quality.missing_edges == pytest.approx(1 / 2)
    # By way of 3, 1-2 takes three edges: short enough for three hops, not for two.
    around = torch.tensor([[0, 1], [0, 3], [2, 3]])
    for hops, missing in ((3, 0.0), (2, 1 / 2)):
        quality = map_quality(distances, poses, around, torch.ones(3), hops=hops)
        assert quality.missing_edges == pytest.approx(missing)


def test_a_path_by_way_of_a_far_place_stretches(distances) -> None:
    # From 0 to 1, five cells: by the detour to 2 and back nine.
    poses = at((0, 0, 0), (0, 5, 0), (2, 0, 0))
    straight = map_quality(distances, poses, torch.tensor([[0, 1]]), torch.ones(1))
    assert straight.stretch == pytest.approx(1.0)
    # All paths lead over one edge of five cells.
    for far, share in ((4.0, 1.0), (6.0, 0.0)):
        one_edge = torch.tensor([[0, 1]])
        judged = map_quality(distances, poses, one_edge, torch.ones(1), far_cells=far)
        assert judged.false_paths == share
    edges, cost = torch.tensor([[0, 1], [0, 2], [1, 2]]), torch.tensor([9.0, 1.0, 1.0])
    detour = map_quality(distances, poses, edges, cost, seed=3)
    assert detour.mean_stretch > 1.05
    # A dear edge is taken if the others are dearer still.
    assert map_quality(distances, poses, edges, torch.ones(3)).stretch == 1.0


def test_parts_are_counted(distances) -> None:
    poses = at((0, 0, 0), (0, 1, 0), (2, 5, 0))
    quality = map_quality(distances, poses, torch.tensor([[0, 1]]), torch.ones(1))
    assert quality.components == 2
    assert quality.largest_component == pytest.approx(2 / 3)


def test_a_map_without_edges_or_waypoints_has_a_quality(distances) -> None:
    none = torch.zeros(0, 2, dtype=torch.int64)
    for poses in (torch.zeros(0, 3), at((0, 0, 0))):
        quality = map_quality(distances, poses, none, torch.zeros(0))
        assert quality.coverage == pytest.approx(len(poses) / 13)
        assert quality.components == len(poses)
        assert math.isnan(quality.false_edges)
        assert math.isnan(quality.missing_edges)
        assert math.isnan(quality.stretch)


@pytest.mark.parametrize(
    ("poses", "edges", "message"),
    [
        (torch.zeros(2, 2), torch.tensor([[0, 1]]), r"poses must be \[W, 3\]"),
        (at((0, 0, 0)), torch.tensor([0]), r"edges must be \[1, 2\] as edge_cost"),
        (at((1, 3, 0)), torch.tensor([[0, 0]]), "must lie on the maze's floor"),
    ],
)
def test_shapes_and_places_are_checked(distances, poses, edges, message) -> None:
    with pytest.raises(ValueError, match=message):
        map_quality(distances, poses, edges, torch.ones(1))
