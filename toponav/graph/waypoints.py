"""`Waypoints`: the views of a map, embedded, and how similar others are to them."""

from collections.abc import Callable

import torch
from torch import Tensor

Embed = Callable[[Tensor], Tensor]
Compare = Callable[[Tensor, Tensor], Tensor]

#: Pairs compared in one call: what lies between a network's layers stays in cache.
_PAIRS = 8192
#: What rounding may add to a similarity of 0 or 1.
_ROUNDING = 1e-3


class RowBuffer:
    """Rows ``[N, ...]`` of one kind; more are appended in amortised constant time."""

    def __init__(self, rows: Tensor | None = None) -> None:
        self._buffer = torch.empty(0) if rows is None else rows.clone()
        self._length = len(self._buffer)

    def __len__(self) -> int:
        return self._length

    @property
    def values(self) -> Tensor:
        """All rows, ``[N, ...]``: a view that the next `append` may invalidate."""
        return self._buffer[: self._length]

    def append(self, rows: Tensor) -> None:
        """Add rows ``[A, ...]`` of the shape and dtype of the others."""
        if not self._length:
            self._buffer = rows.new_empty(0, *rows.shape[1:])
        kind = (rows.shape[1:], rows.dtype)
        if kind != (self._buffer.shape[1:], self._buffer.dtype):
            raise ValueError(
                f"rows must be {self._buffer.dtype} {list(self._buffer.shape[1:])} as "
                f"those before, got {rows.dtype} {list(rows.shape[1:])}"
            )
        length = self._length + len(rows)
        if length > len(self._buffer):
            capacity = max(length, 2 * len(self._buffer), 8)
            larger = self._buffer.new_empty(capacity, *self._buffer.shape[1:])
            larger[: self._length] = self.values
            self._buffer = larger
        self._buffer[self._length : length] = rows
        self._length = length


