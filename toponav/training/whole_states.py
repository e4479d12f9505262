"""Whether the parts of an exploration's state fit each other, saved or restored."""

from collections.abc import Iterator, Mapping
from typing import Any

from toponav.config import TrainingError

#: What a map keeps of each of its waypoints, and of each of its edges.
_OF_WAYPOINTS = ("embeddings", "prepared", "origins", "headings", "positions")
_OF_EDGES = ("edges", "traversals", "edge_similarity")


def require_whole(decisions: int, states: Mapping[str, Mapping[str, Any]]) -> None:
    """Refuse states of which some have seen what others have not.

    Args:
        decisions: of the run.
        states: of its consumers, by their names in `make_consumers`; those of others
            are not looked at.

    Raises:
        TrainingError: if they do not fit each other.
    """
    if (unlike := unlike_counts(decisions, states)) is not None:
        raise TrainingError(
            f"what a run saves must have {unlike}; its last checkpoint stays as it was"
        )


def unlike_counts(
    decisions: int, states: Mapping[str, Mapping[str, Any]]
) -> str | None:
    """What does not fit in the states of `require_whole`, in words, if anything."""
    for what, counts in _counts(decisions, states):
        if len(set(counts.values())) > 1:
            given = ", ".join(f"{count:,} {name}" for name, count in counts.items())
            return f"one number of {what}, got {given}"
    return None


def _counts(
    decisions: int, states: Mapping[str, Mapping[str, Any]]
) -> Iterator[tuple[str, dict[str, int]]]:
    """Numbers that must be equal, by where they were counted."""
    if (log := states.get("episodes")) is not None:
        yield "decisions", {"by the run": decisions, "by its log": log["decisions"]}
    if (growth := states.get("map")) is None:
        return
    found, truth, walks = growth["map"], growth["truth"], growth["walks"]
    views, waypoints = growth["growth"][-1]
    counts = {"counted": waypoints}
    # Embeddings may be left out, and a map may have no views at all.
    counts |= {name: len(found[name]) for name in _OF_WAYPOINTS if name in found}
    if kept := len(found["views" if "views" in found else "images"]):
        counts["views"] = kept
    if truth is not None:
        counts["true poses"] = len(truth["poses"])
    if len(found["edges"]):
        counts["up to the last edge"] = max(int(found["edges"].max()) + 1, waypoints)
    yield "waypoints", counts
    yield "edges", {name: len(found[name]) for name in _OF_EDGES}
    if walks is not None:
        walked = walks["walks"]
        seen = {"counted": views}
        for name in ("embeddings", "actions"):
            seen[name] = sum(len(walk[name]) for walk in walked)
        yield "views in the walks", seen
