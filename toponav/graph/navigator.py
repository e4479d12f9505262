"""`Navigator`: a policy that walks to goal views over a topological map."""

from collections.abc import Callable, Sequence

import torch
from tensordict import NestedKey, TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torch import Tensor

from toponav.graph.blockages import Blockages
from toponav.graph.goal_nodes import GoalNodes
from toponav.graph.localiser import Localiser, Map
from toponav.graph.planner import Planner
from toponav.graph.progress import Progress
from toponav.graph.sampler import ActionSampler
from toponav.graph.waypoints import Compare, Embed
from toponav.graph.ways import Ways
from toponav.keys import (
    ACTION,
    CUT_FROM,
    CUT_TO,
    GOAL_NODE,
    GOAL_VIEWS,
    IS_INIT,
    LOST,
    NUM_CUTS,
    PATH_COST,
    PIXELS,
    PLACE,
    PREVIOUS_REWARD,
    TARGET,
)

#: Embeddings here and there, ``[N, D]`` each, to logits of the actions ``[N, A]``.
Locomotion = Callable[[Tensor, Tensor], Tensor]

_OUT_KEYS = [
    ACTION,
    PLACE,
    TARGET,
    GOAL_NODE,
    PATH_COST,
    NUM_CUTS,
    CUT_FROM,
    CUT_TO,
    LOST,
]


