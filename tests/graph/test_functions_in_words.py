"""Maps and navigators name what they are given and that is not what they need."""

from functools import partial

import pytest
import torch
from tensordict import TensorDict
from torch import Tensor

from tests.graph.grey_world import episode, make_map
from tests.graph.grid_world import GridMap, as_view, compare, embed, locomotion
from tests.refused import refused
from toponav import graph, keys


def reading(agents: int = 3, **other: Tensor) -> TensorDict:
    """What a navigator reads of agents at a square, each with two goal views."""
    entries = {
        keys.PIXELS: as_view(torch.tensor([1, 1])).expand(agents, 1, 1, 3),
        keys.GOAL_VIEWS: as_view(torch.tensor([1, 5])).expand(agents, 2, 1, 1, 3),
        keys.IS_INIT: torch.ones(agents, 1, dtype=torch.bool),
    }
    return TensorDict(entries | other, [agents])


def navigate(data: TensorDict | None = None, **functions: object) -> Tensor:
    given = {"embed": embed, "compare": compare, "locomotion": locomotion} | functions
    rules = graph.NavigatorRules(tc_reach=0.4)
    navigator = graph.Navigator(GridMap(("###", "#.#", "###")), rules=rules, **given)
    found = navigator(reading() if data is None else data)
    return found["action"]


def test_a_navigator_names_the_function_that_returns_something_else() -> None:
    assert navigate().shape == (3,)
    said = refused(lambda: navigate(embed=lambda views: views.float()))
    assert "embed must return [N, D], got [3, 1, 1, 3] for N = 3 and D = 2" in said
    said = refused(lambda: navigate(embed=lambda views: views.flatten(1).float()))
    assert "embed must return [N, D], got [3, 3] for N = 3 and D = 2" in said
    said = refused(lambda: navigate(compare=lambda one, many: one[:, 0]))
    assert "compare must return [N, M], got [6]" in said
    said = refused(lambda: navigate(locomotion=lambda here, there: here[:, 0]))
    assert "locomotion must return [N, A], got [3] for N = 3" in said
    said = refused(lambda: navigate(locomotion=lambda here, there: None))
    assert "got NoneType for N = 3" in said


@pytest.mark.parametrize(
    "shape", [(3, 1, 1, 3), (3, 2, 3, 1, 1), (3, 2, 2, 2, 4)], ids=str
)
def test_a_navigator_refuses_goal_views_unlike_its_views(shape) -> None:
    goals = torch.zeros(shape, dtype=torch.uint8)
    said = refused(lambda: navigate(reading(goal_views=goals)))
    assert "'goal_views' must be V views of each agent, [*B, V, 1, 1, 3], got" in said
    assert str(list(shape[1:]))[1:] in said


def test_a_pose_navigator_names_its_place_network() -> None:
    known = GridMap(("###", "#.#", "###"))
    navigator = graph.PoseNavigator(
        known,
        embed,
        compare,
        graph.NavigatorRules(tc_reach=0.4),
        known=graph.PoseMap(
            poses=torch.zeros(1, 3),
            track=torch.zeros(1, 2),
            effects=torch.tensor([[1.0, 0, 0], [0, 0, 20], [0, 0, -20], [-1, 0, 0]]),
            places=lambda embedding: torch.zeros(len(embedding), 4),
        ),
        belief=graph.BeliefRules(),
    )
    said = refused(lambda: navigator(reading()))
    assert "places must return [N, W], got [6, 4] for N = 6 and W = 1" in said


def test_a_map_names_the_function_that_returns_something_else() -> None:
    rules = graph.MapRules(tc_threshold=0.9, tc_reach=0.7)
    data = episode(0, 30, views=True).exclude("embedding")
    known = graph.TopologicalMap(torch.Tensor.float, compare, rules)
    said = refused(lambda: known.add_episode(data))
    assert "embed must return [N, D], got [2, 2, 2, 3] for N = 2" in said
    known = graph.TopologicalMap(embed, lambda one, many: one[:, 0], rules)
    said = refused(lambda: known.add_episode(data))
    assert "compare must return [N, M], got [" in said


def test_a_map_says_how_to_give_what_it_lacks() -> None:
    data = episode(0, 30, env=0).unsqueeze(0)
    cases = {
        "env_id": "add the numbers of the envs, [E, T, 1]",
        "embedding": "another key is named by set_keys(embedding=..., views=...)",
        "next": "another key is named by set_keys(done=...)",
    }
    for key, hint in cases.items():
        assert hint in refused(partial(make_map().extend, data.exclude(key)))
    said = refused(lambda: make_map().set_keys(pixels="rgb"))
    assert "set_keys must name some of ['embedding', 'views'," in said
