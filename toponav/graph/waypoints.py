"""`Waypoints`: the views of a map, embedded, and how similar others are to them."""

import math
from collections.abc import Callable, Mapping
from typing import Any

import torch
from torch import Tensor

from toponav.graph.growing_rows import GrowingRows
from toponav.graph.views import Views, ViewsInMemory
from toponav.parts import require_returned

Embed = Callable[[Tensor], Tensor]
Compare = Callable[[Tensor, Tensor], Tensor]

#: Views embedded and pairs compared in one call: what lies between a network's layers
#: stays in cache.
_VIEWS, _PAIRS = 64, 8192
#: What rounding may add to a similarity of 0 or 1.
_ROUNDING = 1e-3
#: What is kept of each waypoint, beside its view; the first two are made of that.
_EMBEDDED = ("embeddings", "prepared")
_ARRAYS = (*_EMBEDDED, "origins", "headings", "positions")


class Waypoints:
    """Embeddings, views and origins of waypoints 0 to W - 1, kept on the CPU.

    Arguments as in `TopologicalMap`. The methods raise ``ValueError`` if an embedding
    is not finite or a similarity not in [0, 1].
    """

    def __init__(
        self,
        embed: Embed,
        compare: Compare,
        prepare: Embed | None = None,
        views: Views | None = None,
    ) -> None:
        self._embed = embed
        self._compare = compare
        self._prepare = prepare
        # The large ones, so that one more waypoint costs no copy of all.
        self._embeddings = GrowingRows(torch.empty(0))
        self._prepared = GrowingRows(torch.empty(0))
        #: int64 ``[W, 2]``: environment, and number of its observations before.
        self.origins = torch.empty(0, 2, dtype=torch.int64)
        #: Degrees, float32 ``[W]``: which way each looks, seen from the first one; NaN
        #: if not known.
        self.headings = torch.empty(0)
        #: Steps, float32 ``[W, 2]``: where each was seen, if poses were estimated; else
        #: NaN.
        self.positions = torch.empty(0, 2)
        self.views: Views = ViewsInMemory() if views is None else views

    def __len__(self) -> int:
        return len(self.origins)

    @property
    def embeddings(self) -> Tensor:
        """float32 ``[W, D]``."""
        return self._embeddings.rows

    @embeddings.setter
    def embeddings(self, rows: Tensor) -> None:
        self._embeddings = GrowingRows(rows)

    @property
    def prepared(self) -> Tensor:
        """What comparisons are made with, float32 ``[W, P]``."""
        return self._prepared.rows

    @prepared.setter
    def prepared(self, rows: Tensor) -> None:
        self._prepared = GrowingRows(rows)

    @property
    def images(self) -> Tensor:
        """The views, uint8 ``[W, H, W, C]``; empty if none were given."""
        return self.views.read(0, len(self.views))

    @property
    def poses(self) -> Tensor:
        """Positions and headings, float32 ``[W, 3]``, NaN where they are not known."""
        return torch.cat([self.positions, self.headings.unsqueeze(1)], 1)

    def add(
        self,
        embedding: Tensor,
        image: Tensor | None,
        origin: Tensor,
        heading: float = math.nan,
    ) -> int:
        """Add a waypoint of embedding ``[D]`` and, for all or for none, a view."""
        number = len(self)
        if number and (image is None) != (not len(self.views)):
            got = "without" if image is None else "with"
            raise ValueError(f"all waypoints must have views or none, got one {got}")
        row = embedding.unsqueeze(0).float()
        self._embeddings.append(row.squeeze(0))
        self._prepared.append(self.entries(row).squeeze(0))
        self.origins = torch.cat([self.origins, origin.unsqueeze(0)])
        self.headings = torch.cat([self.headings, torch.tensor([heading])])
        nowhere = torch.full((1, 2), torch.nan)
        self.positions = torch.cat([self.positions, nowhere])
        if image is not None:
            self.views.append(image)
        return number

    def keep(self, kept: Tensor) -> None:
        """Remove all waypoints but those with numbers ``kept``, int64 ``[W']``."""
        self.embeddings, self.prepared = self.embeddings[kept], self.prepared[kept]
        self.origins, self.headings = self.origins[kept], self.headings[kept]
        self.positions = self.positions[kept]
        if len(self.views):
            self.views.keep(kept.tolist())

    def arrays(self) -> dict[str, Tensor]:
        """Copies of what is kept of each waypoint, beside its view."""
        return {name: getattr(self, name).clone() for name in _ARRAYS}

    def state_dict(self, *, embeddings: bool = True) -> dict[str, Any]:
        """Copies of what is kept of each waypoint; of views in a file, their places.

        Without ``embeddings``, `refresh` makes them of the views after
        `load_state_dict`, before anything else.
        """
        names = [name for name in _ARRAYS if embeddings or name not in _EMBEDDED]
        copies = {name: getattr(self, name).clone() for name in names}
        return copies | self.views.state_dict()

    def load_state_dict(self, state: Mapping[str, Any]) -> None:
        """Replace all waypoints by those of a `state_dict`.

        States of earlier versions have no headings, or no positions.
        """
        number = len(state["origins"])
        unknown = {
            **{name: torch.empty(0) for name in _EMBEDDED},
            "headings": torch.full((number,), torch.nan),
            "positions": torch.full((number, 2), torch.nan),
        }
        for name, array in (unknown | dict(state)).items():
            if name in _ARRAYS:
                setattr(self, name, array.clone())
        self.views.load_state_dict(state)

    @torch.no_grad()
    def embed(self, views: Tensor) -> Tensor:
        """Embeddings of views ``[N, H, W, C]``, float32 ``[N, D]``."""
        parts = []
        for some in views.split(_VIEWS):
            part = self._embed(some)
            require_returned("embed", part, N=len(some), D=None)
            parts.append(part.float())
        embeddings = torch.cat(parts)
        check_finite(embeddings)
        return embeddings

    def refresh(self) -> None:
        """Embed all views again, after the networks' weights changed."""
        if not len(self):
            return
        if not len(self.views):
            raise ValueError("views must have been given to refresh a map, got none")
        starts = range(0, len(self), _VIEWS)
        parts = [self.embed(self.views.read(at, at + _VIEWS)) for at in starts]
        self.embeddings = torch.cat(parts)
        self.prepared = self.entries(self.embeddings)

    @torch.no_grad()
    def entries(self, embeddings: Tensor) -> Tensor:
        """What is kept of embeddings ``[N, D]`` for comparisons, ``[N, P]``."""
        if self._prepare is None:
            return embeddings
        return self._prepare(embeddings.unsqueeze(0)).squeeze(0).float()

    def entries_of(self, embeddings: Tensor) -> Tensor:
        """`entries` in calls of bounded size."""
        return torch.cat([self.entries(some) for some in embeddings.split(_PAIRS)])

    @torch.no_grad()
    def compare(self, embeddings: Tensor, prepared: Tensor) -> Tensor:
        """Compare ``[N, D]`` with ``[N, M, P]`` in calls of bounded size."""
        rows = max(_PAIRS // max(prepared.shape[1], 1), 1)
        chunks = zip(embeddings.split(rows), prepared.split(rows), strict=True)
        parts = []
        for one, many in chunks:
            part = self._compare(one, many)
            require_returned("compare", part, N=len(one), M=many.shape[1])
            parts.append(part.float())
        found = torch.cat(parts)
        if found.numel():
            low, high = (float(end) for end in found.aminmax())
            # A comparison with NaN is false.
            if not (low >= -_ROUNDING and high <= 1 + _ROUNDING):
                got = f"{low:.3g} to {high:.3g} from compare()"
                raise ValueError(f"similarities must be in [0, 1], got {got}")
        return found.clamp_(0.0, 1.0)

    def similarities(self, embeddings: Tensor, nodes: Tensor | None = None) -> Tensor:
        """Similarity of views ``[N, D]`` to nodes ``[A]``, or all; ``[N, A]``."""
        prepared = self.prepared if nodes is None else self.prepared[nodes]
        if not len(prepared):
            return embeddings.new_zeros(len(embeddings), 0)
        return self.compare(embeddings, prepared.expand(len(embeddings), -1, -1))

    def shortlist(
        self, embedding: Tensor, most: int | None, among: Tensor | None = None
    ) -> Tensor:
        """The ``most`` waypoints with entries nearest to that of a view ``[D]``.

        They are some of ``among``, int64 ``[A]``, if that is given.
        """
        every = torch.arange(len(self)) if among is None else among
        if most is None or most >= len(every):
            return every
        entry = self.entries(embedding.unsqueeze(0))
        prepared = self.prepared if among is None else self.prepared[among]
        distance = (prepared - entry).square_().sum(-1)
        nearest = distance.topk(most, largest=False, sorted=False).indices
        return every[nearest.sort().values]

    def pair_similarities(self, one: Tensor, other: Tensor) -> Tensor:
        """Similarity of waypoints ``one`` to waypoints ``other``, ``[A]`` each."""
        if not len(one):
            return torch.zeros(0)
        prepared = self.prepared[other].unsqueeze(1)
        return self.compare(self.embeddings[one], prepared).squeeze(1)


def check_finite(embeddings: Tensor) -> None:
    """Raise ``ValueError`` for embeddings that would silently become new waypoints."""
    if not bool(embeddings.sum().isfinite()):
        is_broken = (~embeddings.isfinite()).any(-1)
        got = f"NaN or infinity for {is_broken.sum()} of {is_broken.numel()} views"
        raise ValueError(f"embeddings must be finite, got {got}")
