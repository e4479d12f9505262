"""Maps and navigators that lack an entry or a part say so."""

from functools import partial

import pytest
import torch
from tensordict import TensorDict
from torch import nn

from tests.graph.grid_world import RING, GridMap, make_navigator
from tests.refused import Parts, compare, embed, refused
from toponav import graph

RULES = graph.MapRules(tc_threshold=0.9, tc_reach=0.7)
WALKING = graph.NavigatorRules(tc_reach=0.5)
KNOWN = graph.PoseMap(
    poses=torch.zeros(len(GridMap(RING).cells), 3),
    track=torch.zeros(len(GridMap(RING).cells), 2),
    effects=torch.ones(4, 3),
    places=embed,
)
PARTS: Parts = {
    "map": (
        lambda: graph.Navigator(object(), embed, compare, embed, WALKING),
        "map must be such as a TopologicalMap, got object without num_waypoints",
    ),
    "map of over": (
        lambda: graph.Navigator.over(GridMap(RING), embed),
        "map must be such as a TopologicalMap, got GridMap without embed, compare",
    ),
    "rules of a navigator": (
        lambda: graph.Navigator(GridMap(RING), embed, compare, embed, RULES),
        "rules must be such as NavigatorRules, got MapRules without hops",
    ),
    "locomotion": (
        lambda: graph.Navigator(GridMap(RING), embed, compare, 3, WALKING),
        "locomotion must be a function or a network, got int",
    ),
    "known": (
        lambda: graph.PoseNavigator(
            GridMap(RING),
            embed,
            compare,
            WALKING,
            known=object(),
            belief=graph.BeliefRules(),
        ),
        "known must be such as a PoseMap, got object without poses, track",
    ),
    "belief": (
        lambda: graph.PoseNavigator(
            GridMap(RING), embed, compare, WALKING, known=KNOWN, belief=WALKING
        ),
        "belief must be such as BeliefRules, got NavigatorRules without spread",
    ),
    "embed of a map": (
        lambda: graph.TopologicalMap("resnet18", compare, RULES),
        "embed must be a function or a network, got str",
    ),
    "rules of a map": (
        lambda: graph.TopologicalMap(embed, compare, WALKING),
        "rules must be such as MapRules, got NavigatorRules without tc_threshold",
    ),
    "views of a map": (
        lambda: graph.TopologicalMap(embed, compare, RULES, views=[]),
        "views must be such as a ViewFile, got list without read, keep",
    ),
    "walks of a map": (
        lambda: graph.TopologicalMap(embed, compare, RULES, walks=[]),
        "walks must be such as Trajectories, got list without end, all",
    ),
    "map to consolidate": (
        lambda: graph.consolidate(
            GridMap(RING), torch.ones(4, 3), None, within=1.0, above=0.5
        ),
        "topological_map must be such as a TopologicalMap, got GridMap without",
    ),
    "network of a walk": (
        lambda: graph.WalkWaypoints(torch.zeros(3, 2), nn.Linear(2, 2)),
        "network must be such as a TCNetwork, got Linear without prepare_memory",
    ),
}


def test_a_navigator_names_each_entry_that_is_missing() -> None:
    navigator = make_navigator(GridMap(RING))
    whole = TensorDict({key: torch.zeros(1, 1) for key in navigator.in_keys}, [1])
    for key in navigator.in_keys:
        assert repr(key) in refused(partial(navigator, whole.exclude(key)))


@pytest.mark.parametrize("case", PARTS)
def test_a_part_that_lacks_something_is_named(case: str) -> None:
    act, sentence = PARTS[case]
    assert sentence in refused(act)