class Navigator(TensorDictModuleBase):
    """Finds its place on a map, plans a way to the goal, and walks it view by view.

    In each decision, for every env of the batch by itself:

    1. *localise*: the waypoint most like the view, of the path if possible, else near
       the last place, else anywhere (`Localiser`); if there is none, the agent is lost
       and acts at random for ``lost_for`` decisions before it looks again;
    2. *plan*: the cheapest way to the nearest of the waypoints that stand for the goal
       (`GoalNodes`, `Planner`), around the edges that were found closed;
    3. *aim*: at the farthest of the next ``lookahead`` waypoints of the path that is
       reachable, by a similarity above ``tc_reach`` and not over a closed edge, else
       at the next one; at the goal's own waypoint, at the goal view;
    4. *act*: draw an action from ``locomotion``'s logits at ``temperature``;
    5. *give up*: an agent that comes no nearer to its goal (`Progress`) closes the edge
       that would lead on from where it got, and the longer it is stuck, the more of
       the edges nearby that lead as near to the goal (`Blockages`); it plans anew at
       once, and looks for its place off the path too. If no way is left, the oldest cut
       opens again.

    When the task pays ``goal_reward``, the agent has been put elsewhere: it forgets its
    place and looks at the whole map; what it learned about closed edges and about wrong
    goal waypoints stays until the episode ends.

    It is a policy for any TorchRL collector or rollout, with any batch shape. Its state
    lies in itself, one row an env, and begins anew where ``is_init`` is true, so one
    object must not serve two collectors. When the map's version changes, all rows begin
    anew. It reads no privileged key. The callables are not its submodules: they are
    neither moved nor saved with it, get no gradient and must be in ``eval()`` mode.

    Reference:
        The paper, "Navigation implementation", Figs. 10 and 11, eq. 15.

    Args:
        map: see `Map`; `TopologicalMap` is one.
        embed: views ``[N, H, W, C]`` to embeddings ``[N, D]``.
        compare: embeddings ``[N, D]`` and prepared waypoints ``[N, M, P]`` to
            similarities ``[N, M]`` in [0, 1].
        locomotion: embeddings here and there, ``[N, D]`` each, to logits of the actions
            that lead there, ``[N, A]``.
        tc_reach: see `Localiser`.
        hops: see `Localiser`.
        window: see `Localiser`.
        shortlist: see `Localiser`.
        stay_above: see `Localiser`.
        follow: waypoints of the path ahead among which, and its last place, an agent
            looks for its place first; 0 for none, it then looks around its last place
            at once.
        lookahead: waypoints of the path to look at for the next target.
        temperature: of the softmax over the logits; 0 takes the most probable action.
        avoid_futile: whether an action that left the view exactly as it was is not
            drawn again until the view changes, such as walking against a wall.
        block_after: patience of `Progress`, ``None`` never closes an edge.
        keep_cuts: whether cuts stay closed from episode to episode.
        fade_after: decisions after which a cut opens again, ``None`` for never.
        goal_patience: see `GoalNodes`.
        lost_for: random actions of an agent that is lost.
        goal_reward: a reward of at least this much means that the goal was reached.
        in_keys: keys of the view, uint8 ``[*B, H, W, C]``, of the goal views, uint8
            ``[*B, V, H, W, C]``, of the task's reward for the decision before, float32
            ``[*B, 1]`` (`PreviousReward` with a ``clip`` of at least ``goal_reward``
            writes it), and of the flag of a first decision, bool ``[*B, 1]`` (TorchRL's
            ``InitTracker``).
        out_keys: keys of the action, int64 ``[*B]``, and of what was decided, each
            ``[*B, 1]``: place, target, goal waypoint, cost of the path, number of cuts,
            the ends of a cut made now, and whether the agent is lost.
        seed: of the actions drawn.

    Raises:
        ValueError: if an argument is out of range, or the map is empty.

    Examples:
        Three places in a row that are numbers, and two actions, up and down:

        >>> from types import SimpleNamespace
        >>> from tensordict import TensorDict
        >>> from toponav.keys import GOAL_VIEWS, IS_INIT, PIXELS, PREVIOUS_REWARD
        >>> numbers = torch.arange(3.0).unsqueeze(1)
        >>> lane = SimpleNamespace(
        ...     num_waypoints=3,
        ...     embeddings=numbers,
        ...     prepared=numbers,
        ...     edges=torch.tensor([[0, 1], [1, 2]]),
        ...     edge_cost=torch.ones(2),
        ...     version=0,
        ...     neighbourhood=lambda node, hops: torch.arange(3),
        ... )
        >>> navigator = Navigator(
        ...     lane,
        ...     embed=lambda views: views.flatten(1).float(),
        ...     compare=lambda one, many: (one.unsqueeze(1) - many)[..., 0].abs() < 1,
        ...     locomotion=lambda here, there: (there - here) * torch.tensor([1.0, -1]),
        ...     tc_reach=0.5,
        ...     temperature=0.0,
        ... )
        >>> data = TensorDict({PIXELS: torch.zeros(1, 1, 1, 1)}, [1])
        >>> data[GOAL_VIEWS] = torch.full((1, 1, 1, 1, 1), 2.0)
        >>> data[PREVIOUS_REWARD] = torch.zeros(1, 1)
        >>> data[IS_INIT] = torch.ones(1, 1, dtype=torch.bool)
        >>> told = navigator(data)
        >>> told["action"].item(), told["navigation", "path_cost"].item()
        (0, 2.0)

    Shape notation:
        B: batch of environments, N of them.  H, W, C: height, width, channels.  V: goal
        views.  D: embedding.  M: candidates.  P: prepared entry.  A: actions.
    """

    def __init__(
        self,
        map: Map,
        embed: Embed,
        compare: Compare,
        locomotion: Locomotion,
        *,
        tc_reach: float,
        hops: int = 7,
        window: int = 1,
        shortlist: int | None = None,
        stay_above: float | None = None,
        follow: int = 6,
        lookahead: int = 7,
        temperature: float = 1.0,
        avoid_futile: bool = False,
        block_after: int | None = 40,
        keep_cuts: bool = False,
        fade_after: int | None = None,
        goal_patience: int | None = 20,
        lost_for: int = 5,
        goal_reward: float = 10.0,
        in_keys: Sequence[NestedKey] | None = None,
        out_keys: Sequence[NestedKey] | None = None,
        seed: int = 0,
    ) -> None:
        super().__init__()
        in_default = [PIXELS, GOAL_VIEWS, PREVIOUS_REWARD, IS_INIT]
        self.in_keys = in_default if in_keys is None else list(in_keys)
        self.out_keys = _OUT_KEYS if out_keys is None else list(out_keys)
        if len(self.in_keys) != len(in_default) or len(self.out_keys) != len(_OUT_KEYS):
            raise ValueError(
                f"in_keys must be {len(in_default)} and out_keys {len(_OUT_KEYS)}, got "
                f"{self.in_keys} and {self.out_keys}"
            )
        for name, number, least in (
            ("follow", follow, 0),
            ("lookahead", lookahead, 1),
            ("lost_for", lost_for, 1),
        ):
            if number < least:
                raise ValueError(f"{name} must be at least {least}, got {number}")
        self.map = map
        self.embed = embed
        self.locomotion = locomotion
        self.localiser = Localiser(
            map,
            compare,
            tc_reach=tc_reach,
            hops=hops,
            window=window,
            shortlist=shortlist,
            stay_above=stay_above,
        )
        self.goals = GoalNodes(patience=goal_patience)
        self.progress = Progress(patience=block_after)
        self.sampler = ActionSampler(
            temperature=temperature, avoid_futile=avoid_futile, seed=seed
        )
        self.follow = follow
        self.lookahead = lookahead
        self.keep_cuts = keep_cuts
        self.fade_after = fade_after
        self.lost_for = lost_for
        self.goal_reward = goal_reward
        # Number of agents and version of the map that the state is for.
        self._made_for: tuple[int, int] | None = None

    def _resize(self, num_agents: int, num_goal_views: int, length: int) -> None:
        """Begin with N agents that know nothing, and with the map as it is now."""
        planner = Planner(self.map.num_waypoints, self.map.edges, self.map.edge_cost)
        num_edges = len(planner.edges)
        self.blockages = Blockages(num_agents, num_edges, fade_after=self.fade_after)
        self.ways = Ways(planner, self.goals, self.blockages)
        self.localiser.resize(num_agents)
        self.goals.resize(num_agents, num_goal_views, length)
        self.progress.resize(num_agents)
        self.sampler.resize(num_agents)
        # Decisions that an agent goes on acting at random.
        self._lost_left = torch.zeros(num_agents, dtype=torch.int64)
        # Who closed an edge in the decision before.
        self._gave_up = torch.zeros(num_agents, dtype=torch.bool)
        self._made_for = (num_agents, self.map.version)

    @torch.no_grad()
    def forward(self, tensordict: TensorDictBase) -> TensorDictBase:
        data = tensordict.select(*self.in_keys).reshape(-1)
        views, goal_views, reward, is_init = (data[key] for key in self.in_keys)
        embedding = self.embed(views).float()
        begins = is_init.reshape(-1).cpu()
        if self._made_for != (len(data), self.map.version):
            self._resize(len(data), goal_views.shape[1], embedding.shape[1])
            begins = torch.ones_like(begins)
        self._begin(begins, goal_views)
        self._restart(begins | (reward.reshape(-1).cpu() >= self.goal_reward))

        place = self._locate(embedding)
        changed = begins | self.blockages.pass_decision() | self.goals.wait(place)
        self.ways.plan(changed.nonzero().flatten().tolist())
        self.progress.restart(changed)
        place, target = self._aim(place, embedding)
        cut = self._give_up(place)
        self._gave_up = (cut >= 0).any(1)
        if self._gave_up.any():
            place, target = self._aim(place, embedding)
        action = self._act(place, target, embedding)
        return self._write(tensordict, action, place, target, cut)

    def _begin(self, begins: Tensor, goal_views: Tensor) -> None:
        """Localise the goals of new episodes."""
        agents = begins.nonzero().flatten()
        if not len(agents):
            return
        views = goal_views[agents.to(goal_views.device)]
        embedding = self.embed(views.flatten(0, 1)).float()
        embedding = embedding.reshape(*views.shape[:2], -1)
        self.goals.begin(agents, embedding, self.localiser)
        self.sampler.forget(begins)
        if not self.keep_cuts:
            self.blockages.clear(begins)

    def _restart(self, agents: Tensor) -> None:
        """These agents have been put elsewhere."""
        self.localiser.forget(agents)
        self.progress.forget(agents)
        self.goals.restart(agents)
        self.sampler.forget(agents)
        self._lost_left[agents] = 0

    def _locate(self, embedding: Tensor) -> Tensor:
        """The place of each agent, -1 while it is lost."""
        place = self.localiser.locate(embedding, self._path())
        self._lost_left = (self._lost_left - 1).clamp(min=0)
        turns_lost = (place < 0) & (self._lost_left == 0)
        self._lost_left[turns_lost] = self.lost_for
        return place.masked_fill(self._lost_left > 0, -1)

    def _path(self) -> Tensor | None:
        """The path ahead of each agent, int64 ``[N, follow]``, -1 without one.

        Who has just given up looks around: perhaps it is not where its path leads.
        """
        if not self.follow:
            return None
        last = self.localiser.place
        path = self.ways.ahead(last, self.follow)
        leaves = self._gave_up | self.ways.cost(last).isinf()
        return path.masked_fill(leaves.unsqueeze(1), -1)

    def _aim(self, place: Tensor, embedding: Tensor) -> tuple[Tensor, Tensor]:
        """Find a way for everyone, and the waypoint of it to walk to.

        Returns:
            The places and the targets, int64 ``[N]``; both -1 for an agent from whose
            place no way leads to the goal, even with all cuts open, so that it acts as
            if it were lost. The target is the place itself at the goal.
        """
        self.ways.open_up(place)
        place = place.masked_fill(self.ways.cost(place).isinf(), -1)
        path = self.ways.ahead(place, self.lookahead)
        reachable = self.localiser.similarity(embedding, path) > self.localiser.tc_reach
        reachable &= ~self.ways.leaps(place, path)
        reachable[:, 0] = True
        farthest = self.lookahead - 1 - reachable.flip(1).int().argmax(1)
        target = path.gather(1, farthest.unsqueeze(1)).squeeze(1)
        return place, target.masked_fill(place < 0, -1)

    def _give_up(self, place: Tensor) -> Tensor:
        """Close what does not lead on; the ends of the edge that failed, or -1.

        Returns:
            int64 ``[N, 2]``; the other edges that were closed with it are not told.
        """
        stuck = self.progress.watch(place, self.ways.cost(place))
        ends = torch.full((len(place), 2), -1)
        for agent in stuck.nonzero().flatten().tolist():
            node, level, reach = self.progress.give_up(agent)
            ends[agent] = torch.tensor([node, self.ways.onward(agent, node)])
            hops = min(reach, self.localiser.hops)
            self.ways.close(agent, node, level, hops=hops)
        return ends

    def _act(self, place: Tensor, target: Tensor, embedding: Tensor) -> Tensor:
        """Draw the actions, int64 ``[N]`` on the CPU."""
        there = self.map.embeddings[target.clamp(min=0)].float().cpu()
        at_goal = (place >= 0) & (place == target)
        there = torch.where(at_goal.unsqueeze(1), self.goals.view_at(place), there)
        logits = self.locomotion(embedding, there.to(embedding.device))
        return self.sampler.draw(logits.float().cpu(), place >= 0, embedding.cpu())

    def _write(
        self,
        tensordict: TensorDictBase,
        action: Tensor,
        place: Tensor,
        target: Tensor,
        cut: Tensor,
    ) -> TensorDictBase:
        told = (
            place,
            target.masked_fill(target == place, -1),
            self.ways.end(place),
            self.ways.cost(place).float(),
            self.blockages.num_cuts,
            *cut.unbind(1),
            place < 0,
        )
        shape, device = tensordict.batch_size, tensordict.device
        tensordict.set(self.out_keys[0], action.reshape(shape).to(device))
        for key, value in zip(self.out_keys[1:], told, strict=True):
            tensordict.set(key, value.reshape(*shape, 1).to(device))
        return tensordict
