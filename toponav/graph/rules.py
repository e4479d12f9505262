"""`Rules`: when an observation becomes a waypoint, and what an edge joins."""

from dataclasses import dataclass
from typing import Literal

EdgeRule = Literal["both", "reach", "time"]
ExtendBy = Literal["itself", "previous"]


@dataclass
class Rules:
    """The choices of `TopologicalMap`, which says what they mean, checked.

    Raises:
        ValueError: if one is out of range.

    Examples:
        >>> Rules(tc_threshold=0.9, tc_reach=0.95)
        Traceback (most recent call last):
        ValueError: tc_reach must be in [0, tc_threshold=0.9], got 0.95
    """

    tc_threshold: float
    tc_reach: float
    edges: EdgeRule = "both"
    extend_by: ExtendBy = "itself"
    link_transitions: bool = True
    window: int = 1
    search_window: int = 2
    surroundings: int = 0
    surroundings_above: float = 0.9
    hysteresis: bool = True
    nearby: int | None = 16
    shortlist: int | None = 32

    def __post_init__(self) -> None:
        self.set_thresholds(self.tc_threshold, self.tc_reach)
        _check_choice("edges", self.edges, ("both", "reach", "time"))
        _check_choice("extend_by", self.extend_by, ("itself", "previous"))
        for name in ("window", "search_window", "surroundings"):
            if (value := getattr(self, name)) < 0:
                raise ValueError(f"{name} must be at least 0, got {value}")
        if not 0 <= self.surroundings_above < 1:
            raise ValueError(
                f"surroundings_above must be in [0, 1), got {self.surroundings_above}"
            )
        for name in ("nearby", "shortlist"):
            if (value := getattr(self, name)) is not None and value < 1:
                raise ValueError(f"{name} must be None or at least 1, got {value}")

    def set_thresholds(
        self, tc_threshold: float | None, tc_reach: float | None
    ) -> None:
        """Change thresholds; ``None`` keeps one.

        Raises:
            ValueError: if one is out of range; both then stay as they were.
        """
        threshold = self.tc_threshold if tc_threshold is None else tc_threshold
        reach = self.tc_reach if tc_reach is None else tc_reach
        if not 0 <= threshold < 1:
            raise ValueError(f"tc_threshold must be in [0, 1), got {threshold}")
        if not 0 <= reach <= threshold:
            raise ValueError(
                f"tc_reach must be in [0, tc_threshold={threshold:g}], got {reach}"
            )
        self.tc_threshold, self.tc_reach = float(threshold), float(reach)

    @property
    def by_time(self) -> bool:
        """Whether successive observations make edges."""
        return self.edges in ("both", "time")

    @property
    def by_reach(self) -> bool:
        """Whether similarity makes edges."""
        return self.edges in ("both", "reach")

    @property
    def context(self) -> int:
        """Observations to keep that are decided: they vote on, and extend, the next."""
        return max(self.lookahead, 1)

    @property
    def lookahead(self) -> int:
        """Observations that must be known after one that is decided."""
        return max(self.window, self.search_window, self.surroundings)


def _check_choice(name: str, value: str, choices: tuple[str, ...]) -> None:
    if value not in choices:
        raise ValueError(f"{name} must be one of {choices}, got {value!r}")
