"""Views of one pixel whose similarity is known, and a map in plain Python."""

import torch
from tensordict import TensorDict

from toponav.graph import MapRules, TopologicalMap


def embed(views):
    return views.flatten(1)[:, :1].float() / 100


def compare(one, many):
    """Similarity of two shades: 1 if alike, 0 for black and white."""
    return (1 - (one.unsqueeze(1) - many).abs().mean(-1)).clamp(min=0)


def make_map(*, goal_reward=10.0, **rules):
    """A map to the letter of the paper, unless the rules say otherwise."""
    literal = {
        "tc_threshold": 0.9,
        "tc_reach": 0.75,
        "window": 0,
        "search_window": 0,
        "hysteresis": False,
        "nearby": None,
        "shortlist": None,
    }
    return TopologicalMap(
        embed, compare, MapRules(**literal | rules), goal_reward=goal_reward
    )


def episode(*greys, views=False, env=None, scale=100):
    """One episode ``[T]`` of these shades, 0 to ``scale``."""
    length = len(greys)
    grey = torch.tensor(greys).reshape(length, 1, 1, 1)
    done = torch.zeros(length, 1, dtype=torch.bool)
    done[-1] = True
    data = TensorDict({"next": {"done": done}}, [length])
    data["embedding"] = grey.reshape(length, 1) / scale
    if views:
        data["network_pixels"] = (
            grey.to(torch.uint8).expand(length, 2, 2, 3).contiguous()
        )
    if env is not None:
        data["env_id"] = torch.full((length, 1), env)
    return data


class PlainMap:
    """The map by the docstring of `TopologicalMap`, with all compared with all."""

    def __init__(self, *, scale, window=0, search_window=0, hysteresis=False, **rules):
        self.scale = scale
        self.rules = {
            "tc_threshold": 0.9,
            "tc_reach": 0.75,
            "edges": "both",
            "extend_by": "itself",
            "edge_steps": 1,
        } | rules
        self.window, self.search_window = window, search_window
        self.hysteresis = hysteresis
        self.greys, self.traversed, self.seen = [], {}, set()
        self.episodes = 0

    def vote(self, greys, at, waypoint, window):
        around = greys[max(at - window, 0) : at + window + 1]
        alike = [1 - abs(grey - self.greys[waypoint]) / self.scale for grey in around]
        return sum(alike) / len(alike)

    def add(self, greys):
        place, places = None, []
        edges, is_first = self.rules["edges"], not self.episodes
        # Eq. 10 with its k, or eq. 12 and the step from one view to the next.
        extends = edges != "time" and self.rules["extend_by"] == "previous"
        steps = 1 if extends and not is_first else self.rules["edge_steps"]
        for at in range(len(greys)):
            found = self.find(greys, at, place)
            if found is None:
                found = self.add_waypoint(greys, at, is_first)
            if found != place:
                for before in set(places[-steps:]) - {found}:
                    if edges != "reach" or self.edge(before, found) in self.seen:
                        self.traverse(before, found)
            place = found
            places.append(found)
        self.episodes += 1
        return places

    def find(self, greys, at, place):
        threshold = self.rules["tc_threshold"]
        for window, stays in ((self.window, True), (self.search_window, False)):
            votes = [
                self.vote(greys, at, one, window) for one in range(len(self.greys))
            ]
            may_stay = stays and self.hysteresis and place is not None
            if may_stay and votes[place] > threshold:
                return place
            if votes and max(votes) > threshold:
                return votes.index(max(votes))
        return None

    def add_waypoint(self, greys, at, is_first):
        seer = greys[at]
        if self.rules["extend_by"] == "previous" and not is_first:
            seer = greys[at - 1] if at else None
        number = len(self.greys)
        if self.rules["edges"] != "time" and seer is not None:
            for other, grey in enumerate(self.greys):
                if 1 - abs(seer - grey) / self.scale > self.rules["tc_reach"]:
                    self.seen.add((other, number))
        self.greys.append(greys[at])
        return number

    @staticmethod
    def edge(one, other):
        return min(one, other), max(one, other)

    def traverse(self, one, other):
        edge = self.edge(one, other)
        self.traversed[edge] = self.traversed.get(edge, 0) + 1

    def edges(self):
        return sorted(self.seen | set(self.traversed))
