"""Navigators that are told the truth, and the plain one, which never is."""

import pytest
import torch
from tensordict import TensorDict

from tests.explored import Explored, navigate_settings
from toponav.builders import make_goal_places
from toponav.config import SettingsError
from toponav.keys import (
    ACTION,
    BLOCKED,
    CELL,
    GOAL_CELL,
    HEADING,
    PLACE,
    POSITION,
    PRIVILEGED,
    TARGET,
    TRUE_PLACE,
)
from toponav.methods.navigators import DIAGNOSES, make_policies
from toponav.methods.navigators.truths import TruePlace, TrueSteering, true_edges
from toponav.reports import play_policies

# The ring's cells, row by row, have four waypoints each, looking east, north, west and
# south from its middle. Actions: 0 forward, 2 left, 3 right, 4 and 5 both at once.
RING = ((1, 1), (1, 2), (1, 3), (2, 1), (2, 3), (3, 1), (3, 2), (3, 3))


def stand(explored: Explored, cell: tuple[int, int], heading: float) -> TensorDict:
    """What the truths read of an agent in the middle of a cell; its goal is (3, 3)."""
    position = torch.from_numpy(explored[1].distances.centres([cell])).float()
    return TensorDict(
        {
            POSITION: position,
            HEADING: torch.tensor([[heading]]),
            CELL: torch.tensor([cell]),
            GOAL_CELL: torch.tensor([[3, 3]]),
            BLOCKED: torch.zeros(1, 1, dtype=torch.bool),
            ACTION: torch.tensor([1]),
        },
        [1],
    )


@pytest.mark.parametrize(
    ("cell", "heading", "expected"),
    [((1, 1), 10.0, 0), ((1, 1), 350.0, 0), ((1, 2), 80.0, 5), ((2, 1), 181.0, 14)],
)
def test_the_true_place_is_near_and_looks_the_same_way(
    explored, cell, heading, expected
):
    place = TruePlace(explored[1], world=explored[0].world)
    assert place(stand(explored, cell, heading))[TRUE_PLACE].item() == expected


def test_where_a_cell_has_no_waypoint_the_nearest_on_foot_is_the_place(explored):
    knowledge, truth = explored
    # Of the map there is left what looks east in (1, 2) and in (3, 1). From (2, 1) both
    # are as far in a straight line; on foot it is two cells and one.
    few = type(truth)(truth.poses[[4, 20]], truth.layout, truth.distances)
    place = TruePlace(few, world=knowledge.world)
    assert place(stand(explored, (2, 1), 0.0))[TRUE_PLACE].item() == 1


@pytest.mark.parametrize(
    ("place", "target", "heading", "expected"),
    [
        (0, 8, 0.0, 0),  # two cells to the east, where it looks: forward
        (0, 8, 180.0, 3),  # behind it: turns on the spot, to either side
        (0, 4, 40.0, 5),  # the next cell, 40 degrees to the right: on the way
        (0, 1, 0.0, 2),  # its own cell, but to the north: turns left
        (0, -1, 270.0, 0),  # at the goal's waypoint to the goal, round the ring
        (-1, -1, 0.0, 1),  # lost: the action stays
    ],
)
def test_steering_leads_to_the_target(explored, place, target, heading, expected):
    steering = TrueSteering(explored[1], world=explored[0].world)
    data = stand(explored, (1, 1), heading)
    data[PLACE], data[TARGET] = torch.tensor([[place]]), torch.tensor([[target]])
    assert steering(data)[ACTION].item() == expected


def test_true_edges_join_what_is_a_step_or_a_turn_away(explored):
    knowledge, truth = explored
    edges, cost = true_edges(truth, world=knowledge.world)
    # In each of eight cells four turns of 90 degrees; over each of eight borders four
    # directions with the same and with both beside it: 8 * 4 + 8 * 4 * 3.
    assert len(edges) == 128
    assert (edges[:, 0] < edges[:, 1]).all()
    costs = dict(zip(map(tuple, edges.tolist()), cost.tolist(), strict=True))
    # 128 units at 33.1 a decision; 90 degrees at 20.01709; the sum of both.
    assert costs[0, 4] == pytest.approx(3.8671, abs=1e-4)
    assert costs[0, 1] == pytest.approx(4.4962, abs=1e-4)
    assert costs[0, 5] == pytest.approx(8.3633, abs=1e-4)
    assert (0, 2) not in costs  # it looks the other way
    assert (4, 16) not in costs  # two cells away, through the wall


