"""`TopologicalMap`, built from what explorers see."""

from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Any

import torch
from tensordict import NestedKey, TensorDictBase
from torch import Tensor

from toponav.graph.discovery import Discovery
from toponav.graph.pieces import MapKeys, Piece, cut_pieces, read_embeddings
from toponav.graph.rules import MapRules
from toponav.graph.trajectories import Trajectories
from toponav.graph.views import Views
from toponav.graph.waypoint_graph import WaypointGraph
from toponav.graph.waypoints import Compare, Embed, Waypoints
from toponav.parts import require_callables, require_parts
from toponav.views import (
    ChannelOrder,
    as_given,
    channels_last,
    check_order,
    check_views,
)


class TopologicalMap:
    """A graph of views, each of which stands for what is close to it in time.

    Observations come in order, as episodes or as a collector's batches. Each is mapped
    to a waypoint or becomes one, by `MapRules`:

    1. its similarity to a waypoint is the mean over ``window`` observations on either
       side of it and itself;
    2. it stays at the last waypoint while that passes ``tc_threshold``
       (``hysteresis``); if not, the most similar of the ``nearby`` ones takes over;
    3. if none of them passes, the most similar of the ``shortlist`` of all does, by the
       mean over ``search_window`` observations on either side;
    4. if none at all passes, it becomes a waypoint: eq. 9's elimination for the first
       episode, and eq. 11's extension for all later ones.

    A new waypoint is linked with those that it reaches, ``similarity > tc_reach``, and
    with the one before it in time (eqs. 10 and 12); a step from one known waypoint to
    another links them too. Each edge counts its traversals.

    It is a `Map` to navigate by and reads no privileged key. The networks must be in
    ``eval()`` mode; what they return is kept on the CPU.

    Reference:
        The paper, "Space topological cognition", eqs. 9 to 12.

    Args:
        embed: views ``[N, H, W, C]``, as they are, to embeddings ``[N, D]``.
        compare: ``[N, D]`` and memory ``[N, M, P]`` to similarities ``[N, M]``, 0 to 1.
        rules: its choices.
        prepare: embeddings ``[N, M, D]`` to memory ``[N, M, P]``; ``None`` keeps them.
        goal_reward: a task reward of at least this much means that the agent was put
            elsewhere, so that no edge joins before and after; ``None`` if it never is.
        turns: degrees to the left by which each action turns the agent, ``[A]``, for
            ``turn_tolerance``; by default they are not known.
        views: where the waypoints' views are kept, such as a `ViewFile`; by default in
            memory.
        walks: keeps all that the map is fed, actions too, for `consolidate`; by default
            nothing is kept.
        channels: ``"HWC"``, or ``"CHW"`` for batches and ``embed`` with views ``[...,
            C, H, W]``; the map keeps them with channels last.

    Examples:
        >>> from tensordict import TensorDict
        >>> grey = torch.tensor([0.0, 0.5, 0.55, 0.0]).reshape(4, 1)
        >>> flags = torch.tensor([[False], [False], [False], [True]])
        >>> episode = TensorDict({"embedding": grey, "next": {"done": flags}}, [4])
        >>> def compare(one, many):
        ...     return 1 - (one.unsqueeze(1) - many).abs().mean(-1)
        >>> rules = MapRules(tc_threshold=0.9, tc_reach=0.7, window=0, search_window=0)
        >>> topological_map = TopologicalMap(torch.Tensor.float, compare, rules)
        >>> topological_map.add_episode(episode)
        tensor([0, 1, 1, 0])
    """

    def __init__(
        self,
        embed: Embed,
        compare: Compare,
        rules: MapRules,
        *,
        prepare: Embed | None = None,
        goal_reward: float | None = None,
        turns: Tensor | None = None,
        views: Views | None = None,
        walks: Trajectories | None = None,
        channels: ChannelOrder = "HWC",
    ) -> None:
        require_callables(embed=embed, compare=compare, prepare=prepare)
        require_parts(rules, "rules", "MapRules", "tc_threshold", "tc_reach", "window")
        if views is not None:
            require_parts(views, "views", "a ViewFile", "append", "read", "keep")
        if walks is not None:
            require_parts(walks, "walks", "Trajectories", "extend", "end", "all")
        self.embed = embed
        self.compare = compare
        self.keys = MapKeys()
        self.channels = check_order(channels)
        self.goal_reward = goal_reward
        self.turns = turns
        self.walks = walks
        #: The version of the networks that made the embeddings.
        self.network_version = 0
        self.waypoints = Waypoints(self._embedding(embed), compare, prepare, views)
        self.graph = WaypointGraph(untraversed_edge_cost=rules.untraversed_edge_cost)
        #: It has the episodes that are not finished, too.
        self.discovery = Discovery(self.waypoints, self.graph, rules)

    def _embedding(self, embed: Embed) -> Embed:
        """What embeds views with channels last."""
        if self.channels == "HWC":
            return embed
        return lambda views: embed(as_given(views, self.channels))

    def set_keys(self, **keys: NestedKey) -> None:
        """Change the keys that are read of a batch, by the names of `MapKeys`."""
        known = list(vars(self.keys))
        if unknown := [name for name in keys if name not in known]:
            raise ValueError(f"set_keys must name some of {known}, got {unknown[0]!r}")
        self.keys = replace(self.keys, **keys)

    @property
    def rules(self) -> MapRules:
        """Its choices, with the thresholds of the last `set_thresholds`."""
        return self.discovery.rules

    @property
    def num_waypoints(self) -> int:
        """Number W of waypoints."""
        return len(self.waypoints)

    @property
    def version(self) -> int:
        """Counts the changes of waypoints and edges; each resets navigators."""
        return self.graph.version

    @property
    def embeddings(self) -> Tensor:
        """Of the waypoints' views, float32 ``[W, D]``."""
        return self.waypoints.embeddings

    @property
    def prepared(self) -> Tensor:
        """What comparisons with the waypoints are made with, float32 ``[W, P]``."""
        return self.waypoints.prepared

    @property
    def edges(self) -> Tensor:
        """Each once, the lower waypoint first, in order; int64 ``[E, 2]``."""
        return self.graph.edges

    @property
    def edge_cost(self) -> Tensor:
        """From the lower waypoint to the other, and back; float32 ``[E, 2]``."""
        return self.graph.edge_cost

    def add_episode(self, data: TensorDictBase) -> Tensor:
        """Add a complete episode ``[T >= 1]``; the waypoints of its observations.

        Those that a full map has no waypoint for have -1. A flat batch of several
        episodes, ``[E * T]``, is cut where ``("next", "done")`` or the collectors'
        ``("collector", "traj_ids")`` say that one ends. What `extend` left unfinished
        of its environment ends before it.
        """
        if data.batch_dims != 1 or not len(data):
            raise ValueError(f"an episode must be [T >= 1], got {list(data.shape)}")
        pieces = self._read(data.unsqueeze(0), whole=True)
        return torch.tensor(self.discovery.add(pieces))

    def extend(self, data: TensorDictBase) -> int:
        """Continue episodes by a batch ``[E, T]``; count the new waypoints.

        Observations whose votes are not complete are mapped with the next batch, and
        embeddings of another ``network_version`` are made again from the views.
        """
        if data.batch_dims != 2 or not data.shape[1]:
            way = "rows that lie one after the other are batch.reshape(E, -1)"
            got = f"{list(data.shape)}: {way}"
            raise ValueError(f"batches must be [E, T >= 1], got {got}")
        before = self.num_waypoints
        self.discovery.add(self._read(data, whole=False))
        return self.num_waypoints - before

    def _read(self, data: TensorDictBase, *, whole: bool) -> list[Piece]:
        key = self.keys.views
        if (views := data.get(key, None)) is not None:
            check_views(repr(key), views.shape, self.channels)
            data = data.copy().set(key, channels_last(views, self.channels))
        embeddings = read_embeddings(
            data, self.keys, self.waypoints.embed, self.network_version
        )
        turns = None if self.rules.turn_tolerance is None else self.turns
        pieces = cut_pieces(
            data,
            self.keys,
            embeddings,
            self.goal_reward,
            whole=whole,
            turns=turns,
            with_actions=self.walks is not None,
        )
        if whole:
            self.end_episodes({piece.env for piece in pieces})
        if self.walks is not None:
            self.walks.extend(pieces)
        return pieces

    def set_thresholds(self, tc_threshold: float, tc_reach: float) -> None:
        """Change the rules' thresholds."""
        self.discovery.rules = replace(
            self.rules, tc_threshold=tc_threshold, tc_reach=tc_reach
        )

    def refresh(self, version: int) -> int:
        """Embed all waypoints again, after the networks' weights changed to a version.

        Waypoints stay; all edges are compared again, and those that were never
        traversed and are not reached any more are dropped and counted.
        """
        self.waypoints.refresh()
        self.discovery.refresh()
        self.network_version = version
        similarity = self.waypoints.pair_similarities(*self.edges.unbind(1))
        return self.graph.update_similarities(similarity, self.rules.tc_reach)

    def merge(self, into: Tensor) -> Tensor:
        """Unite waypoints; the new number of each, int64 ``[W]``.

        ``into``, int64 ``[W]``, has what each becomes part of; itself if it stays.
        """
        if not torch.equal(into[into], into):
            raise ValueError(
                "a waypoint must become part of one that stays, got "
                f"{int((into[into] != into).nonzero()[0])} in one that goes"
            )
        kept = into.unique()
        number = torch.searchsorted(kept, into)
        self.waypoints.keep(kept)
        self.graph.merge(number)
        self.discovery.renumber(number)
        return number

    def rebuild(
        self, kept: Tensor, moves: Mapping[tuple[int, int], int], poses: Tensor
    ) -> None:
        """Keep some waypoints, and edges alone where there were ``moves``.

        ``kept``, int64 ``[W']``, are numbers of waypoints. ``moves`` have how often
        agents went from one of them to another, by their new numbers, and ``poses``
        ``[W', 3]`` where they are, in steps, and which way they look, in degrees.
        Unfinished episodes are dropped.
        """
        self.waypoints.keep(kept)
        self.waypoints.positions = poses[:, :2].clone()
        self.waypoints.headings = poses[:, 2] % 360
        self.graph.rebuild(len(kept), moves)
        self.discovery.forget()

    def state_dict(
        self, *, views: bool = True, embeddings: bool = True
    ) -> dict[str, Any]:
        """Everything but the networks and the episodes that are not finished.

        ``views`` may be left out; those in a file are there alone, in any case.
        ``embeddings`` may be left out of a state with views: whoever loads it has to
        `refresh` the map.
        """
        if not (views or embeddings):
            raise ValueError("a state must have views or embeddings, got neither")
        waypoints = self.waypoints
        of_waypoints = (
            waypoints.state_dict(embeddings=embeddings) if views else waypoints.arrays()
        )
        return {
            **of_waypoints,
            **self.graph.state_dict(),
            "network_version": self.network_version,
            "tc_threshold": self.rules.tc_threshold,
            "tc_reach": self.rules.tc_reach,
        }

    def end_episodes(self, envs: Collection[int]) -> None:
        """What these environments see next begins new episodes, as after an end."""
        self.discovery.forget(envs)
        if self.walks is not None:
            self.walks.end(envs)

    def running_episodes(self) -> dict[str, Any]:
        """Those that are not finished, which `state_dict` leaves out."""
        walks = {} if self.walks is None else {"walks": self.walks.running_episodes()}
        return self.discovery.running_episodes() | walks

    def resume_episodes(self, state: Mapping[str, Any]) -> None:
        """Continue those of `running_episodes`, after `load_state_dict`."""
        self.discovery.resume_episodes(state)
        if self.walks is not None:
            self.walks.resume_episodes(state["walks"])

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Become the map of `state_dict`; unfinished episodes are dropped."""
        self.set_thresholds(state["tc_threshold"], state["tc_reach"])
        self.waypoints.load_state_dict(state)
        self.graph.load_state_dict(state, self.num_waypoints)
        self.network_version = state["network_version"]
        self.discovery.forget()
