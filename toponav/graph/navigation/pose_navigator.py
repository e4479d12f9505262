"""`PoseNavigator`: a navigator on a map whose waypoints have poses."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Self

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor

from toponav.graph.navigation.free_way import aim_where_free
from toponav.graph.navigation.localiser import Map
from toponav.graph.navigation.navigator import Navigator, SeeingMap
from toponav.graph.navigation.path_following import aim_along, edges_through, steer
from toponav.graph.navigation.pose_belief import BeliefRules, PoseBelief
from toponav.graph.navigation.steering_senses import SteeringSenses
from toponav.graph.poses import BEARINGS, DISTANCES, decisions_apart, fastest_turn
from toponav.graph.rules import NavigatorRules
from toponav.graph.waypoints import Compare, Embed
from toponav.parts import require_parts, require_returned

#: Decisions around the most likely waypoint of a goal view that say where it is, steps
#: up to which goal views agree, and from there to waypoints that stand for the goal.
_AROUND, _AGREE, _BESIDE = 5.0, 3.0, 2.5
#: What a turn counts beside a step to say at which waypoint an agent is; steps from a
#: place at which it is reached, and share of the decisions at a goal's end of a path in
#: which it looks for the goal somewhere else.
_DIRECTION, _THERE = 0.2, 0.7
_TIRED = 0.1
#: Steps from the end of its path from which it looks for its goal.
_LOOKS = 1.0
#: Share of the way to what it aims at where an agent that is stuck could not pass.
_AHEAD = 0.7
#: Steps up to which another waypoint may stand for one that has no path left.
_PASSED_BY = 4.0


@dataclass(frozen=True, kw_only=True)
class PoseMap:
    """What is known of a map's W waypoints, beside what a `Map` says."""

    poses: Tensor  # float32 [W, 3]: steps, steps and degrees
    track: Tensor  # float32 [W, 2], in steps; where to walk to pass by each of them
    #: Of the actions in free space, ``[A, 3]``: steps ahead, to the left, and degrees.
    effects: Tensor
    #: Embeddings ``[N, D]`` to logits of the waypoints ``[N, W]``: `PlaceNetwork`.
    places: Callable[[Tensor], Tensor]
    #: Embeddings ``[N, D]`` to how far from each waypoint a view near it is, ``[N, W,
    #: 3]``, steps, steps and degrees: `OffsetNetwork`; ``None`` takes it to be at it.
    offsets: Callable[[Tensor], Tensor] | None = None
    #: Embeddings ``[N, D]`` to logits ``[N, K, R]`` that the ground is free at `spots`
    #: before the agent: `GroundNetwork`; ``None`` where nothing says so.
    ground: Callable[[Tensor], Tensor] | None = None


