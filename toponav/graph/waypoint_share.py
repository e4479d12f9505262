"""Which observations of a sequence become waypoints, and their share."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np
import torch
from torch import Tensor

#: Observations compared in one call; few, so that what lies between the layers stays in
#: the processor's cache.
_CHUNK = 16


class Comparing(Protocol):
    """What calibration asks of a network; `TCNetwork` in ``eval()`` provides it."""

    def prepare_memory(self, memory: Tensor) -> Tensor:
        """``[*B, M, D]`` to ``[*B, M, P]``."""

    def compare_prepared(self, embedding: Tensor, prepared: Tensor) -> Tensor:
        """``[*B, D]`` and ``[*B, M, P]`` to probabilities ``[*B, M]``."""


class WalkWaypoints:
    """A sequence of observations ``[T, D]``, and which of them become waypoints.

    The paper's first stage of discovery: the first observation is a waypoint, and a
    later one becomes a waypoint if its similarity to *all* waypoints before it is at
    most the threshold. `TopologicalMap` does the same to its first episode by the
    paper's rules; here every observation is compared with all before it, once, and any
    number of thresholds is then a matter of milliseconds.

    Reference:
        The paper, "Topological map", eq. 9 and the text before it.

    Examples:
        >>> class Nearness:
        ...     def prepare_memory(self, memory):
        ...         return memory
        ...     def compare_prepared(self, embedding, prepared):
        ...         return 1 / (1 + (embedding.unsqueeze(-2) - prepared).abs().sum(-1))
        >>> line = torch.tensor([[0.0], [1.0], [2.0], [3.0], [0.5]])
        >>> WalkWaypoints(line, Nearness()).times(0.4)  # up to 1.5 is the same place
        [0, 2]
    """

    @torch.no_grad()
    def __init__(self, embeddings: Tensor, network: Comparing) -> None:
        if embeddings.ndim != 2 or not len(embeddings):
            got = tuple(embeddings.shape)
            raise ValueError(
                f"a sequence must be embeddings [T, D] with T >= 1, got {got}."
            )
        prepared = network.prepare_memory(embeddings)
        later = torch.full((len(embeddings), len(embeddings)), -1.0)
        for begin in range(0, len(embeddings), _CHUNK):
            rows = embeddings[begin : begin + _CHUNK]
            end = begin + len(rows)
            memory = prepared[:end].expand(len(rows), -1, -1)
            found = network.compare_prepared(rows, memory).float().cpu()
            later[:end, begin:end] = found.T
        later.masked_fill_(torch.ones_like(later, dtype=torch.bool).tril(), -1.0)
        #: Row t, column s > t: the similarity of observation s to observation t; else
        #: -1.
        self.later = later.numpy()
        if np.isnan(self.later).any():
            raise ValueError("similarities must be numbers, got NaN.")

    def times(self, threshold: float) -> list[int]:
        """Times of the waypoints, in order."""
        covered = np.zeros(len(self.later), dtype=np.bool_)
        kept: list[int] = []
        for time in range(len(covered)):
            if not covered[time]:
                kept.append(time)
                covered |= self.later[time] > threshold
        return kept

    def share(self, threshold: float) -> float:
        """Waypoints per observation, as in Table 1."""
        return len(self.times(threshold)) / len(self.later)


def prepare_walks(
    sequences: Sequence[Tensor | WalkWaypoints], network: Comparing
) -> list[WalkWaypoints]:
    """Compare each sequence with itself, unless that was done before."""
    if not sequences:
        raise ValueError("sequences must hold at least one, got none.")
    return [
        one if isinstance(one, WalkWaypoints) else WalkWaypoints(one, network)
        for one in sequences
    ]


def share_curve(walks: Sequence[WalkWaypoints], thresholds: Sequence[float]) -> Tensor:
    """Share of waypoints of S walks at K thresholds, float64 ``[S, K]``.

    It need not rise with the threshold: an observation that a higher threshold lets in
    may cover several that came in without it. In practice the mean over walks rises.
    """
    shares = [[walk.share(threshold) for threshold in thresholds] for walk in walks]
    return torch.tensor(shares, dtype=torch.float64)
