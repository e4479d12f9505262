"""`Waypoints`: the views of a map, embedded, and how alike others are to them."""

from collections.abc import Callable

import torch
from torch import Tensor

from toponav.graph.grown_rows import GrownRows

Embed = Callable[[Tensor], Tensor]
Compare = Callable[[Tensor, Tensor], Tensor]

#: Pairs compared in one call: what lies between a network's layers stays in cache.
_PAIRS = 8192
#: What rounding may add to a similarity of 0 or 1.
_ROUNDING = 1e-3


class Waypoints:
    """Embeddings, views and origins of waypoints 0 to W - 1.

    The networks are callables and stay their owner's; they must be in ``eval()``
    mode. Everything is kept on the CPU: callables that compute elsewhere fetch and
    bring back.

    Args:
        embed: views ``[N, H, W, C]`` to embeddings ``[N, D]``.
        compare: embeddings ``[N, D]`` and memory ``[N, M, P]`` to similarities
            ``[N, M]`` in [0, 1].
        prepare: embeddings ``[N, M, D]`` to entries of the memory ``[N, M, P]``;
            ``None`` keeps the embeddings, ``P = D``.

    Raises:
        ValueError: from the methods, if an embedding is not finite or a similarity not
            in [0, 1].

    Shape notation:
        W: waypoints.  N: any number.  D: embedding.  M: memory.  P: prepared entry.
    """

    def __init__(
        self, embed: Embed, compare: Compare, prepare: Embed | None = None
    ) -> None:
        self._embed = embed
        self._compare = compare
        self._prepare = prepare
        self._embeddings = GrownRows()
        self._prepared = GrownRows()
        self._images = GrownRows()
        self._origins = GrownRows(torch.empty(0, 2, dtype=torch.int64))

    def __len__(self) -> int:
        return len(self._origins)

    @property
    def embeddings(self) -> Tensor:
        """float32 ``[W, D]``."""
        return self._embeddings.values

    @property
    def prepared(self) -> Tensor:
        """float32 ``[W, P]``."""
        return self._prepared.values

    @property
    def images(self) -> Tensor:
        """uint8 ``[W, H, W, C]``; empty if the views were not given."""
        return self._images.values

    @property
    def origins(self) -> Tensor:
        """int64 ``[W, 2]``: environment, and observations that it had made before."""
        return self._origins.values

    def add(self, embedding: Tensor, image: Tensor | None, origin: Tensor) -> int:
        """Add one waypoint; its number.

        Args:
            embedding: ``[D]``.
            image: its view ``[H, W, C]``, for all waypoints or for none.
            origin: int64 ``[2]``, see ``origins``.

        Raises:
            ValueError: if others have a view and this one has none, or the reverse.
        """
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
        """Forget all waypoints but some.

        Args:
            kept: int64 ``[W']``, those that stay, in their new order.
        """
        for name in ("_embeddings", "_prepared", "_images", "_origins"):
            rows: GrownRows = getattr(self, name)
            setattr(self, name, GrownRows(rows.values[kept]) if len(rows) else rows)

    def restore(
        self, embeddings: Tensor, prepared: Tensor, images: Tensor, origins: Tensor
    ) -> None:
        """Replace all waypoints by those of the properties of the same names."""
        self._embeddings, self._prepared = GrownRows(embeddings), GrownRows(prepared)
        self._images, self._origins = GrownRows(images), GrownRows(origins)

    @torch.no_grad()
    def embed(self, views: Tensor, *, chunk: int = 64) -> Tensor:
        """Embeddings of views ``[N, H, W, C]``, float32 ``[N, D]``."""
        parts = [self._embed(some).float() for some in views.split(chunk)]
        embeddings = torch.cat(parts)
        check_finite(embeddings)
        return embeddings

    @torch.no_grad()
    def refresh(self) -> None:
        """Embed all views anew, after the networks' weights changed.

        Raises:
            ValueError: if there are waypoints and the views were not given.
        """
        if not len(self):
            return
        if not len(self._images):
            raise ValueError("views must have been given to refresh a map, got none")
        embeddings = self.embed(self.images)
        self._embeddings = GrownRows(embeddings)
        self._prepared = GrownRows(self.entries(embeddings))

    def entries(self, embeddings: Tensor) -> Tensor:
        """What is kept of embeddings ``[N, D]`` for comparisons, ``[N, P]``."""
        if self._prepare is None:
            return embeddings
        with torch.no_grad():
            return self._prepare(embeddings.unsqueeze(0)).squeeze(0).float()

    @torch.no_grad()
    def compare(self, embeddings: Tensor, prepared: Tensor) -> Tensor:
        """Compare in calls of bounded size.

        Args:
            embeddings: ``[N, D]``.
            prepared: ``[N, M, P]``; an expanded view of one memory is not copied.

        Returns:
            float32 ``[N, M]`` in [0, 1].
        """
        rows = max(_PAIRS // max(prepared.shape[1], 1), 1)
        parts = [
            self._compare(one, many).float()
            for one, many in zip(
                embeddings.split(rows), prepared.split(rows), strict=True
            )
        ]
        found = torch.cat(parts)
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
        """How alike each of N views is to all waypoints, or to some.

        Args:
            embeddings: ``[N, D]``.
            nodes: int64 ``[A]``, numbers of waypoints; ``None`` for all.

        Returns:
            float32 ``[N, W]`` or ``[N, A]``.
        """
        prepared = self.prepared if nodes is None else self.prepared[nodes]
        if not len(prepared):
            return embeddings.new_zeros(len(embeddings), 0)
        return self.compare(embeddings, prepared.expand(len(embeddings), -1, -1))

    def alike(self, embedding: Tensor, most: int | None) -> Tensor:
        """The waypoints whose entries are nearest to a view's, by straight distance.

        Far cheaper than comparing, and a good guess: of 250 views in a map of 1,600,
        the most similar waypoint was among the nearest 32 each time.

        Args:
            embedding: of the view, ``[D]``.
            most: how many; ``None`` for all waypoints.

        Returns:
            int64 ``[A]``, numbers of waypoints, in order.
        """
        if most is None or most >= len(self):
            return torch.arange(len(self))
        entry = self.entries(embedding.unsqueeze(0))
        away = (self.prepared - entry).square_().sum(-1)
        return away.topk(most, largest=False, sorted=False).indices.sort().values

    def pair_similarities(self, one: Tensor, other: Tensor) -> Tensor:
        """Similarity of waypoints ``one`` to waypoints ``other``, ``[A]`` each."""
        if not len(one):
            return torch.zeros(0)
        prepared = self.prepared[other].unsqueeze(1)
        return self.compare(self.embeddings[one], prepared).squeeze(1)


def check_finite(embeddings: Tensor) -> None:
    """Refuse embeddings that would silently count as new places.

    Raises:
        ValueError: if one is NaN or infinite.
    """
    if not bool(embeddings.sum().isfinite()):
        broken = int((~embeddings.isfinite()).any(-1).sum())
        raise ValueError(
            f"embeddings must be finite, got NaN or infinity for {broken} of "
            f"{embeddings[..., 0].numel()} views"
        )
