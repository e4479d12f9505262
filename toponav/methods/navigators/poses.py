"""A navigator that follows its own pose, on a map whose waypoints have poses."""

from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import Any

from omegaconf import MISSING
from tensordict import NestedKey
from torch import Tensor

from toponav.builders import (
    TRIALS_FILE,
    AgentKnowledge,
    action_effects,
    load_controller,
    load_trials,
)
from toponav.config import (
    NavigatorConfig,
    PractiseConfig,
    above,
    one_of,
    refusing,
    require,
)
from toponav.graph import (
    BeliefRules,
    NavigatorRules,
    PoseMap,
    PoseNavigator,
    PractisingNavigator,
    to_the_middle,
    walking_costs,
)
from toponav.methods.navigators.method import NavigatorMethod
from toponav.methods.navigators.topological import NavigatorMap
from toponav.modules import SteeringNetwork


@dataclass
class PosesConfig(NavigatorConfig):
    """Settings of ``navigator=poses``."""

    ahead: float = above(0)
    search: float = above(0)
    practised: str | None = MISSING
    edge_trials: bool = MISSING
    see_ground: bool = MISSING
    width: float = above(0)
    lookahead: int = MISSING
    temperature: float = MISSING
    mask_noop_actions: bool = MISSING
    block_on: str = one_of("goal", "edge")
    block_after: int | None = MISSING
    block_within: float | None = above(0)
    fade_after: int | None = MISSING
    fade_growth: float = MISSING
    hops: int = MISSING
    goal_patience: int | None = MISSING
    poses: int = MISSING
    spread: float = MISSING
    floor: float = MISSING
    power: float = MISSING
    stopped: float = MISSING
    still: float = MISSING
    lost: float = MISSING

    def __post_init__(self) -> None:
        super().__post_init__()
        with refusing("navigator."):
            self.rules()
            self.belief()

    def rules(self) -> NavigatorRules:
        """The navigator's rules. Poses say where it is: similarities do not matter."""
        names = {one.name for one in fields(NavigatorRules)}
        given = {name: value for name, value in vars(self).items() if name in names}
        return NavigatorRules(**given, tc_reach=0.0)

    def belief(self) -> BeliefRules:
        """How it follows its pose."""
        names = [one.name for one in fields(BeliefRules)]
        return BeliefRules(**{name: getattr(self, name) for name in names})


def make_pose_navigator(
    config: PosesConfig,
    *,
    knowledge: AgentKnowledge,
    edges: tuple[Tensor, Tensor] | None = None,
    place_key: NestedKey | None = None,
    seed: int = 0,
) -> PoseNavigator:
    """The agent, as `make_navigator`, on a map that ``map.poses=true`` has made."""
    controller, practice = None, None
    if config.practised is not None:
        controller = load_controller(
            Path(config.practised),
            embedding_size=knowledge.map.embeddings.shape[1],
            num_actions=knowledge.world.num_actions,
            setting="navigator.practised",
        )
        if edges is None and config.edge_trials:
            practice = Path(config.practised)
    return PoseNavigator(
        **_arguments(config, knowledge, edges, practice),
        controller=controller,
        goal_reward=knowledge.world.goal_reward,
        place_key=place_key,
        seed=seed,
    )


def make_practising_navigator(
    settings: PractiseConfig, knowledge: AgentKnowledge, controller: SteeringNetwork
) -> PractisingNavigator:
    """The agent that walks to waypoints of its own map, by what it learns there."""
    config = settings.navigator
    rule = "navigator must be poses, which alone can practise"
    require(isinstance(config, PosesConfig), rule, config.name)
    assert isinstance(config, PosesConfig)
    rule = "navigator.practised must be null, as each practice begins afresh"
    require(config.practised is None, rule, config.practised)
    rule = "navigator.temperature must be above 0 to practise, which learns from draws"
    require(config.temperature > 0, rule, config.temperature)
    given = _arguments(config, knowledge, None)
    # Actions are drawn by the chances that are learned from.
    given["rules"] = replace(given["rules"], mask_noop_actions=False)
    confirm = settings.practice.confirm
    return PractisingNavigator(
        **given, controller=controller, confirm=confirm, seed=settings.seed
    )


def _arguments(
    config: PosesConfig,
    knowledge: AgentKnowledge,
    edges: tuple[Tensor, Tensor] | None,
    practice: Path | None = None,
) -> dict[str, Any]:
    """What both have in common, with edges as a ``practice`` left them."""
    known, tc = knowledge.map, knowledge.networks.tc
    effects, poses = action_effects(knowledge.world), known.waypoints.poses
    rule = "navigator=poses must be given a map with poses, of an exploration with "
    rule += "map.poses=true (did you mean navigator=topological?)"
    map_networks = knowledge.map_networks
    require(map_networks is not None, rule, "a map without")
    assert map_networks is not None
    assert effects is not None  # mazes have them
    ground = None
    if config.see_ground:
        rule = "navigator.see_ground must be false for a run of an earlier version, "
        rule += "whose map knows nothing of the ground"
        require(map_networks.ground is not None, rule, "true")
        ground = map_networks.ground
    track = to_the_middle(poses[:, :2], width=config.width)
    if edges is None:
        cost = walking_costs(track, known.edges, known.graph.traversals)
        edges = known.edges, cost
    if practice is not None:
        rule = "navigator.edge_trials must be false for a practice of an earlier "
        rule += "version, which kept none"
        require((practice / TRIALS_FILE).is_file(), rule, "true")
        trials = load_trials(practice, edges[0], setting="navigator.practised")
        kept = trials.kept(known.num_waypoints)
        edges = edges[0][kept], trials.costs(edges[1])[kept]
    return {
        "map": NavigatorMap.of(known, known.embeddings, edges),
        "embed": tc.embed,
        "compare": tc.compare_prepared,
        "rules": config.rules(),
        "known": PoseMap(
            poses=poses,
            track=track,
            effects=effects,
            places=map_networks.places,
            offsets=map_networks.offsets,
            ground=ground,
        ),
        "belief": config.belief(),
        "ahead": config.ahead,
        "search": config.search,
        "block_within": config.block_within,
    }


POSES = NavigatorMethod(
    schema=PosesConfig,
    needs=("knowledge",),
    make=make_pose_navigator,
    takes_truth=True,
)
