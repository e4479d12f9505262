"""`NavigationTrace`: whole episodes of a navigator as arrays, and their legs.

- `trace_navigation`: from a tensordict of episodes.
- `find_legs`: the ways from a start to the goal, of which an episode has many.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import NestedKey, TensorDictBase

from toponav.keys import (
    BLOCKED,
    CELL,
    CUT_FROM,
    CUT_TO,
    GOAL_CELL,
    GOAL_NODE,
    HEADING,
    LOST,
    PLACE,
    POSITION,
    RESPAWNED,
    REWARD,
    TARGET,
)

Bools = NDArray[np.bool_]
Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

#: What a trace reads at a decision, and what after it.
TRACE_KEYS: list[NestedKey] = [POSITION, HEADING, CELL, GOAL_CELL, BLOCKED]
TRACE_NEXT_KEYS: list[NestedKey] = [REWARD, RESPAWNED]
#: What only a navigator decides.
TRACE_NAVIGATION_KEYS: list[NestedKey] = [
    PLACE,
    TARGET,
    GOAL_NODE,
    CUT_FROM,
    CUT_TO,
    LOST,
]


@dataclass(frozen=True)
class NavigationTrace:
    """The T decisions of N episodes: where the agent was, and what it decided there.

    Args:
        positions: ``[N, T, 2]`` in map units, before the decision, as all but
            ``reward`` and ``reached``.
        headings: ``[N, T]`` in degrees.
        cells: int ``[N, T, 2]``, row and column.
        goal_cells: int ``[N, T, 2]``.
        blocked: bool ``[N, T, S]``; the slots that are closed.
        reward: ``[N, T]``, of the task, for the decision.
        reached: bool ``[N, T]``; the decision led to the goal, and the agent was put
            elsewhere.
        place: int ``[N, T]``, the waypoint where it believed to be, -1 if lost; -1
            everywhere for a policy without a map, as the four that follow.
        target: int ``[N, T]``, the waypoint that it walked to, -1 at the goal's own.
        goal_node: int ``[N, T]``, the goal waypoint at the end of its path.
        cut_from: int ``[N, T]``, where what it closed in this decision begins.
        cut_to: int ``[N, T]``, and ends.
        lost: bool ``[N, T]``.

    Raises:
        ValueError: if the arrays do not all begin with one shape ``[N, T]``.

    Shape notation:
        N: episodes.  T: decisions.  S: slots.
    """

    positions: Floats
    headings: Floats
    cells: Ints
    goal_cells: Ints
    blocked: Bools
    reward: Floats
    reached: Bools
    place: Ints
    target: Ints
    goal_node: Ints
    cut_from: Ints
    cut_to: Ints
    lost: Bools

    def __post_init__(self) -> None:
        shapes = {name: values.shape[:2] for name, values in vars(self).items()}
        if len(set(shapes.values())) > 1 or len(self.reward.shape) != 2:
            raise ValueError(f"all arrays must begin with one [N, T], got {shapes}")

    def __len__(self) -> int:
        return len(self.reward)

    @property
    def decisions(self) -> int:
        """T."""
        return int(self.reward.shape[1])


def trace_navigation(episodes: TensorDictBase) -> NavigationTrace:
    """Read episodes as a rollout or a collector yields them.

    Args:
        episodes: ``[N, T]`` decisions with the privileged entries of `TRACE_KEYS`, and
            after each decision those of `TRACE_NEXT_KEYS`. What a navigator decides
            may be missing.

    Raises:
        ValueError: if it is not ``[N, T]``.
        KeyError: if an entry is missing.

    Examples:
        >>> from tensordict import TensorDict
        >>> truth = {"position": torch.zeros(1, 3, 2), "heading": torch.zeros(1, 3, 1)}
        >>> truth |= {"cell": torch.ones(1, 3, 2), "goal_cell": torch.ones(1, 3, 2)}
        >>> truth |= {"blocked": torch.zeros(1, 3, 0)}
        >>> paid = {"reward": torch.tensor([[[0.0], [10], [0]]])}
        >>> paid |= {"privileged": {"respawned": paid["reward"] > 0}}
        >>> walk = TensorDict({"privileged": truth, "next": paid}, [1, 3])
        >>> legs = find_legs(trace_navigation(walk))
        >>> [(leg.start, leg.end, leg.reached) for leg in legs]
        [(0, 2, True), (2, 3, False)]
    """
    if episodes.batch_dims != 2:
        raise ValueError(f"episodes must be [N, T], got {tuple(episodes.batch_size)}")
    shape, after = episodes.batch_size, episodes.get("next")

    def told(key: NestedKey) -> NDArray[Any]:
        nothing = torch.full((*shape, 1), False if key == LOST else -1)
        return np.asarray(episodes.get(key, nothing).cpu()).reshape(shape)

    return NavigationTrace(
        positions=np.asarray(episodes[POSITION].cpu(), np.float64),
        headings=np.asarray(episodes[HEADING].cpu(), np.float64).reshape(shape),
        cells=np.asarray(episodes[CELL].cpu(), np.int64),
        goal_cells=np.asarray(episodes[GOAL_CELL].cpu(), np.int64),
        blocked=np.asarray(episodes[BLOCKED].cpu(), bool),
        reward=np.asarray(after[REWARD].cpu(), np.float64).reshape(shape),
        reached=np.asarray(after[RESPAWNED].cpu(), bool).reshape(shape),
        place=told(PLACE),
        target=told(TARGET),
        goal_node=told(GOAL_NODE),
        cut_from=told(CUT_FROM),
        cut_to=told(CUT_TO),
        lost=told(LOST),
    )


@dataclass(frozen=True)
class Leg:
    """The way from a start to the goal, or to the end of the episode.

    Args:
        episode: its number.
        start: number of the first decision.
        end: number of the decision after the last.
        reached: whether it ended at the goal.
    """

    episode: int
    start: int
    end: int
    reached: bool

    @property
    def decisions(self) -> int:
        """How many there are."""
        return self.end - self.start


def find_legs(trace: NavigationTrace) -> list[Leg]:
    """The legs of all episodes, in their order; the last of each is mostly cut off."""
    legs = []
    for episode, reached in enumerate(trace.reached):
        start = 0
        for last in np.flatnonzero(reached):
            legs.append(Leg(episode, start, int(last) + 1, reached=True))
            start = int(last) + 1
        if start < trace.decisions:
            legs.append(Leg(episode, start, trace.decisions, reached=False))
    return legs
