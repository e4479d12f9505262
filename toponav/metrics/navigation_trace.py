"""Whole episodes of a navigator as arrays (`trace_navigation`), and their legs."""

from dataclasses import dataclass

import numpy as np
import pandas as pd
import torch
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
from toponav.metrics.statistics import Bools, Floats, Ints

#: What only a navigator decides.
_DECIDED: dict[str, NestedKey] = {
    "place": PLACE,
    "target": TARGET,
    "goal_node": GOAL_NODE,
    "cut_from": CUT_FROM,
    "cut_to": CUT_TO,
    "lost": LOST,
}
#: What a trace reads at a decision, and what after it.
TRACE_KEYS = [POSITION, HEADING, CELL, GOAL_CELL, BLOCKED, *_DECIDED.values()]
TRACE_NEXT_KEYS = [REWARD, RESPAWNED]


@dataclass(frozen=True)
class NavigationTrace:
    """The T decisions of N episodes: where the agent was, and what it decided there.

    What a navigator decides is -1 everywhere for a policy without a map.
    """

    positions: Floats  # [N, T, 2] in map units, before the decision
    headings: Floats  # [N, T] in degrees
    cells: Ints  # [N, T, 2], row and column
    goal_cells: Ints  # [N, T, 2]
    blocked: Bools  # [N, T, S]; the slots that are closed
    reward: Floats  # [N, T], of the task, for the decision
    reached: Bools  # [N, T]; the decision led to the goal
    place: Ints  # [N, T], the waypoint where the agent believed to be, -1 if lost
    target: Ints  # [N, T], the next waypoint, -1 at the goal's own
    goal_node: Ints  # [N, T], the goal waypoint at the end of the path
    cut_from: Ints  # [N, T], start of the edges closed in this decision
    cut_to: Ints  # [N, T], their end
    lost: Bools  # [N, T]

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
    """Read episodes ``[N, T]`` as a rollout or a collector yields them.

    The entries of `TRACE_KEYS` and, after each decision, `TRACE_NEXT_KEYS` must be
    there, except those that only a navigator decides.
    """
    if episodes.batch_dims != 2:
        raise ValueError(f"episodes must be [N, T], got {tuple(episodes.batch_size)}")
    shape, after = episodes.batch_size, episodes.get("next")
    decided = {}
    for name, key in _DECIDED.items():
        nothing = torch.full((*shape, 1), False if key == LOST else -1)
        decided[name] = np.asarray(episodes.get(key, nothing).cpu()).reshape(shape)
    return NavigationTrace(
        positions=np.asarray(episodes[POSITION].cpu(), np.float64),
        headings=np.asarray(episodes[HEADING].cpu(), np.float64).reshape(shape),
        cells=np.asarray(episodes[CELL].cpu(), np.int64),
        goal_cells=np.asarray(episodes[GOAL_CELL].cpu(), np.int64),
        blocked=np.asarray(episodes[BLOCKED].cpu(), bool),
        reward=np.asarray(after[REWARD].cpu(), np.float64).reshape(shape),
        reached=np.asarray(after[RESPAWNED].cpu(), bool).reshape(shape),
        **decided,
    )


def find_legs(trace: NavigationTrace) -> pd.DataFrame:
    """The legs of all episodes, a row each; the last of an episode is mostly cut off.

    Columns are ``episode``, the numbers ``start`` of the first decision and ``end`` of
    the one after the last, ``decisions``, and whether the goal was ``reached``.
    """
    is_last = trace.reached.copy()
    is_last[:, -1:] = True
    episode, last = np.nonzero(is_last)
    reached = trace.reached[episode, last]
    legs = pd.DataFrame({"episode": episode, "end": last + 1, "reached": reached})
    legs["start"] = legs.groupby("episode")["end"].shift(fill_value=0)
    return legs.assign(decisions=legs["end"] - legs["start"])
