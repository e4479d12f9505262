"""Navigators: the registry, the topological one, and one that is added."""

import gc
import types
from dataclasses import dataclass, replace
from pathlib import Path

import pytest
import torch
from hydra.core.config_store import ConfigStore
from omegaconf import MISSING
from tensordict import TensorDict
from tensordict.nn import TensorDictModuleBase

from tests.composed import settings
from tests.explored import Explored, make_run, navigate_settings
from tests.methods.test_diagnosis import stand
from toponav.builders import (
    GoalPlaces,
    GroundTruth,
    load_exploration,
    make_controller,
    make_goal_places,
    save_controller,
    save_trials,
)
from toponav.config import NavigatorConfig, SettingsError
from toponav.envs import Layout
from toponav.graph import EdgeTrials, PoseNavigator
from toponav.ground_truth import GroundTruthDistances
from toponav.keys import (
    ACTION,
    GOAL_NODE,
    GOAL_VIEWS,
    IS_INIT,
    PATH_COST,
    PIXELS,
    PLACE,
    PREVIOUS_REWARD,
)
from toponav.methods import navigators
from toponav.methods.navigators import (
    NAVIGATORS,
    NavigatorMethod,
    TopologicalConfig,
    make_navigator,
    make_policies,
    warn_of_goals,
)
from toponav.reports import episode_table, play_policies, summary_row


def topological(*overrides: str) -> TopologicalConfig:
    config = navigate_settings(None, *overrides).navigator
    assert isinstance(config, TopologicalConfig)
    return config


def look(explored: Explored, waypoint: int, goal: int) -> TensorDict:
    """What an agent reads that sees a waypoint's view, and a goal's."""
    images = explored[0].map.waypoints.images
    return TensorDict(
        {
            PIXELS: images[waypoint].unsqueeze(0),
            GOAL_VIEWS: images[goal].reshape(1, 1, *images.shape[1:]),
            PREVIOUS_REWARD: torch.zeros(1, 1),
            IS_INIT: torch.ones(1, 1, dtype=torch.bool),
        },
        [1],
    )


def test_the_navigator_plans_on_it(explored: Explored) -> None:
    navigator = make_navigator(topological(), knowledge=explored[0])
    # Networks that were never trained know no place; the truth of the plan is what
    # counts: from where it believes to be, no goal is more than four cells away.
    entries = navigator(look(explored, 0, 16))
    assert 0 <= entries[PATH_COST].item() <= 5
    assert navigator.rules.tc_reach == pytest.approx(0.3)


@pytest.mark.parametrize(
    ("setting", "value"),
    [
        ("tc_reach", 0.25),
        ("hops", 3),
        ("shortlist", None),
        ("follow", 2),
        ("lookahead", 2),
        ("temperature", 0.7),
        ("mask_noop_actions", False),
        ("block_on", "edge"),
        ("block_after", None),
        ("fade_after", 99),
        ("goal_patience", 7),
        ("lost_for", 2),
    ],
)
def test_each_setting_reaches_the_navigator(explored, setting, value):
    word = "null" if value is None else str(value).lower()
    config = topological(f"navigator.{setting}={word}")
    navigator = make_navigator(config, knowledge=explored[0])
    assert getattr(navigator.rules, setting) == value


def test_networks_with_an_encoder_each_get_both_embeddings(tmp_path: Path) -> None:
    make_run(tmp_path, "model.share_encoder=false")
    explored = load_exploration(navigate_settings(tmp_path))
    knowledge = explored[0]
    navigator = make_navigator(topological(), knowledge=knowledge)
    assert navigator.map.embeddings.shape == (32, 16)
    views = knowledge.map.waypoints.images[:3]
    with torch.no_grad():
        both = navigator.embed(views)
        logits = knowledge.networks.locomotion(views, views.flip(0))
        similar = knowledge.networks.tc.compare(
            knowledge.networks.tc.embed(views),
            knowledge.map.embeddings.expand(3, -1, -1),
        )
        torch.testing.assert_close(navigator.locomotion(both, both.flip(0)), logits)
        every = torch.arange(32).expand(3, -1)
        found = navigator.localiser.similarity(both, every)
    torch.testing.assert_close(found, similar)
    assert navigator(look(explored, 0, 16))[PATH_COST].isfinite()