def test_a_waypoint_beside_another_one_is_joined_with_it_alone(explored):
    knowledge, truth = explored
    # Of (1, 1) and (1, 2) what looks east, and a view three units and ten degrees off.
    poses = truth.poses[[0, 4, 0]] + torch.tensor([[0.0], [0], [1]]) * torch.tensor(
        [3.0, 0.0, 10.0]
    )
    few = type(truth)(poses, truth.layout, truth.distances)
    edges, cost = true_edges(few, world=knowledge.world)
    assert edges.tolist() == [[0, 1], [0, 2]]
    assert cost[1].item() == pytest.approx(3 / 33.1 + 10 / 20.01709)


def test_waypoints_that_are_far_apart_are_joined_by_the_cheapest_walks(explored):
    knowledge, truth = explored
    # What looks east in (1, 1), (1, 3), (3, 1) and (3, 3), the corners of the ring: two
    # cells apart on foot, 256 units, but for those across, which are four apart.
    few = type(truth)(truth.poses[[0, 8, 20, 28]], truth.layout, truth.distances)
    assert few.poses[:, 2].unique().tolist() == [0]
    edges, cost = true_edges(few, world=knowledge.world)
    assert len(edges) == 3
    assert {0, 1, 2, 3} == set(edges.flatten().tolist())
    assert [0, 3] not in edges.tolist()
    assert [1, 2] not in edges.tolist()
    assert cost.tolist() == pytest.approx([256 / 33.1] * 3)


def privileged(policy) -> set[str]:
    return {key[1] for key in policy.in_keys if key[0] == PRIVILEGED}


def test_the_navigator_beside_them_is_told_nothing(explored):
    words = ", ".join(("navigator", *DIAGNOSES))
    config = navigate_settings(None, f"evaluate.policies=[{words}]")
    policies = make_policies(config, *explored)
    assert privileged(policies["navigator"]) == set()
    assert policies["navigator"].place_key is None
    own = policies["navigator"].map
    assert own.edges is explored[0].map.edges or own.edges.equal(explored[0].map.edges)
    for name in DIAGNOSES:
        wants_pose = "place" in name or "controller" in name
        assert ("position" in privileged(policies[name])) == wants_pose, name
    mapped = policies["perfect_map"][0]
    assert mapped.map.edges.shape == (128, 2)
    assert mapped.place_key is None


def test_with_true_place_and_steering_it_walks_its_plan_to_the_end(folder, explored):
    def play(*names: str):
        words = f"evaluate.policies=[{', '.join(names)}]"
        config = navigate_settings(
            folder, words, "maze.episode_length=40", "evaluate.episodes=1"
        )
        places = make_goal_places(config, *explored)
        policies = make_policies(config, *explored)
        return [
            one.trace for one in play_policies(config, explored[1], places, policies)
        ]

    (alone,) = play("navigator")
    perfect, again = play("perfect_controller_place", "navigator")
    # Networks that were never trained take pictures for those of other places, so that
    # the plan may lead astray, but it is followed to its end.
    arrived = (perfect.place >= 0) & (perfect.place == perfect.goal_node)
    assert arrived.any(1).all()
    # What others are told leaves the navigator as it is.
    assert (alone.positions == again.positions).all()


def test_a_navigator_without_a_map_cannot_be_told_of_it(explored):
    config = navigate_settings(
        None, "navigator=random", "evaluate.policies=[perfect_place]"
    )
    with pytest.raises(SettingsError, match="perfect_place with navigator=topological"):
        make_policies(config, *explored)
