"""Which observations of a sequence become waypoints, and their share.

- `Waypoints`, `prepare_walks`: sequences prepared once for many thresholds.
- `waypoint_mask`, `waypoint_share`, `share_curve`: the first stage of discovery.
- `similarity_matrix`, `later_similarity`, `recent_similarity`: what one compares
  with what.

All work on embeddings of whole sequences, ``[T, D]``, in the order of observation.
"""

import math
from collections.abc import Sequence
from typing import Protocol

import numpy as np
import torch
from torch import Tensor

#: Observations compared with all of their `_RECENT` predecessors in one call.
_CHUNK = 256


class Comparing(Protocol):
    """What calibration asks of a network; `TCNetwork` in ``eval()`` provides it."""

    def prepare_memory(self, memory: Tensor) -> Tensor:
        """``[*B, M, D]`` to ``[*B, M, P]``."""

    def compare_prepared(self, embedding: Tensor, prepared: Tensor) -> Tensor:
        """``[*B, D]`` and ``[*B, M, P]`` to probabilities ``[*B, M]``."""


@torch.no_grad()
def similarity_matrix(
    embeddings: Tensor, network: Comparing, *, chunk: int = 64
) -> Tensor:
    """Similarity of every view to every other.

    Args:
        embeddings: ``[T, D]``.
        network: compares, see `Comparing`.
        chunk: rows computed in one call.

    Returns:
        float32 ``[T, T]``; row: the observation, column: the memory's entry.
    """
    prepared = network.prepare_memory(embeddings)
    rows = [
        network.compare_prepared(rows, prepared.expand(len(rows), -1, -1))
        for rows in embeddings.split(chunk)
    ]
    return torch.cat(rows)


@torch.no_grad()
def recent_similarity(embeddings: Tensor, network: Comparing, reach: int) -> Tensor:
    """Similarity of every observation to those just before it.

    Args:
        embeddings: ``[T, D]``.
        network: compares, see `Comparing`.
        reach: L, how many predecessors.

    Returns:
        float32 ``[T, L]``; column j belongs to observation ``t - 1 - j``, and where
        there is none the value is NaN.
    """
    prepared = network.prepare_memory(embeddings)
    time = torch.arange(len(embeddings), device=embeddings.device)
    back = 1 + torch.arange(reach, device=embeddings.device)
    before = time.unsqueeze(1) - back
    found = [
        network.compare_prepared(embeddings[rows], prepared[before[rows].clamp(min=0)])
        for rows in time.split(_CHUNK)
    ]
    return torch.cat(found).masked_fill(before < 0, math.nan)


@torch.no_grad()
def later_similarity(
    embeddings: Tensor, network: Comparing, *, chunk: int = 16
) -> Tensor:
    """Similarity of every observation to all before it: half of a matrix.

    Args:
        embeddings: ``[T, D]``.
        network: compares, see `Comparing`.
        chunk: observations compared in one call; few, so that what lies between the
            layers stays in the processor's cache.

    Returns:
        float32 ``[T, T]`` on the processor; row: the memory's entry, column: the
        observation; -1 where the observation is not the later one.
    """
    prepared = network.prepare_memory(embeddings)
    length = len(embeddings)
    later = torch.full((length, length), -1.0)
    for begin in range(0, length, chunk):
        rows = embeddings[begin : begin + chunk]
        memory = prepared[: begin + len(rows)].expand(len(rows), -1, -1)
        found = network.compare_prepared(rows, memory).float().cpu()
        later[: begin + len(rows), begin : begin + len(rows)] = found.T
    return later.masked_fill_(torch.ones_like(later, dtype=torch.bool).tril(), -1.0)


class Waypoints:
    """A sequence with all that does not depend on the threshold.

    Every observation is compared with all before it, once; any number of thresholds
    is then a matter of milliseconds.

    Args:
        embeddings: ``[T, D]``, in the order of observation.
        network: compares, see `Comparing`.

    Raises:
        ValueError: if the sequence is empty or no matrix, or a similarity is NaN.
    """

    def __init__(self, embeddings: Tensor, network: Comparing) -> None:
        check_sequence(embeddings)
        #: Row t, column s > t: the similarity of observation s to observation t.
        self.later = later_similarity(embeddings, network).numpy()
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
        """Waypoints per observation."""
        return len(self.times(threshold)) / len(self.later)


def prepare_walks(
    sequences: Sequence[Tensor | Waypoints], network: Comparing
) -> list[Waypoints]:
    """Compare each sequence with itself, unless that was done before.

    Args:
        sequences: embeddings ``[T, D]``, or what this function returned.
        network: compares, see `Comparing`.

    Raises:
        ValueError: as `Waypoints`.
    """
    return [
        one if isinstance(one, Waypoints) else Waypoints(one, network)
        for one in sequences
    ]


@torch.no_grad()
def waypoint_mask(embeddings: Tensor, network: Comparing, threshold: float) -> Tensor:
    """Which observations become waypoints: the paper's first stage of discovery.

    The first observation is a waypoint. A later one becomes a waypoint if its
    similarity to *all* waypoints before it is at most ``threshold``.

    Reference:
        The paper, "Topological map", eq. 9 and the text before it.

    Args:
        embeddings: ``[T, D]`` of one sequence, in the order of observation.
        network: compares, see `Comparing`.
        threshold: tc_th, in [0, 1].

    Returns:
        bool ``[T]``.

    Raises:
        ValueError: if the sequence is empty or no matrix, or a similarity is NaN.

    Examples:
        >>> line = torch.tensor([[0.0], [1.0], [2.0], [3.0], [0.5]])
        >>> class Nearness:
        ...     def prepare_memory(self, memory):
        ...         return memory
        ...     def compare_prepared(self, embedding, prepared):
        ...         return 1 / (1 + (embedding.unsqueeze(-2) - prepared).abs().sum(-1))
        >>> waypoint_mask(line, Nearness(), 0.4)  # closer than 1.5 is the same place
        tensor([ True, False,  True, False, False])
    """
    mask = torch.zeros(len(embeddings), dtype=torch.bool)
    mask[Waypoints(embeddings, network).times(threshold)] = True
    return mask


@torch.no_grad()
def waypoint_share(embeddings: Tensor, network: Comparing, threshold: float) -> float:
    """Waypoints kept per observation, see `waypoint_mask` and Table 1."""
    return Waypoints(embeddings, network).share(threshold)


@torch.no_grad()
def share_curve(
    sequences: Sequence[Tensor | Waypoints],
    network: Comparing,
    thresholds: Sequence[float],
) -> Tensor:
    """`waypoint_share` of every sequence at every threshold.

    It need not rise with the threshold: an observation that a higher threshold lets
    in may cover several that came in without it. In practice the mean over
    sequences rises. It costs T^2 / 2 comparisons a sequence: a few sequences are
    enough for a picture.

    Args:
        sequences: S times ``[T, D]``, lengths may differ, or prepared walks.
        network: compares, see `Comparing`.
        thresholds: K values in [0, 1].

    Returns:
        float64 ``[S, K]``.

    Raises:
        ValueError: as `waypoint_mask`.
    """
    return torch.tensor(
        [
            [walk.share(threshold) for threshold in thresholds]
            for walk in prepare_walks(sequences, network)
        ],
        dtype=torch.float64,
    )


def check_sequence(embeddings: Tensor) -> None:
    """Raise ``ValueError`` unless this is ``[T, D]`` with at least one view."""
    if embeddings.ndim != 2 or not len(embeddings):
        raise ValueError(
            "a sequence must be embeddings [T, D] with T >= 1, got "
            f"{tuple(embeddings.shape)}."
        )
