"""`Track`: what one environment sees, until it is decided which waypoints it is."""

from dataclasses import dataclass, field

import torch
from torch import Tensor

from toponav.graph.pieces import Piece


@dataclass
class Track:
    """The observations of one environment, and which of them are decided."""

    env: int
    frames: Tensor  # embeddings [F, D] to decide, and those before and after that vote
    images: Tensor | None  # [F, H, W, C], if the views are known
    number: int  # of the first frame among all observations of the environment
    is_first: bool  # whether it is the map's first episode; others begin beside it
    #: Degrees, float32 ``[F]``: which way each frame looks, seen from the first one or,
    #: once the track is ``oriented``, as the map's waypoints count; NaN if not known.
    headings: Tensor
    heading: float = 0.0  # of the next frame
    oriented: bool = True
    cursor: int = 0  # index of the next frame to decide
    stop: int = 0  # from here on, votes are missing
    ends: bool = False  # no further frame follows
    #: Waypoints of the last decided frames, those that an edge by time may begin at.
    recent: list[int] = field(default_factory=list)
    #: The last waypoint that a frame surely was at, -1 without one, and that frame.
    sure: int = -1
    sure_number: int = 0
    #: Waypoints of the frames that were decided since the last piece.
    places: list[int] = field(default_factory=list)

    @property
    def place(self) -> int:
        """Waypoint of the last decided frame, -1 before the first."""
        return self.recent[-1] if self.recent else -1

    def append(self, piece: Piece, lookahead: int) -> None:
        """Add a piece; all but its last ``lookahead`` frames can then be decided."""
        self.frames = torch.cat([self.frames, piece.embeddings])
        if self.images is not None and piece.images is not None:
            self.images = torch.cat([self.images, piece.images])
        else:
            self.images = None
        if piece.turns is None:
            turned = torch.full((len(piece.embeddings),), torch.nan)
        else:
            after = piece.turns.cumsum(0)
            turned = self.heading + after - piece.turns
            self.heading += float(after[-1])
        self.headings = torch.cat([self.headings, turned])
        missing = 0 if piece.ends else lookahead
        self.stop = max(len(self.frames) - missing, self.cursor)
        self.ends, self.places = piece.ends, []

    def orient(self, offset: float) -> None:
        """Count its headings as the map does, which are larger by ``offset``."""
        self.headings, self.heading = self.headings + offset, self.heading + offset
        self.oriented = True

    def drop_decided(self, context: int) -> None:
        """Forget frames that are more than ``context`` before the next to decide."""
        start = max(self.cursor - context, 0)
        self.frames = self.frames[start:].clone()
        self.headings = self.headings[start:].clone()
        self.images = None if self.images is None else self.images[start:].clone()
        self.cursor, self.number = self.cursor - start, self.number + start
