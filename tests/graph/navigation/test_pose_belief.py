"""What an agent believes of its pose, by its actions and views."""

import pytest
import torch

from toponav.graph import BeliefRules, PoseBelief

# Ahead, to the left, and nothing.
EFFECTS = torch.tensor([[1.0, 0.0, 0.0], [0.0, 0.0, 20.0], [0.0, 0.0, 0.0]])
# A corridor to the east: a waypoint every two steps, from 0 to 18; those at 4 and 14
# look alike.
WAYPOINTS = torch.tensor([[2.0 * number, 0.0, 0.0] for number in range(10)])
ALIKE = (2, 7)


def make(num_agents=1, seed=0, **rules):
    generator = torch.Generator().manual_seed(seed)
    return PoseBelief(WAYPOINTS, EFFECTS, BeliefRules(**rules), num_agents, generator)


def see(*waypoints: int) -> torch.Tensor:
    """Chances by views at these waypoints, one agent each."""
    chance = torch.full((len(waypoints), len(WAYPOINTS)), 1e-3)
    for agent, waypoint in enumerate(waypoints):
        for one in ALIKE if waypoint in ALIKE else (waypoint,):
            chance[agent, one] = 1.0
    return chance / chance.sum(1, keepdim=True)


def act(*actions: int) -> torch.Tensor:
    return torch.tensor(actions)


def test_one_view_says_where_it_is() -> None:
    belief = make()
    belief.update(act(0), see(5))
    x, y, heading = belief.estimate()[0].tolist()
    assert abs(x - 10) < 1.5
    assert abs(y) < 1.5
    assert abs(heading) < 20


def test_places_that_look_alike_are_told_apart_by_the_way_there() -> None:
    for start, wanted in ((0, 4.0), (5, 14.0)):
        belief = make(seed=start)
        for step in range(5):
            waypoint = (2 * start + step + 1) // 2
            belief.update(act(0), see(waypoint))
        assert abs(belief.estimate()[0, 0].item() - wanted) < 1.5


def test_turns_are_followed_without_a_view_that_says_anything() -> None:
    belief = make(lost=0.0)
    belief.update(act(0), see(5))
    before = belief.estimate()[0]
    anything = torch.full((1, len(WAYPOINTS)), 0.1)
    for _ in range(18):
        belief.update(act(1), anything)
    turned = belief.estimate()[0, 2] - before[2]
    assert abs((turned.item() - 360 + 180) % 360 - 180) < 20


# Of 20 poses a share of 0.02 is less than half of one.
@pytest.mark.parametrize("poses", [200, 20])
def test_an_agent_that_was_carried_away_finds_itself_again(poses) -> None:
    belief = make(poses=poses)
    for _ in range(5):
        belief.update(act(2), see(1))
    for _ in range(15):
        belief.update(act(2), see(8))
    # It did nothing, and yet it is at 16.
    assert abs(belief.estimate()[0, 0].item() - 16) < 2
    # Nearly all of its poses are there, not those alone that were drawn again.
    assert ((belief.poses[0, :, 0] - 16).abs() < 3).float().mean() > 0.9


def test_without_a_floor_a_view_may_speak_for_no_pose() -> None:
    belief = make(poses=20, floor=0.0, lost=0.0, spread=0.3)
    belief.update(act(2), see(1))
    nowhere_near = torch.eye(len(WAYPOINTS))[9:]
    belief.update(act(2), nowhere_near)
    assert belief.poses.isfinite().all()
    assert (belief.poses[0, :, 0] - 2).abs().max() < 6


def test_one_that_forgets_leaves_the_others_alone() -> None:
    belief = make(2)
    for _ in range(6):
        belief.update(act(1, 1), see(1, 1))
    belief.forget(torch.tensor([True, False]))
    belief.update(act(1, 1), see(8, 8))
    first, second = belief.estimate()[:, 0].tolist()
    assert abs(first - 16) < 2
    assert abs(second - 2) < 2


def test_the_mean_of_headings_goes_round() -> None:
    belief = make()
    belief.poses = torch.zeros(1, belief.rules.poses, 3)
    belief.poses[..., 2] = torch.tensor([359.0, 1.0]).repeat(belief.rules.poses // 2)
    heading = belief.estimate()[0, 2].item()
    assert abs((heading + 180) % 360 - 180) < 0.1


def test_a_seed_repeats_it() -> None:
    found = []
    for _ in range(2):
        belief = make(seed=3)
        for waypoint in (1, 2, 2, 3):
            belief.update(act(0), see(waypoint))
        found.append(belief.poses)
    assert torch.equal(*found)


@pytest.mark.parametrize(
    ("name", "value"),
    [("lost", 1.5), ("floor", -0.1), ("power", 2), ("stopped", 3), ("poses", 0)],
)
def test_a_bad_rule_is_one_sentence(name, value) -> None:
    with pytest.raises(ValueError, match=rf"^{name} must be .*, got {value}$"):
        BeliefRules(**{name: value})
    with pytest.raises(ValueError, match="spread must be above 0, got 0"):
        BeliefRules(spread=0)


def test_a_view_may_be_beside_the_waypoint_that_it_is_near() -> None:
    # Two steps to the north of the waypoint at 10, and turned by 40 degrees.
    offsets = torch.zeros(1, len(WAYPOINTS), 3)
    offsets[0, 5] = torch.tensor([0.0, 2.0, 40.0])
    plain, beside = make(), make()
    for _ in range(5):
        plain.update(act(2), see(5))
        beside.update(act(2), see(5), offsets)
    assert plain.estimate()[0, 1].item() == pytest.approx(0, abs=0.7)
    assert beside.estimate()[0, 1].item() == pytest.approx(2, abs=0.7)
    assert beside.estimate()[0, 2].item() % 360 == pytest.approx(40, abs=8)