class PoseNavigator(Navigator):
    """Follows its own pose, and steers along the path by it.

    As `Navigator`, but for three things:

    1. *localise*: it believes in poses, by its actions and by what its networks of
       places and offsets say of its views (`PoseBelief`), and is at the waypoint
       nearest to where most of them are; it is never lost;
    2. *aim*: at the point of the path that is ``ahead`` steps away (`aim_along`), or
       where the view says that the ground on the way there is free (`aim_where_free`),
       and act by the pose alone (`steer`);
    3. *goal*: where most of the goal's views agree that it is. There the agent searches
       around, as its goal is a little beside it.

    An agent that comes no nearer to its goal closes all edges through one place at
    once, since what it cannot pass there, no other edge passes: the place that was
    ahead of it most of the time. Beside waypoints that are left without a path it goes
    on from the nearest that has one.

    Reference:
        Beyond the paper.

    Args:
        map, embed, compare, rules, goal_reward, in_keys, place_key, one_hot, seed: as
            in `Navigator`, whose rules of targets and of lost agents do not apply.
        known: poses, effects, and what views say.
        belief: how poses are followed.
        ahead: steps from the agent to the point of its path that it aims at.
        search: standard deviation, in steps, of where it looks for the goal.
        controller: corrects what steering in free space says of each action: embeddings
            ``[N, D]``, `SteeringSenses` ``[N, S]`` and logits ``[N, A]`` to logits, as
            `SteeringNetwork` does; ``None`` for none.
        block_within: steps around the place that it could not pass, up to which edges
            are closed; ``None`` closes as a `Navigator` does.
    """

    def __init__(
        self,
        map: Map,
        embed: Embed,
        compare: Compare,
        rules: NavigatorRules,
        *,
        known: PoseMap,
        belief: BeliefRules,
        ahead: float = 3.5,
        search: float = 0.8,
        block_within: float | None = None,
        controller: Callable[[Tensor, Tensor, Tensor], Tensor] | None = None,
        goal_reward: float | None = None,
        in_keys: Sequence[NestedKey] | None = None,
        place_key: NestedKey | None = None,
        one_hot: bool = False,
        seed: int = 0,
    ) -> None:
        super().__init__(
            map,
            embed,
            compare,
            self._steer,
            rules,
            goal_reward=goal_reward,
            in_keys=in_keys,
            place_key=place_key,
            one_hot=one_hot,
            seed=seed,
        )
        parts = "poses", "track", "effects", "places"
        require_parts(known, "known", "a PoseMap", *parts)
        require_parts(belief, "belief", "BeliefRules", "spread", "floor", "lost")
        if len(known.poses) != map.num_waypoints or known.poses.isnan().any():
            number = int(known.poses.isfinite().all(1).sum())
            rule = f"all {map.num_waypoints} waypoints of the map must have poses"
            raise ValueError(f"{rule}, got {number} poses")
        self.known = known
        self.belief_rules = belief
        self.ahead, self.search, self.block_within = ahead, search, block_within
        self.controller = controller
        self.turn = fastest_turn(known.effects)

    @classmethod
    def over(  # type: ignore[override]
        cls, map: SeeingMap, *, rules: NavigatorRules | None = None, **options: Any
    ) -> Self:
        """As `Navigator.over`, without ``locomotion``, as it steers by poses."""
        require_parts(map, "map", "a TopologicalMap", "embed", "compare", "rules")
        rules = rules or NavigatorRules(tc_reach=map.rules.tc_reach)
        options |= {"map": map, "embed": map.embed, "compare": map.compare}
        return cls(rules=rules, **options)

    def _resize(self, num_agents: int, num_goal_views: int, length: int) -> None:
        super()._resize(num_agents, num_goal_views, length)
        poses, effects = self.known.poses, self.known.effects
        rules, draws = self.belief_rules, self.generator
        self.belief = PoseBelief(poses, effects, rules, num_agents, draws)
        self._pose = torch.zeros(num_agents, 3)
        self._aims = torch.zeros(num_agents, 2)
        self._points, self._ends = self._aims.unsqueeze(1), self._aims[:, 0] > 0
        self.senses = SteeringSenses(num_agents, len(effects), length)
        # Where each agent's goal is, and how far from there it looks for it now.
        self._goal = torch.zeros(num_agents, 2)
        self._aside = torch.zeros(num_agents, 2)
        # What was ahead in the last decisions, [N, block_after, 2].
        self._tried = torch.zeros(num_agents, self.rules.block_after or 1, 2)

    def _find_goals(self, agents: Tensor, embedding: Tensor) -> None:
        seen = self._see(embedding.flatten(0, 1)).unflatten(0, embedding.shape[:2])
        gaps = torch.cdist(seen, seen)
        agree = gaps < _AGREE
        most = agree.sum(2).argmax(1)
        chosen = agree[torch.arange(len(agents)), most].unsqueeze(2)
        goal = (seen * chosen).sum(1) / chosen.sum(1)
        away = torch.cdist(goal, self.known.poses[:, :2])
        number = min(embedding.shape[1], away.shape[1])
        nearest, nodes = away.topk(number, largest=False)
        counts = nearest < _BESIDE
        counts[:, 0] = True
        # As many as there are views; of a smaller map, the last one again.
        fill = [*range(number), *[number - 1] * (embedding.shape[1] - number)]
        self.goals.put(agents, embedding, nodes[:, fill], counts[:, fill])
        self._goal[agents] = goal

    def _see(self, embedding: Tensor) -> Tensor:
        """Where views ``[n, D]`` are, by themselves, in steps ``[n, 2]``."""
        chance, poses = self._chances(embedding), self.known.poses
        best = poses[chance.argmax(1)].unsqueeze(1)
        near = decisions_apart(best, poses, self.turn) < _AROUND
        chance = (chance * near).unsqueeze(2)
        offsets = self._offsets(embedding)
        seen = poses if offsets is None else poses + offsets
        return (chance * seen[..., :2]).sum(1) / chance.sum(1)

    def _chances(self, embedding: Tensor) -> Tensor:
        """How likely views ``[n, D]`` are at each waypoint, ``[n, W]``."""
        logits, number = self.known.places(embedding), len(self.known.poses)
        require_returned("places", logits, N=len(embedding), W=number)
        return logits.softmax(1).cpu()

    def _offsets(self, embedding: Tensor) -> Tensor | None:
        """How far from each waypoint views ``[n, D]`` near it are, ``[n, W, 3]``."""
        if self.known.offsets is None:
            return None
        found, number = self.known.offsets(embedding), len(self.known.poses)
        require_returned("offsets", found, N=len(embedding), W=number, X=3)
        return found.cpu()

    def _restart(self, agents: Tensor) -> None:
        super()._restart(agents)
        self.belief.forget(agents)
        self.senses.forget(agents)
        self._aside[agents] = 0

    def _locate(self, embedding: Tensor, data: TensorDictBase) -> Tensor:
        chance = self._chances(embedding)
        if self.place_key is not None:
            given = data[self.place_key].reshape(-1, 1).cpu()
            sure = torch.zeros_like(chance).scatter_(1, given.clamp(min=0), 1.0)
            # Where nobody tells its place, its view does.
            chance = torch.where(given >= 0, sure, chance)
        offsets = self._offsets(embedding)
        self.belief.update(self.sampler.last_action, chance, offsets)
        self._pose = self.belief.estimate()
        if self.place_key is not None:
            return super()._locate(embedding, data)
        self.localiser.place = self._apart().argmin(1)
        return self.localiser.place.clone()

    def _apart(self) -> Tensor:
        """How far agents are from waypoints, ``[N, W]``, to say at which they are."""
        # A turn counts less here than on the way.
        turn = self.turn / _DIRECTION
        return decisions_apart(self._pose.unsqueeze(1), self.known.poses, turn)

    def _with_path(self, place: Tensor) -> Tensor:
        """Places; beside one that is left without a path, the nearest that has one."""
        if not self.plans.cost(place).isinf().any():
            return place
        beside = torch.cdist(self._pose[:, :2], self.known.poses[:, :2]) < _PASSED_BY
        apart = self._apart().masked_fill(~(beside & self.plans.has_path), torch.inf)
        least, other = apart.min(1)
        return torch.where(
            self.plans.cost(place).isinf() & least.isfinite(), other, place
        )

    def _aim(self, place: Tensor, embedding: Tensor) -> tuple[Tensor, Tensor]:
        place = self._with_path(place)
        self.plans.open_up(place)
        place = place.masked_fill(self.plans.cost(place).isinf(), -1)
        path = self.plans.ahead(place, self.rules.lookahead)
        position, points = self._pose[:, :2], self.known.track[path]
        aim = aim_along(position, points, ahead=self.ahead)
        goal = self._goal + self._aside
        ends = aim.is_end & (self.plans.cost(path[:, -1]) == 0)
        # It looks elsewhere once it is there, and now and then: walls may be between.
        tired = torch.rand(len(ends), generator=self.generator) < _TIRED
        there = (goal - position).norm(dim=1) < _THERE
        aside = torch.randn(self._aside.shape, generator=self.generator) * self.search
        again = (ends & (there | tired)).unsqueeze(1)
        self._aside = torch.where(again, aside, self._aside)
        self._aims = torch.where(ends.unsqueeze(1), goal, aim.point)
        self._points, self._ends = points, ends
        # What it aims at lies on the way to this waypoint; where it looks for its goal,
        # it is at the goal's waypoint.
        onward = aim.passed.clamp(max=path.shape[1] - 1).unsqueeze(1)
        target = path.gather(1, onward).squeeze(1)
        looks = ends & ((points[:, -1] - position).norm(dim=1) < _LOOKS)
        target = torch.where(looks, place, target)
        return place, target.masked_fill(place < 0, -1)

    def _give_up(self, place: Tensor) -> Tensor:
        if self.block_within is None:
            return super()._give_up(place)
        stuck = self.progress.watch(place, self.plans.cost(place))
        ahead = torch.lerp(self._pose[:, :2], self._aims, _AHEAD)
        self._tried = torch.cat([self._tried[:, 1:], ahead.unsqueeze(1)], 1)
        closed_ends = torch.full((len(place), 2), -1)
        starts, ends = self.known.track[self.map.edges].unbind(1)
        for agent in stuck.nonzero().flatten().tolist():
            node, *_ = self.progress.give_up(agent)
            # Of all that it tried, as its pose may have been wrong for a while.
            tried = self._tried[agent]
            most = (torch.cdist(tried, tried) < self.block_within).sum(1).argmax()
            through = edges_through(tried[most], self.block_within, starts, ends)
            edges = through.nonzero().flatten()
            if len(edges):
                found = self.plans.close_all(agent, int(place[agent]), edges)
            else:
                found = node, self.plans.close_edge(agent, node)
            closed_ends[agent] = torch.tensor(found)
        return closed_ends

    def _steer(self, here: Tensor, there: Tensor) -> Tensor:
        here, aims = here.float().cpu(), self._aims
        if self.known.ground is not None:
            logits = self.known.ground(here)
            shape = len(here), len(BEARINGS), len(DISTANCES)
            require_returned("ground", logits, N=shape[0], K=shape[1], R=shape[2])
            aims = aim_where_free(self._pose, aims, logits.sigmoid().cpu())
        self._free = steer(self._pose, aims, self.known.effects)
        if self.controller is None:
            return self._free
        self._sensed = self.senses(
            self._pose,
            self.belief.poses[:, :, :2].std(1).norm(dim=1),
            self._points,
            self._aims,
            self._ends,
            self.sampler.last_action,
            here,
            self._free,
        )
        return self.controller(here, self._sensed, self._free)
