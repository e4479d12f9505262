"""Where a goal is looked for: around its views, and where it was paid."""

import pytest
import torch

from toponav.graph import GoalSearch, SearchRules

FIRST, LOOKS = torch.tensor([0]), torch.tensor([True])
GOAL = torch.tensor([[5.0, 5.0]])


def make(seed: int = 0, num_agents: int = 1, **rules: float) -> GoalSearch:
    generator = torch.Generator().manual_seed(seed)
    return GoalSearch(num_agents, SearchRules(**rules), generator)


def walk(search: GoalSearch, pose: torch.Tensor, decisions: int) -> torch.Tensor:
    """Positions ``[T, 2]`` of an agent that jumps to what it should look at."""
    found = []
    for _ in range(decisions):
        pose = torch.cat([search.aim(pose, looks=LOOKS), pose[:, 2:]], 1)
        found.append(pose[0, :2])
    return torch.stack(found)


def test_it_first_looks_where_the_views_agree() -> None:
    search = make()
    search.begin(FIRST, GOAL)
    aim = search.aim(torch.tensor([[2.0, 5.0, 0.0]]), looks=~LOOKS)
    assert (aim - GOAL).norm() < 1
    # 128 points, most of them 0.8 steps around it: the mean is 0.8 / sqrt(128) off.
    assert (search.estimate() - GOAL).norm() < 0.3


def test_it_looks_all_around_and_not_twice_at_once() -> None:
    search = make()
    search.begin(FIRST, GOAL)
    seen = walk(search, torch.tensor([[5.0, 5.0, 0.0]]), 8)
    apart = (seen[1:] - seen[:-1]).norm(dim=1)
    assert (apart > 1).all()
    gap = seen - GOAL
    # On all sides, and not far away: three deviations.
    assert (gap.amin(0) < -0.4).all()
    assert (gap.amax(0) > 0.4).all()
    assert gap.norm(dim=1).median() < 2.4


def test_where_it_was_paid_it_looks_the_next_time() -> None:
    search = make()
    search.begin(FIRST, GOAL)
    paid = torch.tensor([[9.0, 5.0]])  # four steps from where the views agree
    for _ in range(3):
        search.found(LOOKS, paid)
    search.restart(LOOKS)
    aim = search.aim(torch.tensor([[5.0, 5.0, 0.0]]), looks=~LOOKS)
    assert (aim - paid).norm() < 1
    assert (search.estimate() - paid).norm() < 1


def test_what_was_in_vain_counts_until_it_starts_again() -> None:
    search = make()
    search.begin(FIRST, GOAL)
    at = torch.tensor([[2.0, 5.0, 0.0]])
    first = search.aim(at, looks=~LOOKS)
    # It comes there and is not paid.
    search.aim(torch.cat([first, at[:, 2:]], 1), looks=LOOKS)
    assert (search.aim(at, looks=~LOOKS) - first).norm() > 0.3
    search.restart(LOOKS)
    torch.testing.assert_close(search.aim(at, looks=~LOOKS), first)


def test_it_keeps_to_a_point_and_gives_it_up_in_the_end() -> None:
    search = make()
    search.begin(FIRST, GOAL)
    stuck = torch.tensor([[2.5, 5.0, 0.0]])
    search.aim(stuck, looks=~LOOKS)
    aims = torch.cat([search.aim(stuck, looks=LOOKS) for _ in range(40)])
    changes = (aims[1:] != aims[:-1]).any(1).nonzero().flatten()
    # After 16 decisions that did not get there, and after 17 more.
    assert changes.tolist() == [15, 32]


def test_one_agent_leaves_the_others_alone() -> None:
    search = make(num_agents=2)
    both = torch.tensor([0, 1])
    search.begin(both, GOAL.expand(2, 2))
    before = search.points[1].clone(), search.estimate()[1]
    only = torch.tensor([True, False])
    search.found(only, torch.full((2, 2), 9.0))
    search.begin(FIRST, GOAL + 20)
    search.aim(torch.zeros(2, 3), looks=only)
    torch.testing.assert_close(search.points[1], before[0])
    torch.testing.assert_close(search.estimate()[1], before[1])


@pytest.mark.parametrize("name", ["search", "reach"])
def test_lengths_are_positive(name: str) -> None:
    with pytest.raises(ValueError, match=f"{name} must be above 0, got 0"):
        SearchRules(**{name: 0.0})
