"""`TopologicalMap`: waypoints and edges, grown from what explorers see."""

from collections.abc import Mapping
from typing import Any

import torch
from tensordict import TensorDictBase
from torch import Tensor

from toponav.graph.discovery import Discovery
from toponav.graph.pieces import read_pieces
from toponav.graph.rules import EdgeRule, ExtendBy, Rules
from toponav.graph.waypoint_graph import WaypointGraph
from toponav.graph.waypoints import Compare, Embed, Waypoints

#: The parts of a map's state.
_WAYPOINTS = ("embeddings", "prepared", "images", "origins")
_EDGES = ("edges", "traversals", "edge_similarity")


class TopologicalMap:
    """A graph of views, each of which stands for what is close to it in time.

    Observations are fed in the order in which they were made, as episodes or as the
    batches that a collector yields. Each is mapped to a waypoint or becomes one:

    1. its similarity to a waypoint is the mean over the ``window`` observations on
       either side of it and itself;
    2. it stays at the last waypoint while that passes ``tc_threshold``
       (``hysteresis``); if not, the most similar one of the ``nearby`` waypoints
       around the last takes over;
    3. if none of them passes, the most similar one of the ``shortlist`` of all
       waypoints does, by the mean over ``search_window`` observations on either side:
       a leap through the map must be backed by more than one view;
    4. if none at all passes, the observation becomes a waypoint. That is eq. 9's
       elimination for the first episode and eq. 11's extension for all later ones.

    A new waypoint is linked with those that it reaches, ``similarity > tc_reach``, and
    with the one before it in time (eqs. 10 and 12); a step from one known waypoint to
    another links them too (``link_transitions``). Each edge counts its traversals;
    one that was only seen costs ``unwalked_cost`` times as much as one that was walked.

    With ``window=0, search_window=0, hysteresis=False, nearby=None, shortlist=None``
    this is the paper's procedure to the letter. The defaults made far better maps in
    trials, since neighbouring frames vote against single views that look like another
    place, and cost the same whatever the size of the map, but for the distances behind
    the shortlist, which are a thousand times cheaper than comparisons.

    Nothing here reads a privileged key. The networks are callables and stay their
    owner's; they must be in ``eval()`` mode.

    Reference:
        The paper, "Space topological cognition", eqs. 9 to 12.

    Args:
        embed: views ``[N, H, W, C]`` to embeddings ``[N, D]``.
        compare: embeddings ``[N, D]`` and memory ``[N, M, P]`` to similarities
            ``[N, M]`` in [0, 1].
        prepare: embeddings ``[N, M, D]`` to entries of the memory ``[N, M, P]``;
            ``None`` keeps the embeddings, ``P = D``.
        tc_threshold: an observation is mapped if its similarity is above it, in
            [0, 1). Calibrate it by the share of views that become waypoints.
        tc_reach: a waypoint is reached if its similarity is above it, in [0, 1); at
            most ``tc_threshold``.
        edges: which clauses of eq. 10 make edges: ``"reach"`` (similarity), ``"time"``
            (successive observations) or ``"both"`` (the paper's).
        extend_by: which view of an episode after the first says what a new waypoint
            reaches: ``"itself"`` (eq. 10) or the ``"previous"`` one (eq. 12).
        link_transitions: whether a step between two known waypoints links them; if
            not, such a step counts only where there is an edge already.
        window: observations on either side that vote; 0 for none.
        search_window: the same in a search among all waypoints.
        surroundings: a waypoint that was found in a search must fit what lies around
            it too: of the observations up to so many before and after, eight are
            compared with the waypoints nearest by edges, twice as many as this; 0 for
            no such test. Bare walls look alike, the ways to them do not.
        surroundings_above: the mean over those observations of the similarity to the
            nearest of those waypoints must be above this, in [0, 1).
        hysteresis: whether an observation stays where the last one was if it can.
        nearby: how many waypoints around the last one, nearest by edges, are compared
            before all others; ``None`` compares all at once, which costs more with
            every waypoint.
        shortlist: how many waypoints a search compares, those whose prepared entries
            are nearest; ``None`` for all. A new waypoint is linked with these alone.
        unwalked_cost: cost of an edge that was never walked, at least 1.
        respawn_reward: a task reward from this on means that the agent was put
            elsewhere, so that no edge joins before and after; ``None`` if it never is.

    Raises:
        ValueError: if an argument is out of range.

    Examples:
        Views of one pixel, compared by colour. The third is like the second, the
        fourth like the first:

        >>> from tensordict import TensorDict
        >>> grey = torch.tensor([0.0, 0.5, 0.55, 0.0]).reshape(4, 1)
        >>> flags = torch.tensor([[False], [False], [False], [True]])
        >>> episode = TensorDict({"embedding": grey, "next": {"done": flags}}, [4])
        >>> grown = TopologicalMap(
        ...     embed=lambda views: views.flatten(1).float(),
        ...     compare=lambda one, many: 1 - (one.unsqueeze(1) - many).abs().mean(-1),
        ...     tc_threshold=0.9,
        ...     tc_reach=0.7,
        ...     window=0,
        ...     search_window=0,
        ... )
        >>> grown.add_episode(episode)
        tensor([0, 1, 1, 0])
        >>> grown.num_waypoints, grown.edges, grown.edge_cost
        (2, tensor([[0, 1]]), tensor([[1., 1.]]))

    Shape notation:
        W: waypoints.  E: edges, or environments.  N: any number.  T: time.
        D: embedding.  M: memory.  P: prepared entry.
    """

    def __init__(
        self,
        embed: Embed,
        compare: Compare,
        *,
        prepare: Embed | None = None,
        tc_threshold: float,
        tc_reach: float,
        edges: EdgeRule = "both",
        extend_by: ExtendBy = "itself",
        link_transitions: bool = True,
        window: int = 1,
        search_window: int = 2,
        surroundings: int = 0,
        surroundings_above: float = 0.9,
        hysteresis: bool = True,
        nearby: int | None = 16,
        shortlist: int | None = 32,
        unwalked_cost: float = 3.0,
        respawn_reward: float | None = 10.0,
    ) -> None:
        self.rules = Rules(
            tc_threshold=tc_threshold,
            tc_reach=tc_reach,
            edges=edges,
            extend_by=extend_by,
            link_transitions=link_transitions,
            window=window,
            search_window=search_window,
            surroundings=surroundings,
            surroundings_above=surroundings_above,
            hysteresis=hysteresis,
            nearby=nearby,
            shortlist=shortlist,
        )
        self.respawn_reward = respawn_reward
        #: The version of the networks that made the embeddings.
        self.network_version = 0
        self.waypoints = Waypoints(embed, compare, prepare)
        self.graph = WaypointGraph(unwalked_cost=unwalked_cost)
        self._discovery = Discovery(self.waypoints, self.graph, self.rules)

    @property
    def tc_threshold(self) -> float:
        """An observation is mapped if its similarity is above it."""
        return self.rules.tc_threshold

    @property
    def tc_reach(self) -> float:
        """A waypoint is reached if its similarity is above it."""
        return self.rules.tc_reach

    @property
    def num_waypoints(self) -> int:
        """W."""
        return len(self.waypoints)

    @property
    def version(self) -> int:
        """Goes up with every change of waypoints, edges or their costs."""
        return self.graph.version

    @property
    def embeddings(self) -> Tensor:
        """float32 ``[W, D]``."""
        return self.waypoints.embeddings

    @property
    def prepared(self) -> Tensor:
        """What comparisons are made with, float32 ``[W, P]``."""
        return self.waypoints.prepared

    @property
    def images(self) -> Tensor:
        """The views, uint8 ``[W, H, W, C]``; empty if none were given."""
        return self.waypoints.images

    @property
    def origins(self) -> Tensor:
        """Where the waypoints come from, int64 ``[W, 2]``.

        The number of the environment, and how many observations of it were fed before.
        """
        return self.waypoints.origins

    @property
    def edges(self) -> Tensor:
        """Undirected, each once, the lower waypoint first; int64 ``[E, 2]``."""
        return self.graph.edges

    @property
    def edge_cost(self) -> Tensor:
        """1 where the edge was walked, else ``unwalked_cost``; float32 ``[E]``."""
        return self.graph.edge_cost

    @property
    def traversals(self) -> Tensor:
        """How often each edge was walked, int64 ``[E]``."""
        return self.graph.traversals

    @property
    def edge_similarity(self) -> Tensor:
        """Similarity of each edge's ends, NaN if never judged; float32 ``[E]``."""
        return self.graph.edge_similarity

    def similarities(self, embedding: Tensor, nodes: Tensor | None = None) -> Tensor:
        """How alike views are to all waypoints, or to some.

        Args:
            embedding: ``[N, D]``.
            nodes: int64 ``[A]``, numbers of waypoints; ``None`` for all.

        Returns:
            float32 ``[N, W]`` or ``[N, A]``, in [0, 1].
        """
        return self.waypoints.similarities(embedding, nodes)

    def neighbourhood(self, node: int, hops: int) -> Tensor:
        """Waypoints at most so many edges from one, itself included, in order.

        Args:
            node: number of the waypoint.
            hops: 0 or more.

        Returns:
            int64 ``[A]``.
        """
        return self.graph.neighbourhood(node, hops)

    def add_episode(self, data: TensorDictBase) -> Tensor:
        """Add a whole episode.

        Args:
            data: ``[T]`` decisions in a row with `EMBEDDING`, or `PIXELS` to embed.
                The views are kept with the waypoints if they are there.

        Returns:
            int64 ``[T]``, the waypoint to which each observation is mapped.

        Raises:
            ValueError: if ``data`` is not ``[T]`` with ``T >= 1``.
        """
        if data.batch_dims != 1 or not len(data):
            raise ValueError(f"an episode must be [T >= 1], got {list(data.shape)}")
        return self.add_episodes(data.unsqueeze(0))[0]

    def add_episodes(self, data: TensorDictBase) -> Tensor:
        """Add whole episodes, one after the other.

        Args:
            data: ``[E, T]``, see `add_episode`.

        Returns:
            int64 ``[E, T]``, the waypoint to which each observation is mapped.

        Raises:
            ValueError: if ``data`` is not ``[E, T]`` with ``T >= 1``.
        """
        places = [
            self._discovery.add(
                read_pieces(
                    one,
                    embed=self.waypoints.embed,
                    network_version=self.network_version,
                    respawn_reward=self.respawn_reward,
                    whole=True,
                )
            )
            for one in _require_rows(data).split(1)
        ]
        return torch.stack([torch.cat(some) for some in places])

    def extend(self, data: TensorDictBase) -> int:
        """Go on with the episodes of many environments, as far as a batch takes them.

        The next batch goes on where this one ends. Of an unfinished episode only the
        last observations are kept, twice the wider window for each environment; those
        whose votes are not complete are mapped with the next batch.

        Args:
            data: ``[E, T]`` as a collector yields it, with `EMBEDDING` or `PIXELS`,
                `ENV_ID` and the done flags. If `NETWORKS_VERSION` is there and not
                the map's ``network_version``, its views are embedded anew.

        Returns:
            The number of new waypoints.

        Raises:
            ValueError: if ``data`` is not ``[E, T]``, or if its embeddings are of
                other networks than the map's and it has no views.
        """
        before = self.num_waypoints
        self._discovery.add(
            read_pieces(
                _require_rows(data),
                embed=self.waypoints.embed,
                network_version=self.network_version,
                respawn_reward=self.respawn_reward,
            )
        )
        return self.num_waypoints - before

    def refresh(
        self,
        version: int,
        *,
        tc_threshold: float | None = None,
        tc_reach: float | None = None,
    ) -> int:
        """Embed all waypoints anew, after the networks' weights changed.

        Waypoints stay; all edges are judged again, and those that were never walked
        and are not reached any more are dropped.

        Args:
            version: of the networks, from now on.
            tc_threshold: that fits the new weights; ``None`` keeps it.
            tc_reach: the same.

        Returns:
            The number of edges dropped.

        Raises:
            ValueError: if the views were not given, or a threshold is out of range.
        """
        self.rules.set_thresholds(tc_threshold, tc_reach)
        self.waypoints.refresh()
        self._discovery.refresh()
        self.network_version = version
        return self._judge_edges()

    def _judge_edges(self) -> int:
        similarity = self.waypoints.pair_similarities(*self.edges.unbind(1))
        return self.graph.judge(similarity, self.tc_reach)

    def merge(self, into: Tensor) -> Tensor:
        """Make some waypoints one; see `sparsify` for which.

        Args:
            into: int64 ``[W]``: the waypoint that each becomes part of, itself if it
                stays. One that stays must be its own.

        Returns:
            int64 ``[W]``, the new number of each waypoint.

        Raises:
            ValueError: if a waypoint becomes part of one that does not stay.
        """
        if not torch.equal(into[into], into):
            raise ValueError(
                "a waypoint must become part of one that stays, got "
                f"{int((into[into] != into).nonzero()[0])} in one that goes"
            )
        kept = (into == torch.arange(len(into))).nonzero().flatten()
        number = torch.searchsorted(kept, into)
        self.waypoints.keep(kept)
        self.graph.merge(number)
        self._discovery.renumber(number)
        return number

    def state_dict(self) -> dict[str, object]:
        """Everything but the networks and the episodes that are not finished."""
        names: tuple[str, ...] = (*_WAYPOINTS, *_EDGES)
        state: dict[str, object] = {name: getattr(self, name).clone() for name in names}
        names = ("version", "network_version", "tc_threshold", "tc_reach")
        return state | {name: getattr(self, name) for name in names}

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Become the map of `state_dict`; unfinished episodes are forgotten."""
        self.waypoints.restore(*(state[name] for name in _WAYPOINTS))
        self.rules.set_thresholds(state["tc_threshold"], state["tc_reach"])
        self.graph.restore(
            self.num_waypoints,
            *(state[name] for name in _EDGES),
            version=state["version"],
        )
        self.network_version = state["network_version"]
        self._discovery.forget()


def _require_rows(data: TensorDictBase) -> TensorDictBase:
    if data.batch_dims != 2 or not data.shape[1]:
        raise ValueError(f"episodes must be [E, T >= 1], got {list(data.shape)}")
    return data