def test_edges_that_were_never_traversed_cost_more(explored) -> None:
    knowledge = explored[0]
    config = topological("navigator.untraversed_edge_cost=7")
    cost = make_navigator(config, knowledge=knowledge).map.edge_cost
    assert cost.eq(torch.where(knowledge.map.graph.traversals > 0, 1.0, 7.0)).all()


def reachable(start: object) -> list[object]:
    """Everything that an object refers to, modules and classes left out."""
    found, waiting = {}, [start]
    while waiting:
        one = waiting.pop()
        if id(one) in found or isinstance(one, type | types.ModuleType):
            continue
        found[id(one)] = one
        if isinstance(one, types.FunctionType):
            waiting += [one.__closure__, one.__defaults__, one.__kwdefaults__]
        else:
            waiting += gc.get_referents(one)
    return list(found.values())


def test_nothing_that_the_navigator_holds_is_ground_truth(explored) -> None:
    knowledge, truth = explored

    def is_truth(one: object) -> bool:
        if isinstance(one, Layout | GroundTruthDistances | GroundTruth):
            return True
        return isinstance(one, torch.Tensor) and one.shape == truth.poses.shape

    held = reachable(make_navigator(topological(), knowledge=knowledge))
    assert any(one is knowledge.networks.tc for one in held)
    assert not [one for one in held if is_truth(one)]
    oracle = NAVIGATORS["oracle"]
    assert "truth" in oracle.needs
    assert "truth" not in NAVIGATORS["topological"].needs + NAVIGATORS["random"].needs


def test_goals_that_are_like_no_waypoint_are_named(explored):
    cells = torch.tensor([[1, 1], [1, 2]])
    shape = explored[0].map.waypoints.images.shape[1:]
    places = GoalPlaces(cells, torch.zeros(2, 1, *shape, dtype=torch.uint8))

    def warnings(reach: str) -> list[str]:
        config = navigate_settings(None, f"navigator.tc_reach={reach}")
        return list(warn_of_goals(config, make_policies(config, *explored), places))

    (sentence,) = warnings("0.9999")
    assert "got less for 2 of 2 cells: (1, 1) (0." in sentence
    assert warnings("0") == []


@pytest.fixture(scope="module")
def posed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("explored") / "run"
    make_run(path, poses=True)
    return path


def test_a_navigator_by_poses_knows_its_place_and_no_truth(posed: Path) -> None:
    settings = navigate_settings(posed, "navigator=poses")
    explored = load_exploration(settings)
    policy = make_policies(settings, *explored)["navigator"]
    assert isinstance(policy, PoseNavigator)
    for waypoint, goal in ((0, 16), (9, 30)):
        entries = policy(look(explored, waypoint, goal))
        assert entries[PLACE].item() == waypoint
        assert entries[GOAL_NODE].item() // 4 == goal // 4
    assert not any("privileged" in key for key in policy.in_keys)
    kinds = Layout | GroundTruthDistances | GroundTruth
    assert not [one for one in reachable(policy) if isinstance(one, kinds)]
    assert "truth" not in NAVIGATORS["poses"].needs


def test_a_navigator_by_poses_can_be_told_the_truth(posed: Path) -> None:
    names = "[perfect_controller,perfect_place_map]"
    words = "navigator=poses", f"evaluate.policies={names}"
    settings = navigate_settings(posed, *words)
    explored = load_exploration(settings)
    policies = make_policies(settings, *explored)
    assert [type(policy[0]).__name__ for policy in policies.values()] == [
        "PoseNavigator",
        "TruePlace",
    ]
    settings = navigate_settings(
        posed, "navigator=random", f"evaluate.policies={names}"
    )
    with pytest.raises(SettingsError, match="with navigator=topological or poses, got"):
        make_policies(settings, *explored)


def test_its_belief_follows_what_true_steering_does(posed: Path) -> None:
    words = "navigator=poses", "evaluate.policies=[perfect_controller]"
    settings = navigate_settings(posed, *words)
    explored = load_exploration(settings)
    policy = make_policies(settings, *explored)["perfect_controller"]
    # Its view is one to the east, where its goal is; it looks to the west.
    data = look(explored, 0, 16).update(stand(explored, (1, 1), 180.0))
    drawn = policy[0](data.clone())[ACTION]
    done = policy(data)[ACTION]
    assert drawn != done
    assert policy[0].sampler.last_action == done


