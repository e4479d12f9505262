"""`Discovery`: which observations become waypoints, and which edges join them."""

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from toponav.graph.pieces import Piece
from toponav.graph.rules import Rules
from toponav.graph.waypoint_graph import WaypointGraph
from toponav.graph.waypoints import Waypoints

#: Observations that are compared with the places nearby in one go.
_BLOCK = 16
# Similarities are float32: a sum of them may be off by so much.
_ROUNDING = 1e-5


@dataclass
class Track:
    """How far the observations of one environment have been decided.

    Args:
        env: number of the environment.
        frames: embeddings ``[F, D]``: those that are to be decided, the ones before
            that vote on them, and the ones after.
        images: ``[F, H, W, C]``, if the views are known.
        number: of the first frame, in what the environment has seen.
        is_first: whether the episode began with an empty map.
        cursor: index of the next frame to decide.
        stop: index at which to stop for now.
        place: waypoint of the last frame, -1 before the first.
        places: waypoints of the frames that were decided last.
    """

    env: int
    frames: Tensor
    images: Tensor | None
    number: int
    is_first: bool
    cursor: int = 0
    stop: int = 0
    place: int = -1
    places: list[int] = field(default_factory=list)

    def arrive(self, place: int) -> None:
        """Map the next frame to a waypoint."""
        self.place = place
        self.places.append(place)
        self.cursor += 1

    def follow(self, piece: Piece, lookahead: int) -> None:
        """Take in the next observations; those that have their votes are due."""
        self.frames = torch.cat([self.frames, piece.embeddings])
        if self.images is not None and piece.images is not None:
            self.images = torch.cat([self.images, piece.images])
        else:
            self.images = None
        missing = 0 if piece.ends else lookahead
        self.stop = max(len(self.frames) - missing, self.cursor)
        self.places = []

    def shorten(self, context: int) -> None:
        """Forget all but what the next frames need."""
        start = max(self.cursor - context, 0)
        self.frames = self.frames[start:].clone()
        self.images = None if self.images is None else self.images[start:].clone()
        self.cursor, self.number = self.cursor - start, self.number + start


