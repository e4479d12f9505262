"""Views of one pixel whose similarity is known, and a memory in plain Python."""

import torch
from tensordict import TensorDict

from toponav.keys import (
    IS_NEW_WAYPOINT,
    NOVEL,
    NUM_WAYPOINTS,
    SIMILARITY,
    VISITS,
    WAYPOINT,
)
from toponav.transforms import WaypointMemory

FLAGS = (WAYPOINT, SIMILARITY, NOVEL, IS_NEW_WAYPOINT, VISITS, NUM_WAYPOINTS)


def embed(views):
    return views.flatten(-3).float()


def compare(one, many):
    """Similarity of two shades of grey: 1 if alike, 0 for black and white."""
    return 1 - (one.unsqueeze(-2) - many).abs().mean(-1)


def make_memory(**arguments):
    return WaypointMemory(embed, compare, **{"threshold": 0.8} | arguments)


def shade(*greys):
    """The views of several envs."""
    views = torch.tensor(greys, dtype=torch.float32).reshape(-1, 1, 1, 1)
    return TensorDict({"pixels": views}, [len(greys)])


def reset(transform, data, rows=None):
    mask = TensorDict(batch_size=data.batch_size)
    if rows is not None:
        mask["_reset"] = torch.tensor(rows).unsqueeze(-1)
    return transform._reset(mask, data)


def step(transform, data):
    return transform._step(TensorDict(batch_size=data.batch_size), data)


def flags(data, env=0):
    """What the memory wrote for one env, in the order of ``FLAGS``."""
    return tuple(data[key][env].item() for key in FLAGS)


class PlainMemory:
    """One env's memory as the docstring of `WaypointMemory` tells it."""

    def __init__(
        self,
        *,
        threshold=0.8,
        capacity=200,
        persistence=1,
        min_gap=1,
        count_on="every",
    ):
        self.threshold = threshold
        self.capacity = capacity
        self.persistence = persistence
        self.min_gap = min_gap
        self.count_on = count_on

    def reset(self, grey):
        self.greys, self.visits = [grey], [1]
        self.streak, self.since, self.last = 0, 0, 0
        return 0, 0.0, True, True, 1, 1

    def step(self, grey):
        known = [1 - abs(grey - other) for other in self.greys]
        similarity = max(known)
        self.since += 1
        if similarity > self.threshold:
            self.streak = 0
            waypoint = known.index(similarity)
            enters = waypoint != self.last or self.count_on == "every"
            self.visits[waypoint] += enters
            self.last = waypoint
            visits = self.visits[waypoint] if enters else 0
            return waypoint, similarity, False, False, visits, len(self.greys)
        self.streak += 1
        early = self.streak < self.persistence or self.since < self.min_gap
        if early or len(self.greys) == self.capacity:
            return -1, similarity, True, False, 0, len(self.greys)
        self.last = len(self.greys)
        self.greys.append(grey)
        self.visits.append(1)
        self.streak = self.since = 0
        return self.last, similarity, True, True, 1, len(self.greys)