@pytest.mark.parametrize(
    ("setting", "value"),
    [("temperature", 0.7), ("block_after", 40), ("hops", 3), ("lookahead", 5)],
)
def test_each_rule_reaches_the_navigator_by_poses(posed, setting, value) -> None:
    settings = navigate_settings(
        posed, "navigator=poses", f"navigator.{setting}={value}"
    )
    policy = make_policies(settings, *load_exploration(settings))["navigator"]
    assert getattr(policy.rules, setting) == value


@pytest.mark.parametrize(
    ("setting", "value"), [("poses", 50), ("lost", 0.1), ("still", 0.5), ("spread", 3)]
)
def test_each_setting_reaches_its_belief(posed, setting, value) -> None:
    settings = navigate_settings(
        posed, "navigator=poses", f"navigator.{setting}={value}"
    )
    policy = make_policies(settings, *load_exploration(settings))["navigator"]
    assert getattr(policy.belief_rules, setting) == value
    with pytest.raises(SettingsError, match=r"navigator\.power must be in"):
        navigate_settings(posed, "navigator=poses", "navigator.power=2")


def test_it_sees_the_ground_if_it_is_told_to_and_its_map_can(posed: Path) -> None:
    plain, seeing = (
        navigate_settings(posed, "navigator=poses", f"navigator.see_ground={word}")
        for word in ("false", "true")
    )
    knowledge, truth = load_exploration(seeing)
    make = make_policies
    assert make(plain, knowledge, truth)["navigator"].known.ground is None
    known = make(seeing, knowledge, truth)["navigator"].known
    given = knowledge.map_networks
    assert known.ground is given.ground is not None
    assert known.offsets is given.offsets is not None
    assert known.places is given.places
    rule = "navigator.see_ground must be false for a run of an earlier version"
    without = replace(knowledge, map_networks=replace(given, ground=None))
    with pytest.raises(SettingsError, match=rule):
        make(seeing, without, truth)


def test_its_plans_go_by_what_a_practice_showed(posed: Path, tmp_path: Path) -> None:
    words = "navigator=poses", f"navigator.practised={tmp_path}"
    settings = navigate_settings(posed, *words)
    knowledge, truth = load_exploration(settings)
    edges, size = knowledge.map.edges, knowledge.map.embeddings.shape[1]
    save_controller(make_controller(size, knowledge.world.num_actions), tmp_path)
    rule = "navigator.edge_trials must be false for a practice of an earlier version"
    with pytest.raises(SettingsError, match=rule):
        make_policies(settings, knowledge, truth)
    trials = EdgeTrials(edges)
    in_vain = edges[[0, 0, 0, 1, 1]]
    passed = torch.tensor([False, False, False, True, True])
    trials.add(in_vain, passed, torch.tensor([9, 9, 9, 2, 40]))
    save_trials(trials, tmp_path)
    by_trials = make_policies(settings, knowledge, truth)["navigator"].map
    words = *words, "navigator.edge_trials=false"
    plain = make_policies(navigate_settings(posed, *words), knowledge, truth)
    own = plain["navigator"].map
    kept = trials.kept(knowledge.map.num_waypoints)
    assert torch.equal(by_trials.edges, edges[kept])
    assert torch.equal(by_trials.edge_cost, trials.costs(own.edge_cost)[kept])
    assert torch.equal(own.edges, edges)


def test_a_map_without_poses_is_refused_by_name(folder: Path) -> None:
    settings = navigate_settings(folder, "navigator=poses")
    rule = (
        "navigator=poses must be given a map with poses, .*did you mean navigator=top"
    )
    with pytest.raises(SettingsError, match=rule):
        make_policies(settings, *load_exploration(settings))


@dataclass
class TurnerConfig(NavigatorConfig):
    """Settings of a toy navigator."""

    action: int = MISSING


class Turner(TensorDictModuleBase):
    """Always does the same."""

    in_keys = [PIXELS]
    out_keys = [ACTION]

    def __init__(self, action: int) -> None:
        super().__init__()
        self.action = action

    def forward(self, tensordict: TensorDict) -> TensorDict:
        return tensordict.set(ACTION, torch.full(tensordict.shape, self.action))