class Discovery:
    """Maps observations to waypoints, adds those that are like none, and links them.

    Many environments are looked at side by side, so that the network compares many
    pairs at once; each sees the waypoints that the others have added so far.

    Args:
        waypoints: read, and added to.
        graph: gets the same waypoints, and edges.
        rules: see `TopologicalMap`.
    """

    def __init__(
        self, waypoints: Waypoints, graph: WaypointGraph, rules: Rules
    ) -> None:
        self.waypoints = waypoints
        self.graph = graph
        self.rules = rules
        self._tracks: dict[int, Track] = {}
        self._counts: dict[int, int] = {}

    def forget(self) -> None:
        """Drop all that is unfinished."""
        self._tracks.clear()

    def renumber(self, number: Tensor) -> None:
        """Follow a merge.

        Args:
            number: int64 ``[W]``, the new number of each waypoint.
        """
        for track in self._tracks.values():
            if track.place >= 0:
                track.place = int(number[track.place])

    def refresh(self) -> None:
        """Embed what is unfinished anew; what has no views is dropped."""
        for env, track in list(self._tracks.items()):
            if track.images is None:
                del self._tracks[env]
            elif len(track.frames):
                track.frames = self.waypoints.embed(track.images)

    def add(self, pieces: Sequence[Piece]) -> list[Tensor]:
        """Go on with the pieces' environments.

        Args:
            pieces: those of one environment in the order of time.

        Returns:
            For each piece int64 ``[A]``: waypoints of the observations that were
            decided, which are all once an episode has ended.
        """
        waves: list[list[int]] = []
        seen: dict[int, int] = {}
        for at, piece in enumerate(pieces):
            wave = seen[piece.env] = seen.get(piece.env, -1) + 1
            if wave == len(waves):
                waves.append([])
            waves[wave].append(at)
        places = [torch.empty(0, dtype=torch.int64)] * len(pieces)
        for some in waves:
            found = self._add_side_by_side([pieces[at] for at in some])
            for at, one in zip(some, found, strict=True):
                places[at] = one
        return places

    def _add_side_by_side(self, pieces: Sequence[Piece]) -> list[Tensor]:
        """`add` for pieces of different environments."""
        tracks = []
        for piece in pieces:
            track = self._tracks.pop(piece.env, None) or self._begin(piece)
            track.follow(piece, self.rules.lookahead)
            self._counts[piece.env] = track.number + len(track.frames)
            tracks.append(track)
        while due := [track for track in tracks if track.cursor < track.stop]:
            self._advance(due)
        for piece, track in zip(pieces, tracks, strict=True):
            if not piece.ends:
                track.shorten(self.rules.context)
                self._tracks[piece.env] = track
        return [torch.tensor(track.places, dtype=torch.int64) for track in tracks]

    def _begin(self, piece: Piece) -> Track:
        return Track(
            env=piece.env,
            frames=piece.embeddings[:0],
            images=None if piece.images is None else piece.images[:0],
            number=self._counts.get(piece.env, 0),
            is_first=not len(self.waypoints),
        )

    def _advance(self, tracks: list[Track]) -> None:
        """Decide up to a block of observations of each track."""
        nodes = [self._around(track) for track in tracks]
        votes = self._votes(tracks, nodes)
        for track, near, block in zip(tracks, nodes, votes, strict=True):
            self._follow_votes(track, near, block)

    def _around(self, track: Track) -> list[int]:
        """The waypoints that an observation is compared with first."""
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
        spans = [
            (
                max(track.cursor - window, 0),
                min(track.cursor + _BLOCK, track.stop) + window,
            )
            for track in tracks
        ]
        frames = [
            track.frames[slice(*span)]
            for track, span in zip(tracks, spans, strict=True)
        ]
        if not most:
            scores = torch.zeros(sum(map(len, frames)), 0)
        elif self.rules.nearby is None:
            scores = self.waypoints.similarities(torch.cat(frames))
        else:
            # Rows of nodes of one length; what is padded is not looked at.
            rows = torch.tensor([near + [0] * (most - len(near)) for near in nodes])
            each = torch.tensor([len(some) for some in frames])
            memory = self.waypoints.prepared[rows].repeat_interleave(each, 0)
            scores = self.waypoints.compare(torch.cat(frames), memory)
        found = []
        for track, (start, _), block, near in zip(
            tracks,
            spans,
            scores.split([len(some) for some in frames]),
            nodes,
            strict=True,
        ):
            begin = track.cursor - start
            num = min(_BLOCK, track.stop - track.cursor)
            found.append(
                moving_mean(np.asarray(block[:, : len(near)]), begin, num, window)
            )
        return found

    def _follow_votes(
        self, track: Track, near: list[int], votes: NDArray[np.float64]
    ) -> None:
        """Decide frames until the votes end or none of the nodes is like one."""
        rules, column = self.rules, {node: at for at, node in enumerate(near)}
        for row in votes:
            if not near:
                return self._search(track)
            here = column.get(track.place)
            stays = rules.hysteresis and here is not None
            if stays and row[here] > rules.tc_threshold:
                track.arrive(track.place)
                continue
            best = int(row.argmax())
            if row[best] > rules.tc_threshold:
                self._move(track, near[best])
            else:
                return self._search(track)
        return None

    def _search(self, track: Track) -> None:
        """Find the next frame among all waypoints, or make it one."""
        window, threshold = self.rules.search_window, self.rules.tc_threshold
        start = max(track.cursor - window, 0)
        frames = track.frames[start : track.cursor + window + 1]
        frame = frames[track.cursor - start]
        some = self.waypoints.alike(frame, self.rules.shortlist)
        known = self.waypoints.similarities(frame.unsqueeze(0), some)[0]
        # A mean above the threshold leaves no single vote below this.
        least = 1 - len(frames) * (1 - threshold) - _ROUNDING
        likely = some[known > least]
        if len(likely):
            votes = self.waypoints.similarities(frames, likely)
            mean = np.asarray(votes, np.float64).mean(0)
            for best in (-mean).argsort(kind="stable"):
                if not mean[best] > threshold:
                    break
                if self._fits(track, node := int(likely[best])):
                    return self._move(track, node)
        return self._bear(track, some, known)

    def _fits(self, track: Track, node: int) -> bool:
        """Whether what lies around a frame is like what lies around a waypoint.

        A view of a bare wall looks like many others, the way to it does not.
        """
        span = self.rules.surroundings
        if not span:
            return True
        steps = [span * part // 4 for part in (-4, -3, -2, -1, 1, 2, 3, 4)]
        at = [track.cursor + step for step in steps if step]
        around = [one for one in at if 0 <= one < len(track.frames)]
        if not around:
            return True
        near = torch.tensor(self.graph.nearby(node, 2 * span))
        known = self.waypoints.similarities(track.frames[around], near)
        return float(known.amax(1).mean()) > self.rules.surroundings_above

    def _move(self, track: Track, place: int) -> None:
        before = track.place
        if before >= 0 and place != before:
            links = self.rules.by_time and self.rules.link_transitions
            if links or self.graph.has_edge(before, place):
                self.graph.walk(before, place)
        track.arrive(place)

    def _bear(self, track: Track, some: Tensor, known: Tensor) -> None:
        """Make the next frame a waypoint.

        Args:
            track: of the frame.
            some: waypoints that are most like it, int64 ``[A]``.
            known: how much, ``[A]``.
        """
        at, before = track.cursor, track.place
        image = None if track.images is None else track.images[at]
        origin = torch.tensor([track.env, track.number + at])
        if self.rules.extend_by == "previous" and not track.is_first:
            some, known = self._seen_before(track)
        place = self.waypoints.add(track.frames[at], image, origin)
        self.graph.add_waypoint()
        if self.rules.by_reach:
            reached = known > self.rules.tc_reach
            self.graph.see(place, some[reached].tolist(), known[reached].tolist())
        if before >= 0 and (self.rules.by_time or self.graph.has_edge(before, place)):
            self.graph.walk(before, place)
        track.arrive(place)

    def _seen_before(self, track: Track) -> tuple[Tensor, Tensor]:
        """Waypoints like the observation before the next one, and how much; eq. 12."""
        if not track.cursor:
            return torch.zeros(0, dtype=torch.int64), torch.zeros(0)
        frame = track.frames[track.cursor - 1]
        some = self.waypoints.alike(frame, self.rules.shortlist)
        return some, self.waypoints.similarities(frame.unsqueeze(0), some)[0]


def moving_mean(
    rows: NDArray[np.float32], begin: int, num: int, window: int
) -> NDArray[np.float64]:
    """Mean of each row with those beside it, as far as there are any.

    Args:
        rows: ``[F, M]``.
        begin: the first row whose mean is wanted.
        num: how many are.
        window: rows on either side.

    Returns:
        ``[num, M]``.

    Examples:
        >>> moving_mean(np.array([[1.0], [2.0], [6.0]]), 0, 3, 1).ravel()
        array([1.5, 3. , 4. ])
    """
    sums = np.zeros((len(rows) + 1, rows.shape[1]))
    np.cumsum(rows, axis=0, dtype=np.float64, out=sums[1:])
    centre = np.arange(begin, begin + num)
    low = np.maximum(centre - window, 0)
    high = np.minimum(centre + window + 1, len(rows))
    mean: NDArray[np.float64] = (sums[high] - sums[low]) / (high - low)[:, None]
    return mean
