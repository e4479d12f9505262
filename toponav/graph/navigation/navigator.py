"""`Navigator`: a policy that walks to goal views over a topological map."""

from collections.abc import Callable, Sequence
from typing import Any, Protocol, Self

import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor
from torch.nn.functional import one_hot

from toponav import keys
from toponav.graph.navigation.goals import GoalNodes
from toponav.graph.navigation.localiser import Localiser, Map
from toponav.graph.navigation.planner import Planner
from toponav.graph.navigation.plans import Plans
from toponav.graph.navigation.progress import EdgeProgress, Progress
from toponav.graph.navigation.sampler import ActionSampler
from toponav.graph.rules import MapRules, NavigatorRules
from toponav.graph.waypoints import Compare, Embed
from toponav.parts import require_callables, require_parts, require_returned

#: Embeddings here and there, ``[N, D]`` each, to logits of the actions ``[N, A]``.
Locomotion = Callable[[Tensor, Tensor], Tensor]
_DECIDED = [keys.PLACE, keys.TARGET, keys.GOAL_NODE, keys.PATH_COST]
_DECIDED += [keys.NUM_CUTS, keys.CUT_FROM, keys.CUT_TO, keys.LOST]


class SeeingMap(Map, Protocol):
    """A map with the networks that it was made by, such as `TopologicalMap`."""

    embed: Embed
    compare: Compare

    @property
    def rules(self) -> MapRules: ...


