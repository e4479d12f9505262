import math

import pytest
import torch
from hypothesis import given, settings, strategies as st

from tests.fakes import MAZES, WORLD, parse
from toponav.ground_truth import GroundTruthDistances, pair_truth

CELL = 128.0
U = torch.tensor([[1, 0, 1], [1, 0, 1], [1, 1, 1]], dtype=torch.bool)


def distances_in(mask):
    return GroundTruthDistances(mask, cell_size=CELL)


def floor_points(mask, num, seed):
    """Random points of the floor, a body's width off the walls."""
    generator = torch.Generator().manual_seed(seed)
    cells = mask.nonzero()
    cells = cells[torch.randint(len(cells), (num,), generator=generator)]
    offset = 0.15 + 0.7 * torch.rand(num, 2, generator=generator)
    x = cells[:, 1] + offset[:, 0]
    y = len(mask) - 1 - cells[:, 0] + offset[:, 1]
    return torch.stack([x, y], 1) * CELL


def test_path_around_a_wall_is_the_sum_of_its_legs():
    # Down the left arm, along the bottom, up the right arm of a U, cell middles:
    # gate (64, 256), then (64, 128); to the gate (128, 64) of the bottom row, on to
    # (256, 64), and up again: 64 + 128 + 64 sqrt 2 + 128 + 64 sqrt 2 + 128 + 64.
    distances = distances_in(U)
    start, end = torch.tensor([64.0, 320.0]), torch.tensor([320.0, 320.0])
    expected = 512 + 128 * math.sqrt(2)
    assert float(distances.geodesic(start, end)) == pytest.approx(expected)
    assert not distances.visible(start, end)


def test_visible_points_are_a_straight_line_apart():
    distances = distances_in(U)
    start, end = torch.tensor([10.0, 380.0]), torch.tensor([120.0, 20.0])
    expected = math.hypot(110, 360)
    assert float(distances.geodesic(start, end)) == pytest.approx(expected)


def test_line_that_cuts_a_corner_is_blocked():
    distances = distances_in(torch.tensor([[True, True], [True, False]]))
    # From the right cell to the lower one, past the corner at (128, 128).
    lower, right = torch.tensor([[64.0, 100.0]]), torch.tensor([[170.0, 192.0]])
    # At x = 128 the line is at y = 100 + 92 * 64 / 106 = 155.5: over the corner.
    assert distances.visible(lower, right)
    # With the right end 40 lower it is at 100 + 52 * 64 / 106 = 131.4: just so.
    assert distances.visible(lower, right - torch.tensor([0.0, 40.0]))
    # And from 30 lower, at 70 + 82 * 64 / 106 = 119.5: through the wall.
    below = torch.tensor([0.0, 30.0])
    assert not distances.visible(lower - below, right - torch.tensor([0.0, 40.0]))


@settings(max_examples=25, deadline=None)
@given(name=st.sampled_from(sorted(MAZES)), seed=st.integers(0, 999))
def test_distance_is_symmetric_bounded_and_zero_at_home(name, seed):
    mask, _ = parse(MAZES[name])
    distances = distances_in(mask)
    start, end = floor_points(mask, 50, seed), floor_points(mask, 50, seed + 1000)
    there, back = distances.geodesic(start, end), distances.geodesic(end, start)
    torch.testing.assert_close(there, back)
    straight = (start - end).norm(dim=-1)
    assert (there >= straight - 1e-3).all()
    assert (distances.geodesic(start, start) == 0).all()
    # Never longer than by cell middles: steps of the grid plus the two offsets.
    first, last = distances.cell_numbers(start), distances.cell_numbers(end)
    table = distances.routes.tables(torch.zeros(1, 0, dtype=torch.bool))
    steps = distances.routes.distances[table, first, last]
    assert (there <= CELL * steps + 2 * CELL * math.sqrt(0.5) + 1e-3).all()


@settings(max_examples=25, deadline=None)
@given(name=st.sampled_from(sorted(MAZES)), seed=st.integers(0, 999))
def test_sight_agrees_with_fine_steps_along_the_line(name, seed):
    mask, _ = parse(MAZES[name])
    start, end = floor_points(mask, 40, seed), floor_points(mask, 40, seed + 1000)
    share = torch.linspace(0, 1, 4001).reshape(-1, 1, 1)
    x, y = (torch.lerp(start, end, share) / CELL).floor().long().unbind(-1)
    stepped = mask[len(mask) - 1 - y, x].all(0)
    visible = distances_in(mask).visible(start, end)
    # Steps may jump over the tip of a corner, exact crossings may not.
    assert not (visible & ~stepped).any()
    assert (visible != stepped).float().mean() <= 0.05


def test_cells_without_a_path_are_infinitely_far():
    distances = distances_in(torch.tensor([[True, False, True]]))
    gap = distances.geodesic(torch.tensor([64.0, 64.0]), torch.tensor([320.0, 64.0]))
    assert gap == torch.inf


def test_all_pairs_come_from_broadcasting():
    points = floor_points(U, 7, 0)
    table = distances_in(U).geodesic(points.unsqueeze(1), points.unsqueeze(0))
    assert table.shape == (7, 7)


def test_decisions_are_steps_and_turns():
    distances = distances_in(U)
    here = torch.tensor([[64.0, 64.0]])
    there = here + torch.tensor([[66.2, 0.0]])
    truth = pair_truth(
        distances,
        (here, there),
        (torch.tensor([[350.0]]), torch.tensor([[50.0]])),
        motion=WORLD.motion,
    )
    # 66.2 / 33.1 = 2 steps and 60 / 20 = 3 turns across north: 5, or 3 at once.
    assert truth.heading_difference.tolist() == [60.0]
    assert truth.decisions.tolist() == pytest.approx([5.0])
    assert truth.least_decisions.tolist() == pytest.approx([3.0])


def test_wall_between_neighbouring_corridors_is_seen_as_such():
    tall = torch.tensor([[1, 0, 1]] * 4 + [[1, 1, 1]], dtype=torch.bool)
    left, right = torch.tensor([64.0, 576.0]), torch.tensor([320.0, 576.0])
    bottom = torch.tensor([320.0, 64.0])
    starts = torch.stack([left, right, left])
    ends = torch.stack([right, bottom, bottom])
    zeros = torch.zeros(3)
    truth = pair_truth(
        distances_in(tall), (starts, ends), (zeros, zeros), motion=WORLD.motion
    )
    # 256 straight on and over 1000 on foot; a straight corridor; too far in the plan.
    assert truth.through_wall.tolist() == [True, False, False]


@pytest.mark.parametrize("point", [[192.0, 320.0], [-1.0, 5.0], [5.0, 385.0]])
def test_points_in_walls_are_refused(point):
    with pytest.raises(ValueError, match="must lie on the maze's floor"):
        distances_in(U).geodesic(torch.tensor(point), torch.tensor([64.0, 64.0]))


def test_positions_must_fit():
    zeros = torch.zeros(2)
    with pytest.raises(ValueError, match=r"must be two of \[P, 2\]"):
        pair_truth(
            distances_in(U),
            (torch.ones(2, 2), torch.ones(3, 2)),
            (zeros, zeros),
            motion=WORLD.motion,
        )
