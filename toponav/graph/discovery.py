"""`Discovery`: which observations become waypoints, and which edges join them."""

from collections import defaultdict
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from itertools import zip_longest
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from toponav.graph.pieces import Piece
from toponav.graph.rules import MapRules
from toponav.graph.waypoint_graph import WaypointGraph
from toponav.graph.waypoints import Waypoints

#: Observations that are compared with the waypoints nearby in one call.
_BLOCK = 16
# Similarities are float32: a sum of them may be off by so much.
_ROUNDING = 1e-5


@dataclass
class Track:
    """The observations of one environment, and which of them are decided."""

    env: int
    frames: Tensor  # embeddings [F, D] to decide, and those before and after that vote
    images: Tensor | None  # [F, H, W, C], if the views are known
    number: int  # of the first frame among all observations of the environment
    is_first: bool  # whether the map was empty when the episode began
    cursor: int = 0  # index of the next frame to decide
    stop: int = 0  # from here on, votes are missing
    #: Waypoints of the last decided frames, those that an edge by time may begin at.
    recent: list[int] = field(default_factory=list)
    #: Waypoints of the frames that were decided since the last piece.
    places: list[int] = field(default_factory=list)

    @property
    def place(self) -> int:
        """Waypoint of the last decided frame, -1 before the first."""
        return self.recent[-1] if self.recent else -1

    def append(self, piece: Piece, lookahead: int) -> None:
        self.frames = torch.cat([self.frames, piece.embeddings])
        if self.images is not None and piece.images is not None:
            self.images = torch.cat([self.images, piece.images])
        else:
            self.images = None
        missing = 0 if piece.ends else lookahead
        self.stop = max(len(self.frames) - missing, self.cursor)
        self.places = []

    def drop_decided(self, context: int) -> None:
        start = max(self.cursor - context, 0)
        self.frames = self.frames[start:].clone()
        self.images = None if self.images is None else self.images[start:].clone()
        self.cursor, self.number = self.cursor - start, self.number + start


