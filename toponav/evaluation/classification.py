"""How well scores tell two classes apart: measures that need no maze.

- `balanced_accuracy`, `binned_share`: rates, whole and by bin of another quantity.
- `roc_curve`, `roc_auc`: over all thresholds; the area is exact, by ranks.
- `calibration_curve`, `expected_calibration_error`: are the probabilities true?
"""

from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class Binned:
    """A mean per bin of another quantity.

    Args:
        edges: of the bins, ``[N + 1]``.
        mean: in each bin, NaN where nothing fell, ``[N]``.
        count: in each bin, ``[N]``.
    """

    edges: Tensor
    mean: Tensor
    count: Tensor

    @property
    def centres(self) -> Tensor:
        """Middles of the bins, ``[N]``."""
        return (self.edges[1:] + self.edges[:-1]) / 2


def binned_mean(value: Tensor, by: Tensor, edges: Tensor) -> Binned:
    """Mean of ``value`` in bins of ``by``; what lies outside the edges is left out.

    Args:
        value: ``[P]``, numbers or bools.
        by: ``[P]``.
        edges: ascending ``[N + 1]``; a bin holds its lower edge, the last one both.

    Returns:
        The means and how many values each one stands for.

    Examples:
        >>> found = binned_mean(
        ...     torch.tensor([1.0, 0.0, 1.0]),
        ...     torch.tensor([0.5, 0.7, 2.0]),
        ...     torch.tensor([0.0, 1.0, 2.0]),
        ... )
        >>> found.mean.tolist(), found.count.tolist()
        ([0.5, 1.0], [2, 1])
    """
    edges = edges.to(torch.float64)
    inside = (by >= edges[0]) & (by <= edges[-1])
    where = torch.bucketize(by[inside].double(), edges[1:-1], right=True)
    count = torch.bincount(where, minlength=len(edges) - 1)
    total = torch.bincount(
        where, weights=value[inside].double(), minlength=len(edges) - 1
    )
    return Binned(edges, total / count, count)


def balanced_accuracy(prediction: Tensor, label: Tensor) -> float:
    """Mean of the two classes' accuracies, NaN if one class is missing.

    Args:
        prediction: bool ``[P]``.
        label: ``[P]``, 0 or 1.
    """
    truth = label > 0.5
    positive = (prediction & truth).sum() / truth.sum()
    negative = (~prediction & ~truth).sum() / (~truth).sum()
    return float((positive + negative) / 2)


def roc_curve(score: Tensor, label: Tensor) -> tuple[Tensor, Tensor]:
    """True positive rate over false positive rate, for every distinct threshold.

    Args:
        score: ``[P]``, higher for positives.
        label: ``[P]``, 0 or 1.

    Returns:
        False and true positive rates, float64 ``[K + 1]``, from (0, 0) to (1, 1).

    Raises:
        ValueError: if a score is NaN or a class is missing.
    """
    truth = _check_scores(score, label)
    values, where = score.unique(return_inverse=True)
    size = len(values)
    hits = torch.bincount(where[truth], minlength=size).double().flip(0).cumsum(0)
    alarms = torch.bincount(where[~truth], minlength=size).double().flip(0).cumsum(0)
    start = torch.zeros(1, dtype=torch.float64)
    return (
        torch.cat([start, alarms / alarms[-1]]),
        torch.cat([start, hits / hits[-1]]),
    )


def roc_auc(score: Tensor, label: Tensor) -> float:
    """Probability that a positive scores above a negative, ties half; exact.

    The rank sum of the positives (Mann and Whitney), tied scores sharing their mean
    rank.

    Args:
        score: ``[P]``.
        label: ``[P]``, 0 or 1.

    Raises:
        ValueError: if a score is NaN or a class is missing.

    Examples:
        >>> roc_auc(torch.tensor([0.1, 0.4, 0.4, 0.9]), torch.tensor([0, 0, 1, 1]))
        0.875
    """
    truth = _check_scores(score, label)
    _, where, count = score.unique(return_inverse=True, return_counts=True)
    mean_rank = count.double().cumsum(0) - (count - 1) / 2
    num_positive = int(truth.sum())
    num_negative = len(truth) - num_positive
    above = mean_rank[where][truth].sum() - num_positive * (num_positive + 1) / 2
    return float(above / (num_positive * num_negative))


def calibration_curve(
    probability: Tensor, label: Tensor, *, num_bins: int = 10
) -> tuple[Binned, Binned]:
    """Share of positives over the predicted probability, in equal bins of it.

    Args:
        probability: ``[P]`` in [0, 1].
        label: ``[P]``, 0 or 1.
        num_bins: of equal width.

    Returns:
        The mean prediction and the share of positives in each bin.

    Raises:
        ValueError: if a probability lies outside [0, 1].
    """
    if not ((probability >= 0) & (probability <= 1)).all():
        raise ValueError("probability must lie in [0, 1].")
    edges = torch.linspace(0, 1, num_bins + 1)
    return (
        binned_mean(probability, probability, edges),
        binned_mean(label, probability, edges),
    )


def expected_calibration_error(
    probability: Tensor, label: Tensor, *, num_bins: int = 10
) -> float:
    """Mean over pairs of |prediction - share of positives| in the pair's bin.

    Reference:
        Guo et al., "On Calibration of Modern Neural Networks" (2017), eq. 3, for two
        classes. https://arxiv.org/abs/1706.04599

    Args:
        probability: ``[P]`` in [0, 1].
        label: ``[P]``, 0 or 1; the error holds for this mixture of classes.
        num_bins: of equal width.

    Examples:
        >>> always = torch.full((4,), 0.8)
        >>> round(expected_calibration_error(always, torch.tensor([1, 1, 1, 0])), 3)
        0.05
    """
    said, true = calibration_curve(probability, label, num_bins=num_bins)
    error = (said.mean - true.mean).abs() * said.count
    return float(error.nansum() / said.count.sum())


def _check_scores(score: Tensor, label: Tensor) -> Tensor:
    """The labels as bools, if both classes occur and all scores are numbers."""
    if score.isnan().any():
        raise ValueError("score must be numbers, got NaN.")
    truth = label > 0.5
    if truth.all() or not truth.any():
        raise ValueError(
            f"both classes must occur, got {int(truth.sum())} positives among "
            f"{len(truth)} pairs."
        )
    return truth