class Navigator(TensorDictModuleBase):
    """Localises itself on a map, plans a path to the goal, and walks it view by view.

    In each decision, for every env of the batch by itself, by `NavigatorRules`:

    1. *localise*: the waypoint most similar to the view, of the path if possible, else
       near the last place, else anywhere (`Localiser`); if there is none, the agent is
       lost and acts at random for ``lost_for`` decisions before it looks again;
    2. *plan*: the cheapest path to the nearest of the waypoints that stand for the goal
       (`GoalNodes`, `Planner`), around the edges that were closed;
    3. *aim*: at the farthest of the next ``lookahead`` waypoints of the path that is
       reachable, by a similarity above ``tc_reach`` and not over a closed edge, else
       at the next one; at the goal's own waypoint, at the goal view;
    4. *act*: draw an action from ``locomotion``'s logits at ``temperature``;
    5. *give up*: an agent that comes no nearer to its goal (`Progress`) closes the edge
       that would lead on from where it got, and the longer it is stuck, the more of
       the edges nearby that lead as near to the goal (`Plans`), and plans again. With
       ``block_on="edge"`` it is the edge that it did not get over (`EdgeProgress`), and
       no other. If no path is left, a cut opens again (`Plans`).

    It writes the action, int64 ``[*B]`` or one-hot, and what it decided, as
    `toponav.keys` describes it, and reads no privileged key. It is a policy for any
    TorchRL collector or rollout, with any batch shape. Its state has one row an env,
    which resets where ``is_init`` is true; a new version of the map resets all. One
    object must not serve two collectors. The callables are neither moved nor saved with
    it and must be in ``eval()`` mode.

    Reference:
        The paper, "Navigation implementation", Figs. 10 and 11, eq. 15.

    Args:
        map: such as a `TopologicalMap`, not empty.
        embed, compare: as in `TopologicalMap`.
        locomotion: embeddings here and there to logits of the actions that lead there.
        rules: its choices.
        goal_reward: as in `TopologicalMap`; with ``None`` no reward is read.
        in_keys: of the view, uint8 ``[*B, H, W, C]``, of V goal views, uint8
            ``[*B, V, H, W, C]``, both in the order that ``embed`` reads, of the flag of
            a first decision, bool ``[*B, 1]``, and, with a ``goal_reward``, of the
            reward before (`PreviousReward`).
        place_key: of the waypoint where each agent is, int64 ``[*B, 1]``, -1 where it
            is not known: for a diagnosis that tells agents their place. By default they
            find it by their views.
        one_hot: write actions as int64 ``[*B, A]``, as TorchRL's ``GymEnv`` takes them
            unless it is told otherwise.
        seed: of the actions drawn.

    Examples:
        >>> from toponav.graph import TopologicalMap
        >>> compare = lambda one, many: 1 - (one.unsqueeze(1) - many).abs().mean(-1)
        >>> rules = MapRules(tc_threshold=0.9, tc_reach=0.4, window=0)
        >>> grey = TopologicalMap(torch.nn.Flatten(), compare, rules)
        >>> grey.add_episode(TensorDict({"embedding": [[0.0], [0.5], [1.0]]}, [3]))
        tensor([0, 1, 2])
        >>> darker_or_lighter = lambda one, to: 99 * torch.cat([one - to, to - one], 1)
        >>> view = {"pixels": [[[0.0]]], "goal_views": [[[[1.0]]]], "is_init": [True]}
        >>> Navigator.over(grey, darker_or_lighter)(TensorDict(view))["action"]
        tensor(1)
    """

    def __init__(
        self,
        map: Map,
        embed: Embed,
        compare: Compare,
        locomotion: Locomotion,
        rules: NavigatorRules,
        *,
        goal_reward: float | None = None,
        in_keys: Sequence[NestedKey] | None = None,
        place_key: NestedKey | None = None,
        one_hot: bool = False,
        seed: int = 0,
    ) -> None:
        super().__init__()
        wanted = [keys.PIXELS, keys.GOAL_VIEWS, keys.IS_INIT]
        if goal_reward is not None:
            wanted.append(keys.PREVIOUS_REWARD)
        self.in_keys = wanted if in_keys is None else list(in_keys)
        self.out_keys = [keys.ACTION, *_DECIDED]
        if len(self.in_keys) != len(wanted):
            raise ValueError(f"in_keys must be {len(wanted)}, got {self.in_keys}")
        self.place_key = place_key
        if place_key is not None:
            self.in_keys.append(place_key)
        require_callables(embed=embed, compare=compare, locomotion=locomotion)
        require_parts(rules, "rules", "NavigatorRules", "tc_reach", "hops", "lookahead")
        self.map = map
        self.embed = embed
        self.compare = compare
        self.locomotion = locomotion
        self.rules = rules
        self.goal_reward = goal_reward
        self.one_hot = one_hot
        self.generator = torch.Generator().manual_seed(seed)
        self.localiser = Localiser(map, compare, rules)
        # Number of agents and version of the map that the state is for.
        self._made_for: tuple[int, int] | None = None

    @classmethod
    def over(
        cls,
        map: SeeingMap,
        locomotion: Locomotion,
        *,
        rules: NavigatorRules | None = None,
        **options: Any,
    ) -> Self:
        """One that sees with a map's own networks, by default by its ``tc_reach``.

        ``options`` are other arguments of the class.
        """
        require_parts(map, "map", "a TopologicalMap", "embed", "compare", "rules")
        rules = rules or NavigatorRules(tc_reach=map.rules.tc_reach)
        return cls(map, map.embed, map.compare, locomotion, rules, **options)

    def _resize(self, num_agents: int, num_goal_views: int, length: int) -> None:
        rules, known = self.rules, self.map
        planner = Planner(known.num_waypoints, known.edges, known.edge_cost)
        self.localiser = Localiser(known, self.compare, rules, num_agents)
        self.goals = GoalNodes(
            num_agents, num_goal_views, length, patience=rules.goal_patience
        )
        after, growth = rules.fade_after, rules.fade_growth
        self.plans = Plans(planner, self.goals, fade_after=after, fade_growth=growth)
        watch = EdgeProgress if rules.block_on == "edge" else Progress
        self.progress = watch(num_agents, patience=rules.block_after)
        self.sampler = ActionSampler(num_agents, rules, self.generator)
        # Decisions for which an agent still acts at random.
        self._lost_left = torch.zeros(num_agents, dtype=torch.int64)
        # Who closed an edge in the decision before.
        self._gave_up = torch.zeros(num_agents, dtype=torch.bool)
        self._made_for = (num_agents, self.map.version)

    @torch.no_grad()
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        data = keys.select_entries(tensordict, self.in_keys).reshape(-1)
        views, goal_views, is_init = (data[key] for key in self.in_keys[:3])
        self._require_views(views, goal_views)
        embedding = self._embed_all(views)
        begins = is_init.reshape(-1).cpu()
        if self._made_for != (len(data), self.map.version):
            self._resize(len(data), goal_views.shape[1], embedding.shape[1])
            begins = torch.ones_like(begins)
        moved = begins
        if self.goal_reward is not None:
            reward = data[self.in_keys[3]].reshape(-1).cpu()
            moved = begins | (reward >= self.goal_reward)
        # Who begins has no place yet, when it takes a goal.
        self._restart(moved)
        self._begin(begins, goal_views)

        place = self._locate(embedding, data)
        changed = begins | self.plans.pass_decision() | self.goals.wait(place)
        self.plans.plan(changed.nonzero().flatten().tolist())
        self.progress.restart(changed)
        place, target = self._aim(place, embedding)
        cut = self._give_up(place)
        self._gave_up = (cut >= 0).any(1)
        if self._gave_up.any():
            place, target = self._aim(place, embedding)
        decided = (
            place,
            target.masked_fill(target == place, -1),
            self.plans.end(place),
            self.plans.cost(place).float(),
            self.plans.num_cuts,
            *cut.unbind(1),
            place < 0,
        )
        shape, device = tensordict.batch_size, tensordict.device
        action = self._act(place, target, embedding)
        action = action.reshape(shape + action.shape[1:]).to(device)
        tensordict.set(keys.ACTION, action)
        for key, value in zip(_DECIDED, decided, strict=True):
            tensordict.set(key, value.reshape(*shape, 1).to(device))
        return tensordict

    def took(self, action: Tensor) -> None:
        """Say what agents did in place of the actions that it wrote, in their shape."""
        number = action.argmax(-1) if self.one_hot else action
        self.sampler.last_action = number.reshape(-1).cpu()

    def _require_views(self, views: Tensor, goal_views: Tensor) -> None:
        """Goal views may be of another size, but are several of each agent."""
        alike = views.shape[-1] == goal_views.shape[-1]
        alike |= views.shape[-3:-2] == goal_views.shape[-3:-2]
        if goal_views.ndim != views.ndim + 1 or not alike:
            one = ", ".join(map(str, views.shape[1:]))
            rule = f"{self.in_keys[1]!r} must be V views of each agent, [*B, V, {one}]"
            raise ValueError(f"{rule}, got [*B, {str([*goal_views.shape[1:]])[1:]}")

    def _embed_all(self, views: Tensor) -> Tensor:
        embedding = self.embed(views)
        length = self.map.embeddings.shape[1]
        require_returned("embed", embedding, N=len(views), D=length)
        return embedding.float()

    def _begin(self, begins: Tensor, goal_views: Tensor) -> None:
        agents = begins.nonzero().flatten()
        if not len(agents):
            return
        views = goal_views[agents.to(goal_views.device)]
        embedding = self._embed_all(views.flatten(0, 1))
        self._find_goals(agents, embedding.unflatten(0, views.shape[:2]))
        self.plans.open_all(begins)

    def _find_goals(self, agents: Tensor, embedding: Tensor) -> None:
        """Choose the waypoints that stand for goal views ``[n, V, D]`` of n agents."""
        self.goals.begin(agents, embedding, self.localiser)

    def _restart(self, agents: Tensor) -> None:
        """These agents, bool ``[N]``, have been put elsewhere."""
        self.localiser.place[agents] = -1
        self.progress.forget(agents)
        self.goals.restart(agents)
        self.sampler.forget(agents)
        self._lost_left[agents] = 0

    def _locate(self, embedding: Tensor, data: TensorDictBase) -> Tensor:
        if self.place_key is not None:
            self.localiser.place = data[self.place_key].reshape(-1).cpu().clone()
            return self.localiser.place.clone()
        last, path = self.localiser.place, None
        if self.rules.follow:
            leaves = self._gave_up | self.plans.cost(last).isinf()
            path = self.plans.ahead(last, self.rules.follow)
            path = path.masked_fill(leaves.unsqueeze(1), -1)
        place = self.localiser.locate(embedding, path)
        self._lost_left = (self._lost_left - 1).clamp(min=0)
        turns_lost = (place < 0) & (self._lost_left == 0)
        self._lost_left[turns_lost] = self.rules.lost_for
        return place.masked_fill(self._lost_left > 0, -1)

    def _aim(self, place: Tensor, embedding: Tensor) -> tuple[Tensor, Tensor]:
        """Places and the waypoints to walk to, ``[N]``; -1 without a path: lost."""
        self.plans.open_up(place)
        place = place.masked_fill(self.plans.cost(place).isinf(), -1)
        path = self.plans.ahead(place, self.rules.lookahead)
        reachable = self.localiser.similarity(embedding, path) > self.rules.tc_reach
        reachable &= ~self.plans.is_closed_to(place, path)
        reachable[:, 0] = True
        farthest = self.rules.lookahead - 1 - reachable.flip(1).int().argmax(1)
        target = path.gather(1, farthest.unsqueeze(1)).squeeze(1)
        return place, target.masked_fill(place < 0, -1)

    def _give_up(self, place: Tensor) -> Tensor:
        """Close what does not lead on; the ends of the edge that failed, or -1."""
        stuck = self.progress.watch(place, self.plans.cost(place))
        ends = torch.full((len(place), 2), -1)
        for agent in stuck.nonzero().flatten().tolist():
            node, level, reach = self.progress.give_up(agent)
            if reach is None:
                onward = self.plans.close_edge(agent, node)
            else:
                hops = min(reach, self.rules.hops)
                onward = self.plans.close(agent, node, level, hops=hops)
            ends[agent] = torch.tensor([node, onward])
        return ends

    def _act(self, place: Tensor, target: Tensor, embedding: Tensor) -> Tensor:
        there = self.map.embeddings[target.clamp(min=0)].float().cpu()
        at_goal = (place >= 0) & (place == target)
        there = torch.where(at_goal.unsqueeze(1), self.goals.view_at(place), there)
        logits = self.locomotion(embedding, there.to(embedding.device))
        require_returned("locomotion", logits, N=len(embedding), A=None)
        logits = logits.float().cpu()
        drawn = self.sampler.draw(logits, place >= 0, embedding.cpu())
        return one_hot(drawn, logits.shape[1]) if self.one_hot else drawn
