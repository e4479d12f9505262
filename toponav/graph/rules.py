"""`MapRules` and `NavigatorRules`: the choices of a map and of a navigator."""

from dataclasses import dataclass
from typing import Literal, get_args

Edges = Literal["both", "reach", "time"]
ExtendBy = Literal["itself", "previous"]
BlockOn = Literal["goal", "edge"]


@dataclass(frozen=True, kw_only=True)
class MapRules:
    """When an observation becomes a waypoint, and what an edge joins.

    With ``window=0, search_window=0, hysteresis=False, nearby=None, shortlist=None``
    this is the paper's procedure to the letter. The defaults made far better maps in
    trials, since neighbouring frames vote against single views that look like another
    place, and what they compare does not grow with the map.
    """

    #: An observation is mapped to a waypoint if its similarity is above it, in [0, 1).
    #: Calibrate it by the share of views that become waypoints.
    tc_threshold: float
    #: A waypoint is reached if its similarity is above it, in [0, ``tc_threshold``].
    tc_reach: float
    #: Which clauses of eq. 10 make edges: similarity, succession in time, or both.
    edges: Edges = "both"
    #: Succession in time joins waypoints whose views are at most this many decisions
    #: apart in one episode: the k of eq. 10.
    edge_steps: int = 1
    #: Which view of an episode after the first says what a new waypoint reaches:
    #: ``"itself"`` (eq. 10) or the ``"previous"`` one (eq. 12).
    extend_by: ExtendBy = "itself"
    window: int = 1  # observations on either side that vote
    search_window: int = 2  # the same in a search among all waypoints
    #: Of the observations up to this many before and after one found in such a search,
    #: eight are compared with twice as many waypoints as this, the nearest by edges; 0
    #: for no such test. Bare walls look alike, the corridors to them do not.
    surroundings: int = 0
    surroundings_above: float = 0.9  # least mean of their best similarities
    hysteresis: bool = True  # an observation stays at the last waypoint if it can
    #: How many waypoints around the last one, nearest by edges, are compared before all
    #: others; ``None`` compares all at once.
    nearby: int | None = 16
    #: How many waypoints a search compares and links, those whose prepared embeddings
    #: are nearest; ``None`` for all.
    shortlist: int | None = 32
    #: Degrees up to which a view and a waypoint may look different ways, by the turns
    #: that the agent made; ``None`` compares all. It needs a map that knows the turns.
    turn_tolerance: float | None = None
    #: Edges by time join waypoints that a view is surely at: its similarity is above
    #: this, in [0, 1), or it became one; ``None`` takes all that views are mapped to.
    edge_threshold: float | None = None
    edge_gap: int = 12  # most decisions from one such view to the next
    #: Of an edge in a direction in which it was never traversed; else the cost is 1.
    untraversed_edge_cost: float = 3.0
    #: Most waypoints; ``None`` for no limit. What is like none of a full map's is
    #: nowhere.
    capacity: int | None = None

    def __post_init__(self) -> None:
        similarities = "tc_threshold", "surroundings_above", "edge_threshold"
        _check_range(self, 0, *similarities, below=1)
        _check_range(self, 0, "turn_tolerance")
        if not 0 <= self.tc_reach <= self.tc_threshold:
            raise ValueError(
                f"tc_reach must be in [0, tc_threshold={self.tc_threshold:g}], got "
                f"{self.tc_reach}"
            )
        _check_choices(self, edges=Edges, extend_by=ExtendBy)
        _check_range(self, 0, "window", "search_window", "surroundings")
        _check_range(self, 1, "edge_steps", "edge_gap", "nearby", "shortlist")
        _check_range(self, 1, "untraversed_edge_cost", "capacity")

    @property
    def lookahead(self) -> int:
        """Observations that must be known after one that is decided."""
        return max(self.window, self.search_window, self.surroundings)


@dataclass(frozen=True, kw_only=True)
class NavigatorRules:
    """How an agent finds its place, plans, walks and gives up; see `Navigator`."""

    tc_reach: float  # a view is at a waypoint if its similarity is above it, in [0, 1)
    #: Edges from the last place within which it looks before it looks everywhere.
    hops: int = 7
    #: Waypoints that a view is compared with, those whose embeddings are nearest by
    #: straight distance, which is far cheaper; ``None`` for all.
    shortlist: int | None = None
    #: Waypoints of the path ahead, beside the last place, where it looks first.
    follow: int = 6
    lookahead: int = 7  # waypoints of the path to look at for the next target
    temperature: float = 1.0  # of the softmax; 0 takes the most probable action
    #: Whether an action that left the view exactly as it was, such as walking against a
    #: wall, is not drawn again until the view changes.
    mask_noop_actions: bool = False
    #: What it must come nearer to, or edges are closed: the ``"goal"`` (`Progress`) or
    #: the next waypoint, beyond the next ``"edge"`` of its path (`EdgeProgress`).
    block_on: BlockOn = "goal"
    block_after: int | None = 40  # window in decisions; ``None`` never closes one
    fade_after: int | None = None  # decisions after which a cut opens again
    fade_growth: float = 1.0  # times as many if it fails again
    #: Decisions at a goal's waypoint after which it is dropped for the episode.
    goal_patience: int | None = 20
    lost_for: int = 5  # random actions of an agent that is lost

    def __post_init__(self) -> None:
        _check_choices(self, block_on=BlockOn)
        _check_range(self, 0, "tc_reach", below=1)
        _check_range(self, 0, "follow", "temperature")
        _check_range(self, 1, "hops", "shortlist", "lookahead", "fade_after")
        _check_range(self, 1, "goal_patience", "lost_for", "fade_growth")
        _check_range(self, 2, "block_after")


def _check_choices(rules: object, **kinds: object) -> None:
    for name, kind in kinds.items():
        if (value := getattr(rules, name)) not in (choices := get_args(kind)):
            raise ValueError(f"{name} must be one of {choices}, got {value!r}")


def _check_range(
    rules: object, least: int, *names: str, below: int | None = None
) -> None:
    wanted = f"at least {least}" if below is None else f"in [{least}, {below})"
    for name in names:
        value = getattr(rules, name)
        if value is None or (value >= least and (below is None or value < below)):
            continue
        raise ValueError(f"{name} must be {wanted}, got {value}")
