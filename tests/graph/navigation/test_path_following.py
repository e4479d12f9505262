"""Where to aim on a path, and what leads there."""

import torch
from hypothesis import given, strategies as st

from toponav.graph.navigation import (
    aim_along,
    steer,
    to_the_middle,
    walking_costs,
)

# Ahead, back, left, right, and ahead and left at once.
EFFECTS = torch.tensor(
    [[1.0, 0, 0], [-1.0, 0, 0], [0, 0, 20.0], [0, 0, -20.0], [0.97, 0.2, 20.0]]
)

points = st.lists(
    st.tuples(st.floats(-20, 20), st.floats(-20, 20)), min_size=1, max_size=8
)


@given(points, st.floats(0.5, 30))
def test_the_aim_is_so_far_away_or_the_end_of_the_path(path, ahead) -> None:
    found = aim_along(torch.zeros(1, 2), torch.tensor([path]), ahead=ahead)
    if found.is_end:
        assert all(torch.tensor(point).norm() <= ahead + 1e-3 for point in path)
        torch.testing.assert_close(found.point[0], torch.tensor(path[-1]))
    else:
        assert found.point.norm() <= ahead + 1e-3
        assert torch.tensor(path[int(found.passed)]).norm() > ahead - 1e-3


def test_it_lies_on_the_leg_that_leaves_the_circle() -> None:
    path = torch.tensor([[[0.0, 2.0], [0.0, 6.0], [6.0, 6.0]]])
    found = aim_along(torch.zeros(1, 2), path, ahead=3.0)
    # From 2 to 6 steps away: at 3, a quarter of the leg.
    assert found.point.tolist() == [[0.0, 3.0]]
    assert (found.passed.item(), found.is_end.item()) == (1, False)
    # The path comes back into the circle: what is beyond is not cut off.
    path = torch.tensor([[[0.0, 9.0], [1.0, 0.0]]])
    assert aim_along(torch.zeros(1, 2), path, ahead=3.0).point.tolist() == [[0.0, 3.0]]


def test_each_agent_has_its_own_path() -> None:
    paths = torch.tensor([[[5.0, 0.0]], [[0.0, 5.0]]])
    position = torch.tensor([[0.0, 0.0], [0.0, 4.0]])
    found = aim_along(position, paths, ahead=2.0)
    assert found.point.tolist() == [[2.0, 0.0], [0.0, 5.0]]
    assert found.is_end.tolist() == [False, True]


def test_it_goes_ahead_turns_round_or_backs() -> None:
    here = torch.zeros(1, 3)

    def best(x: float, y: float) -> int:
        return int(steer(here, torch.tensor([[x, y]]), EFFECTS).argmax(1))

    assert best(3.0, 0.0) == 0
    assert best(0.0, 3.0) == 2
    assert best(0.0, -3.0) == 3
    assert best(3.0, 1.5) == 4  # 27 degrees to the left
    # What is left after an action: the steps and the turns, here after one ahead.
    left = steer(here, torch.tensor([[1.0, 2.0]]), EFFECTS)[0, 0]
    assert abs(float(left) + 2 + 90 / 20) < 1e-5


def test_an_aim_within_a_step_is_stepped_on() -> None:
    # Ahead leads 0.2 beyond it, from where it is behind: 0.2 + 0.2 * 180 / 20 = 2; a
    # turn leaves it 0.8 away and 20 degrees aside: 0.8 + 0.8 = 1.6; back, 1.8.
    left = steer(torch.zeros(1, 3), torch.tensor([[0.8, 0.0]]), EFFECTS[[0, 2]])
    torch.testing.assert_close(left, torch.tensor([[-2.0, -1.6]]))
    # At 0.9 it is 0.1 + 0.1 * 9 = 1 against 0.9 + 0.9 = 1.8.
    left = steer(torch.zeros(1, 3), torch.tensor([[0.9, 0.0]]), EFFECTS[[0, 2]])
    torch.testing.assert_close(left, torch.tensor([[-1.0, -1.8]]))


def test_headings_may_be_any_number_of_turns() -> None:
    aim = torch.tensor([[3.0, 2.0]])
    once = steer(torch.tensor([[0.0, 0.0, 10.0]]), aim, EFFECTS)
    more = steer(torch.tensor([[0.0, 0.0, 730.0]]), aim, EFFECTS)
    torch.testing.assert_close(once, more, atol=1e-4, rtol=0)


def test_what_lies_beside_a_wall_moves_away_from_it() -> None:
    # A corridor from west to east, three rows of views, the middle one at y = 0.
    x, y = torch.meshgrid(torch.arange(0.0, 20.0), torch.arange(-1.5, 2.0, 1.5))
    corridor = torch.stack([x, y], -1).reshape(-1, 2)
    found = to_the_middle(corridor, width=1.5)
    inside = (corridor[:, 0] > 5) & (corridor[:, 0] < 14)
    assert found[inside, 1].abs().max() < 0.5
    # Along the corridor nothing draws it.
    torch.testing.assert_close(found[inside, 0], corridor[inside, 0], atol=0.05, rtol=0)


def test_an_edge_costs_its_steps_and_less_the_more_often_it_was_walked() -> None:
    positions = torch.tensor([[0.0, 0.0], [6.0, 8.0], [6.0, 9.0]])
    edges = torch.tensor([[0, 1], [1, 2], [0, 2]])
    counts = torch.tensor([[1, 0], [2, 2], [0, 0]])
    # 10 + 0.3 + 1 / 1; 1 + 0.3 + 1 / 4; what was never walked counts as walked once.
    expected = torch.tensor([11.3, 1.55, 117**0.5 + 1.3])
    torch.testing.assert_close(walking_costs(positions, edges, counts), expected)