def make_turner(config: TurnerConfig, *, seed: int) -> Turner:
    return Turner(config.action)


def test_a_navigator_is_added_by_a_method_a_file_of_settings_and_a_line(
    folder, explored, monkeypatch
):
    turner = NavigatorMethod(schema=TurnerConfig, make=make_turner)
    monkeypatch.setitem(navigators.NAVIGATORS, "turner", turner)
    # What the file conf/navigator/turner.yaml would hold.
    node = TurnerConfig(name="turner", action=2)
    ConfigStore.instance().store(group="navigator", name="turner", node=node)
    overrides = ("navigator=turner", "navigator.action=3", "video.decisions=0")
    config = navigate_settings(
        folder, *overrides, "evaluate.policies=[navigator,oracle]"
    )
    places = make_goal_places(config, *explored)
    policies = make_policies(config, *explored)
    assert isinstance(policies["navigator"], Turner)
    played = play_policies(config, explored[1], places, policies)
    # It stays where it is; the oracle reaches goals in the same episodes.
    walked = played[0].trace.positions
    assert (walked == walked[:, :1]).all()
    rows = [summary_row(one, explored[1], places, slow=20) for one in played]
    assert rows[0]["goals"] == 0
    assert rows[1]["goals"] > 0
    assert episode_table(played[0])["policy"].tolist() == ["navigator"] * 2


def test_names_of_policies_are_checked(explored):
    def refused(*overrides: str) -> str:
        config = navigate_settings(None, *overrides)
        with pytest.raises(SettingsError) as error:
            make_policies(config, *explored)
        return str(error.value)

    assert refused("evaluate.policies=[me]") == (
        "evaluate.policies must be one of navigator, topological, poses, oracle, "
        "random, trained, perfect_controller, perfect_place, perfect_map, "
        "perfect_controller_place, perfect_controller_map, perfect_place_map, got me"
    )
    assert refused("navigator=random", "evaluate.policies=[topological]") == (
        "evaluate.policies must name a navigator without settings beside navigator, "
        "which is navigator=random, got topological"
    )


@pytest.mark.parametrize(
    ("override", "message"),
    [
        (
            "navigator.temperature=-1",
            "navigator.temperature must be at least 0, got -1",
        ),
        ("navigator.hops=0", "navigator.hops must be at least 1, got 0"),
        ("navigator.follow=-1", "navigator.follow must be at least 0, got -1"),
        ("navigator.block_after=0", "navigator.block_after must be at least 2, got 0"),
        (
            "navigator.tc_reach=2",
            r"navigator.tc_reach must be in \[0, 1\), got 2",
        ),
        (
            "navigator.untraversed_edge_cost=0",
            "untraversed_edge_cost must be at least 1, got 0",
        ),
        ("goals.views=0", r"goals.views must lie in \[1, 16\], got 0 \(did you mean 1"),
        ("goals.source=thief", "goals.source must be one of map, walk, got thief"),
        ("evaluate.episodes=0", "evaluate.episodes must be at least 1, got 0"),
        ("evaluate.policies=[]", "evaluate.policies must name one, got none"),
        ("video.format=avi", "video.format must be one of mp4, gif, got avi"),
        ("video.height=9", r"video.height must lie in \[64, 4320\], got 9"),
        ("maze.goal=false", "maze.goal must be true, so that there is a goal"),
        ("threads=0", "threads must be at least 1, got 0"),
    ],
)
def test_a_value_out_of_range_is_refused(override, message):
    with pytest.raises(SettingsError, match=message):
        navigate_settings(None, override)


def test_by_default_it_walks_by_poses_and_at_other_scales_as_the_paper_has_it():
    config = settings("navigate", "maze=maze1")
    assert config.navigator.name == "poses"
    config = settings("navigate", "maze=maze1", "navigate=paper")
    assert config.navigator.name == "topological"
    assert config.navigator.block_on == "edge"
    config = settings("navigate", "maze=maze1", "navigate=smoke")
    assert config.navigator.name == "topological"
    config = settings("navigate", "maze=maze1", "navigate=paper", "navigator=poses")
    assert config.navigator.name == "poses"