class Waypoints:
    """Embeddings, views and origins of waypoints 0 to W - 1, kept on the CPU.

    Its arguments are those of `TopologicalMap`. The methods raise ``ValueError`` if an
    embedding is not finite or a similarity not in [0, 1].
    """

    def __init__(
        self, embed: Embed, compare: Compare, prepare: Embed | None = None
    ) -> None:
        self._embed = embed
        self._compare = compare
        self._prepare = prepare
        self._embeddings = RowBuffer()
        self._prepared = RowBuffer()
        self._images = RowBuffer()
        self._origins = RowBuffer(torch.empty(0, 2, dtype=torch.int64))

    def __len__(self) -> int:
        return len(self._origins)

    @property
    def embeddings(self) -> Tensor:
        return self._embeddings.values

    @property
    def prepared(self) -> Tensor:
        return self._prepared.values

    @property
    def images(self) -> Tensor:
        """uint8 ``[W, H, W, C]``; empty if the views were not given."""
        return self._images.values

    @property
    def origins(self) -> Tensor:
        """int64 ``[W, 2]``: environment, and number of its observations before."""
        return self._origins.values

    def add(self, embedding: Tensor, image: Tensor | None, origin: Tensor) -> int:
        """Add a waypoint of embedding ``[D]`` and, for all or for none, a view."""
        number = len(self)
        if number and (image is None) != (len(self._images) == 0):
            raise ValueError(
                "views must be given for all waypoints or for none, got one "
                + ("without" if image is None else "with")
            )
        row = embedding.unsqueeze(0).float()
        self._embeddings.append(row)
        self._prepared.append(self.entries(row))
        self._origins.append(origin.unsqueeze(0))
        if image is not None:
            self._images.append(image.unsqueeze(0))
        return number

    def keep(self, kept: Tensor) -> None:
        """Remove all waypoints but those with numbers ``kept``, int64 ``[W']``."""
        for name in ("_embeddings", "_prepared", "_images", "_origins"):
            rows: RowBuffer = getattr(self, name)
            setattr(self, name, RowBuffer(rows.values[kept]) if len(rows) else rows)

    def restore(
        self, embeddings: Tensor, prepared: Tensor, images: Tensor, origins: Tensor
    ) -> None:
        """Replace all waypoints by those of the properties of the same names."""
        self._embeddings, self._prepared = RowBuffer(embeddings), RowBuffer(prepared)
        self._images, self._origins = RowBuffer(images), RowBuffer(origins)

    @torch.no_grad()
    def embed(self, views: Tensor, *, chunk: int = 64) -> Tensor:
        """Embeddings of views ``[N, H, W, C]``, float32 ``[N, D]``."""
        embeddings = torch.cat(
            [self._embed(some).float() for some in views.split(chunk)]
        )
        check_finite(embeddings)
        return embeddings

    @torch.no_grad()
    def refresh(self) -> None:
        """Embed all views again, after the networks' weights changed."""
        if not len(self):
            return
        if not len(self._images):
            raise ValueError("views must have been given to refresh a map, got none")
        embeddings = self.embed(self.images)
        self._embeddings = RowBuffer(embeddings)
        self._prepared = RowBuffer(self.entries(embeddings))

    def entries(self, embeddings: Tensor) -> Tensor:
        """What is kept of embeddings ``[N, D]`` for comparisons, ``[N, P]``."""
        if self._prepare is None:
            return embeddings
        with torch.no_grad():
            return self._prepare(embeddings.unsqueeze(0)).squeeze(0).float()

    @torch.no_grad()
    def compare(self, embeddings: Tensor, prepared: Tensor) -> Tensor:
        """Compare ``[N, D]`` with ``[N, M, P]`` in calls of bounded size.

        An expanded view of one memory is not copied.
        """
        rows = max(_PAIRS // max(prepared.shape[1], 1), 1)
        chunks = zip(embeddings.split(rows), prepared.split(rows), strict=True)
        found = torch.cat([self._compare(one, many).float() for one, many in chunks])
        if found.numel():
            low, high = (float(end) for end in found.aminmax())
            # A comparison with NaN is false.
            if not (low >= -_ROUNDING and high <= 1 + _ROUNDING):
                raise ValueError(
                    f"similarities must be in [0, 1], got {low:.3g} to {high:.3g} from "
                    "compare()"
                )
        return found.clamp_(0.0, 1.0)

    def similarities(self, embeddings: Tensor, nodes: Tensor | None = None) -> Tensor:
        """Similarity of views ``[N, D]`` to nodes ``[A]``, or all; ``[N, A]``."""
        prepared = self.prepared if nodes is None else self.prepared[nodes]
        if not len(prepared):
            return embeddings.new_zeros(len(embeddings), 0)
        return self.compare(embeddings, prepared.expand(len(embeddings), -1, -1))

    def shortlist(self, embedding: Tensor, most: int | None) -> Tensor:
        """The ``most`` waypoints whose entries are nearest to that of a view ``[D]``.

        Far cheaper than comparing, and a good guess: of 250 views in a map of 1,600,
        the most similar waypoint was among the nearest 32 each time.
        """
        if most is None or most >= len(self):
            return torch.arange(len(self))
        entry = self.entries(embedding.unsqueeze(0))
        distance = (self.prepared - entry).square_().sum(-1)
        return distance.topk(most, largest=False, sorted=False).indices.sort().values

    def pair_similarities(self, one: Tensor, other: Tensor) -> Tensor:
        """Similarity of waypoints ``one`` to waypoints ``other``, ``[A]`` each."""
        if not len(one):
            return torch.zeros(0)
        prepared = self.prepared[other].unsqueeze(1)
        return self.compare(self.embeddings[one], prepared).squeeze(1)


def check_finite(embeddings: Tensor) -> None:
    """Raise ``ValueError`` for embeddings that would silently become new waypoints."""
    if not bool(embeddings.sum().isfinite()):
        broken = int((~embeddings.isfinite()).any(-1).sum())
        raise ValueError(
            f"embeddings must be finite, got NaN or infinity for {broken} of "
            f"{embeddings[..., 0].numel()} views"
        )
