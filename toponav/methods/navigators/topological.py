"""The paper's navigator: localises itself on the map, plans, and walks."""

from dataclasses import dataclass, fields

import torch
from omegaconf import MISSING
from tensordict import NestedKey
from torch import Tensor

from toponav.builders import AgentKnowledge, GoalPlaces
from toponav.config import NavigatorConfig, at_least, one_of, refusing
from toponav.graph import Navigator, NavigatorRules, TopologicalMap
from toponav.methods.navigators.method import NavigatorMethod

_VIEWS_AT_ONCE = 64


@dataclass
class TopologicalConfig(NavigatorConfig):
    """Settings of ``navigator=topological``."""

    tc_reach: float | None = MISSING
    untraversed_edge_cost: float = at_least(1)
    hops: int = MISSING
    shortlist: int | None = MISSING
    follow: int = MISSING
    lookahead: int = MISSING
    temperature: float = MISSING
    mask_noop_actions: bool = MISSING
    block_on: str = one_of("goal", "edge")
    block_after: int | None = MISSING
    fade_after: int | None = MISSING
    fade_growth: float = MISSING
    goal_patience: int | None = MISSING
    lost_for: int = MISSING

    def __post_init__(self) -> None:
        super().__post_init__()
        with refusing("navigator."):
            self.rules(tc_reach=0.5)

    def rules(self, *, tc_reach: float) -> NavigatorRules:
        """The navigator's rules; ``tc_reach`` is the map's, unless it is set here."""
        given = {one.name: getattr(self, one.name) for one in fields(NavigatorRules)}
        if self.tc_reach is None:
            given["tc_reach"] = tc_reach
        return NavigatorRules(**given)


@dataclass(frozen=True)
class NavigatorMap:
    """A `Map` as one navigator reads it, which must not change any more."""

    num_waypoints: int
    embeddings: Tensor
    prepared: Tensor
    edges: Tensor
    edge_cost: Tensor
    version: int

    @classmethod
    def of(
        cls, known: TopologicalMap, embeddings: Tensor, edges: tuple[Tensor, Tensor]
    ) -> "NavigatorMap":
        """A map as it is now, with these ``edges`` ``[E, 2]`` and their costs."""
        return cls(
            num_waypoints=known.num_waypoints,
            embeddings=embeddings,
            prepared=known.prepared,
            edges=edges[0],
            edge_cost=edges[1],
            version=known.version,
        )


def make_navigator(
    config: TopologicalConfig,
    *,
    knowledge: AgentKnowledge,
    edges: tuple[Tensor, Tensor] | None = None,
    place_key: NestedKey | None = None,
    seed: int = 0,
) -> Navigator:
    """The agent: map and networks of an exploration, and the settings of this run.

    A diagnosis tells it ``edges`` ``[E, 2]`` with costs ``[E]`` in place of the map's,
    and by ``place_key`` where it is; an agent gets neither. If the L-network has an
    encoder of its own, an embedding is that of both networks side by side: the map
    itself has those of the TC-network alone.
    """
    known, tc = knowledge.map, knowledge.networks.tc
    locomotion, length = knowledge.networks.locomotion, known.embeddings.shape[1]
    is_shared = locomotion.encoder is tc.encoder

    def embed(views: Tensor) -> Tensor:
        embedding = tc.embed(views)
        if is_shared:
            return embedding
        return torch.cat([embedding, locomotion.encoder(views)], -1)

    def compare(embedding: Tensor, prepared: Tensor) -> Tensor:
        return tc.compare_prepared(embedding[:, :length], prepared)

    def act(here: Tensor, there: Tensor) -> Tensor:
        logits: Tensor = locomotion.head(here[:, -length:], there[:, -length:])
        return logits

    embeddings = known.embeddings
    if not is_shared:
        with torch.no_grad():
            parts = known.waypoints.images.split(_VIEWS_AT_ONCE)
            own = torch.cat([locomotion.encoder(part).float() for part in parts])
        embeddings = torch.cat([embeddings, own], 1)
    if edges is None:
        walked = known.graph.traversals > 0
        cost = torch.where(walked, 1.0, config.untraversed_edge_cost)
        edges = known.edges, cost.float()
    return Navigator(
        NavigatorMap.of(known, embeddings, edges),
        embed,
        compare,
        act,
        config.rules(tc_reach=known.rules.tc_reach),
        goal_reward=knowledge.world.goal_reward,
        place_key=place_key,
        seed=seed,
    )


def warn_of_goals(navigator: Navigator, places: GoalPlaces) -> str | None:
    """A sentence about goals whose pictures are like no waypoint, if there are any."""
    views, reach = places.views, navigator.rules.tc_reach
    embedding = navigator.embed(views.flatten(0, 1)).float()
    _, similarities = navigator.localiser.nearest(embedding)
    best = similarities.reshape(views.shape[:2]).max(1).values
    unlike = (best <= reach).nonzero().flatten().tolist()
    if not unlike:
        return None
    cells = [(tuple(places.cells[at].tolist()), best[at]) for at in unlike[:3]]
    named = ", ".join(f"{cell} ({similarity:.2f})" for cell, similarity in cells)
    return (
        "a goal's pictures must be like a waypoint, with a similarity above "
        f"{reach:.2f}, got less for {len(unlike)} of {len(best)} cells: {named}; the "
        "most similar waypoint is taken"
    )


TOPOLOGICAL = NavigatorMethod(
    schema=TopologicalConfig,
    needs=("knowledge",),
    make=make_navigator,
    takes_truth=True,
    warn_of_goals=warn_of_goals,
)
