"""`Discovery`: which observations become waypoints, and which edges join them."""

from collections import defaultdict
from collections.abc import Collection, Iterable, Mapping, Sequence
from itertools import zip_longest
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from toponav.graph.headings import agreed_angle, look_alike
from toponav.graph.moving_mean import moving_mean
from toponav.graph.pieces import Piece
from toponav.graph.rules import MapRules
from toponav.graph.track import Track
from toponav.graph.waypoint_graph import WaypointGraph
from toponav.graph.waypoints import Waypoints

#: Observations that are compared with the waypoints nearby in one call.
_BLOCK = 16
# Similarities are float32: a sum of them may be off by so much.
_ROUNDING = 1e-5
# Frames of a track of unknown direction that are compared with the map at most, and one
# in so many of them at least.
_COMPARED, _EVERY = 64, 6
# Similarity of a view that votes for the direction of its episode.
_ALIKE = 0.95


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

    def forget(self, envs: Iterable[int] | None = None) -> None:
        """Drop the unfinished episodes of environments, or all."""
        for env in list(self._tracks) if envs is None else envs:
            self._tracks.pop(env, None)

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
            track.sure = int(number[track.sure]) if track.sure >= 0 else -1

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
        tracks = list[Track]()
        for piece in pieces:
            track = self._tracks.pop(piece.env, None) or Track(
                env=piece.env,
                frames=piece.embeddings[:0],
                images=None if piece.images is None else piece.images[:0],
                number=self._counts.get(piece.env, 0),
                is_first=not (len(self.waypoints) or tracks or self._tracks),
                headings=torch.empty(0),
                oriented=False,
            )
            track.append(piece, self.rules.lookahead)
            if not track.oriented:
                self._orient(track, [*self._tracks.values(), *tracks])
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

    def _orient(self, track: Track, others: Sequence[Track]) -> None:
        """Find which way a track's first frame looks; until then nothing is decided."""
        known = self.waypoints.headings
        if self.rules.turn_tolerance is None or bool(track.headings[:1].isnan().any()):
            track.headings, track.oriented = track.headings * torch.nan, True
        elif bool(known.isnan().all()) and (
            len(known) or not any(other.oriented for other in others)
        ):
            # The first episode has the map's direction, waypoints or not.
            track.orient(0.0)
        elif (offset := agreed_angle(self._votes_for_offset(track))) is not None:
            track.orient(offset)
        if not track.oriented:
            track.places = [-1] * (len(track.frames) if track.ends else 0)
            track.stop = track.cursor

    def _votes_for_offset(self, track: Track) -> Tensor:
        """Degrees by which similar waypoints' headings are larger, one of each."""
        votes: dict[int, Tensor] = {}
        every = max(len(track.frames) // _COMPARED, _EVERY)
        for at in range(0, len(track.frames), every) if len(self.waypoints) else ():
            nodes = self.waypoints.shortlist(track.frames[at], self.rules.shortlist)
            found = self.waypoints.similarities(track.frames[at : at + 1], nodes)[0]
            if found.max() > _ALIKE:
                node = int(nodes[found.argmax()])
                turned = self.waypoints.headings[node] - track.headings[at]
                votes.setdefault(node, turned)
        return torch.stack([*votes.values()]) if votes else torch.empty(0)

    def _looks_alike(self, track: Track, frames: Any, nodes: Tensor) -> Tensor:
        """Whether frames look the same way as waypoints, bool ``[F, M]``."""
        headings = track.headings[frames].unsqueeze(1)
        tolerance = self.rules.turn_tolerance
        most = torch.inf if tolerance is None else tolerance
        return look_alike(headings, self.waypoints.headings[nodes], most)

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
        if near and self.rules.turn_tolerance is not None:
            frames = slice(track.cursor, track.cursor + len(votes))
            alike = self._looks_alike(track, frames, torch.tensor(near))
            votes = np.where(alike.numpy(), votes, -1.0)
        column = {node: at for at, node in enumerate(near)}
        for row in votes:
            best = column.get(track.place) if self.rules.hysteresis else None
            if near and (best is None or not row[best] > threshold):
                best = int(row.argmax())
            if best is None or not row[best] > threshold:
                self._search(track)
                return
            self._move(track, near[best], float(row[best]))

    def _search(self, track: Track) -> None:
        window, threshold = self.rules.search_window, self.rules.tc_threshold
        start = max(track.cursor - window, 0)
        frames = track.frames[start : track.cursor + window + 1]
        candidates, similarity = self._candidates(track, track.cursor)
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
                    self._move(track, node, float(mean[best]))
                    return
        self._add_waypoint(track, candidates, similarity)

    def _candidates(self, track: Track, at: int) -> tuple[Tensor, Tensor]:
        frame, among = track.frames[at], None
        if self.rules.turn_tolerance is not None:
            every = torch.arange(len(self.waypoints))
            among = every[self._looks_alike(track, [at], every)[0]]
        nodes = self.waypoints.shortlist(frame, self.rules.shortlist, among)
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
        similarity = similarity * self._looks_alike(track, around, near)
        return float(similarity.amax(1).mean()) > self.rules.surroundings_above

    def _move(self, track: Track, place: int, similarity: float) -> None:
        by_time = self.rules.edges != "reach"
        for before in self._joined_with(track, place, similarity):
            if by_time or self.graph.has_edge(before, place):
                self.graph.traverse(before, place)
        # Where eq. 12 makes the edges, those of time are the steps alone.
        steps = 1 if self._extends(track) else self.rules.edge_steps
        track.recent = [*track.recent, place][-steps:]
        track.places.append(place)
        track.cursor += 1

    def _joined_with(
        self, track: Track, place: int, similarity: float
    ) -> Collection[int]:
        """The waypoints from which the next frame, at ``place``, shows the way."""
        least, number = self.rules.edge_threshold, track.number + track.cursor
        if least is None:
            return set(track.recent) if place != track.place else ()
        if not similarity > least:
            return ()
        before, apart = track.sure, number - track.sure_number
        track.sure, track.sure_number = place, number
        joins = before not in (-1, place) and apart <= self.rules.edge_gap
        return (before,) if joins else ()

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
                candidates, similarity = self._candidates(track, at - 1)
        image = None if track.images is None else track.images[at]
        origin = torch.tensor([track.env, track.number + at])
        heading = float(track.headings[at] % 360)
        place = self.waypoints.add(track.frames[at], image, origin, heading)
        self.graph.add_waypoint()
        if self.rules.edges != "time":
            reached = similarity > self.rules.tc_reach
            others, values = candidates[reached].tolist(), similarity[reached].tolist()
            self.graph.link(place, others, values)
        self._move(track, place, 1.0)