class Discovery:
    """Maps observations to waypoints, adds those that are like none, and links them.

    Environments go side by side: the network then compares many pairs at once.
    """

    def __init__(
        self, waypoints: Waypoints, graph: WaypointGraph, rules: MapRules
    ) -> None:
        self.waypoints = waypoints
        self.graph = graph
        self.rules = rules
        self._tracks: dict[int, Track] = {}
        self._counts: dict[int, int] = {}

    def clear(self) -> None:
        self._tracks.clear()

    def running_episodes(self) -> dict[str, Any]:
        tracks = [dict(vars(track)) for track in self._tracks.values()]
        return {"tracks": tracks, "counts": dict(self._counts)}

    def resume_episodes(self, state: Mapping[str, Any]) -> None:
        self._tracks = {one["env"]: Track(**one) for one in state["tracks"]}
        self._counts = dict(state["counts"])

    def renumber(self, number: Tensor) -> None:
        """Apply the new numbers of all waypoints, int64 ``[W]``, after a merge."""
        for track in self._tracks.values():
            track.recent = number[track.recent].tolist()

    def refresh(self) -> None:
        """Embed unfinished episodes again; those without views are dropped."""
        for env, track in list(self._tracks.items()):
            if track.images is None:
                del self._tracks[env]
            elif len(track.frames):
                track.frames = self.waypoints.embed(track.images)

    def add(self, pieces: Sequence[Piece]) -> list[int]:
        """Continue episodes by their pieces; the waypoints of what was decided."""
        pieces_of = defaultdict[int, list[Piece]](list)
        for piece in pieces:
            pieces_of[piece.env].append(piece)
        places: list[int] = []
        # The first piece of each environment, the second of each, and so on.
        for wave in zip_longest(*pieces_of.values()):
            for track in self._add_side_by_side([one for one in wave if one]):
                places += track.places
        return places

    def _add_side_by_side(self, pieces: Sequence[Piece]) -> list[Track]:
        tracks = []
        for piece in pieces:
            track = self._tracks.pop(piece.env, None) or Track(
                env=piece.env,
                frames=piece.embeddings[:0],
                images=None if piece.images is None else piece.images[:0],
                number=self._counts.get(piece.env, 0),
                is_first=not len(self.waypoints),
            )
            track.append(piece, self.rules.lookahead)
            self._counts[piece.env] = track.number + len(track.frames)
            tracks.append(track)
        while due := [track for track in tracks if track.cursor < track.stop]:
            nodes = [self._nearby(track) for track in due]
            votes = self._votes(due, nodes)
            for track, near, rows in zip(due, nodes, votes, strict=True):
                self._decide(track, near, rows)
        for piece, track in zip(pieces, tracks, strict=True):
            if not piece.ends:
                # One frame is kept in any case: the view before a new waypoint.
                track.drop_decided(max(self.rules.lookahead, 1))
                self._tracks[piece.env] = track
        return tracks

    def _nearby(self, track: Track) -> list[int]:
        if self.rules.nearby is None:
            return list(range(len(self.waypoints)))
        if track.place < 0:
            return []
        return self.graph.nearby(track.place, self.rules.nearby)

    def _votes(
        self, tracks: list[Track], nodes: list[list[int]]
    ) -> list[NDArray[np.float64]]:
        """Mean similarity of each track's next block to its nodes, ``[S, M]`` each."""
        window, most = self.rules.window, max(map(len, nodes))
        frames, places = [], []
        for track in tracks:
            before = min(window, track.cursor)
            num = min(_BLOCK, track.stop - track.cursor)
            start = track.cursor - before
            frames.append(track.frames[start : track.cursor + num + window])
            places.append((before, num))
        lengths = [len(some) for some in frames]
        if not most:
            scores = torch.zeros(sum(lengths), 0)
        elif self.rules.nearby is None:
            scores = self.waypoints.similarities(torch.cat(frames))
        else:
            # Rows of nodes of one length; the padding's scores are not read.
            rows = torch.tensor([near + [0] * (most - len(near)) for near in nodes])
            memory = self.waypoints.prepared[rows]
            memory = memory.repeat_interleave(torch.tensor(lengths), 0)
            scores = self.waypoints.compare(torch.cat(frames), memory)
        blocks = zip(scores.split(lengths), nodes, places, strict=True)
        return [
            moving_mean(np.asarray(block[:, : len(near)]), *place, window)
            for block, near, place in blocks
        ]

    def _decide(
        self, track: Track, near: list[int], votes: NDArray[np.float64]
    ) -> None:
        """Map frames one by one, until one is like none of the waypoints nearby."""
        threshold = self.rules.tc_threshold
        column = {node: at for at, node in enumerate(near)}
        for row in votes:
            best = column.get(track.place) if self.rules.hysteresis else None
            if near and (best is None or not row[best] > threshold):
                best = int(row.argmax())
            if best is None or not row[best] > threshold:
                self._search(track)
                return
            self._move(track, near[best])

    def _search(self, track: Track) -> None:
        window, threshold = self.rules.search_window, self.rules.tc_threshold
        start = max(track.cursor - window, 0)
        frames = track.frames[start : track.cursor + window + 1]
        candidates, similarity = self._candidates(frames[track.cursor - start])
        # A mean above the threshold leaves no single vote below this.
        least = 1 - len(frames) * (1 - threshold) - _ROUNDING
        likely = candidates[similarity > least]
        if len(likely):
            votes = self.waypoints.similarities(frames, likely)
            mean = np.asarray(votes, np.float64).mean(0)
            for best in (-mean).argsort(kind="stable"):
                if not mean[best] > threshold:
                    break
                if self._fits(track, node := int(likely[best])):
                    self._move(track, node)
                    return
        self._add_waypoint(track, candidates, similarity)

    def _candidates(self, frame: Tensor) -> tuple[Tensor, Tensor]:
        nodes = self.waypoints.shortlist(frame, self.rules.shortlist)
        return nodes, self.waypoints.similarities(frame.unsqueeze(0), nodes)[0]

    def _fits(self, track: Track, node: int) -> bool:
        """Whether the frames around the next one are like waypoints around a node."""
        span = self.rules.surroundings
        steps = [span * part // 4 for part in (-4, -3, -2, -1, 1, 2, 3, 4)]
        at = [track.cursor + step for step in steps if step]
        around = [one for one in at if 0 <= one < len(track.frames)]
        if not around:
            return True
        near = torch.tensor(self.graph.nearby(node, 2 * span))
        similarity = self.waypoints.similarities(track.frames[around], near)
        return float(similarity.amax(1).mean()) > self.rules.surroundings_above

    def _move(self, track: Track, place: int) -> None:
        by_time = self.rules.edges != "reach"
        for before in set(track.recent) if place != track.place else ():
            if by_time or self.graph.has_edge(before, place):
                self.graph.traverse(before, place)
        # Where eq. 12 makes the edges, those of time are the steps alone.
        steps = 1 if self._extends(track) else self.rules.edge_steps
        track.recent = [*track.recent, place][-steps:]
        track.places.append(place)
        track.cursor += 1

    def _extends(self, track: Track) -> bool:
        """Whether eq. 12 makes the edges of its new waypoints, not eq. 10."""
        by_previous = self.rules.extend_by == "previous" and self.rules.edges != "time"
        return by_previous and not track.is_first

    def _add_waypoint(
        self, track: Track, candidates: Tensor, similarity: Tensor
    ) -> None:
        at, capacity = track.cursor, self.rules.capacity
        if capacity is not None and len(self.waypoints) >= capacity:
            track.recent, track.cursor = [], at + 1
            track.places.append(-1)
            return
        if self._extends(track):
            # Eq. 12: the observation before says what the new waypoint reaches.
            candidates, similarity = candidates[:0], similarity[:0]
            if at:
                candidates, similarity = self._candidates(track.frames[at - 1])
        image = None if track.images is None else track.images[at]
        origin = torch.tensor([track.env, track.number + at])
        place = self.waypoints.add(track.frames[at], image, origin)
        self.graph.add_waypoint()
        if self.rules.edges != "time":
            reached = similarity > self.rules.tc_reach
            others, values = candidates[reached].tolist(), similarity[reached].tolist()
            self.graph.link(place, others, values)
        self._move(track, place)


def moving_mean(
    rows: NDArray[np.float32], begin: int, num: int, window: int
) -> NDArray[np.float64]:
    """Mean of rows ``[F, M]`` with those beside them, of ``num`` from ``begin`` on."""
    sums = np.zeros((len(rows) + 1, rows.shape[1]))
    np.cumsum(rows, axis=0, dtype=np.float64, out=sums[1:])
    centre = np.arange(begin, begin + num)
    low = np.maximum(centre - window, 0)
    high = np.minimum(centre + window + 1, len(rows))
    mean: NDArray[np.float64] = (sums[high] - sums[low]) / (high - low)[:, None]
    return mean
