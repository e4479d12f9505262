"""The temporal correlation against the truth.

- `tc_report`: all measures on held-out pairs, a `TCReport`.
- `place_error`: does the most similar view show the same place?
- `pair_candidates`, `most_similar`: which view looks most like another one.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from toponav.evaluation.classification import (
    Binned,
    balanced_accuracy,
    binned_mean,
    calibration_curve,
    expected_calibration_error,
    roc_auc,
    roc_curve,
)
from toponav.evaluation.pair_truth import PairTruth

#: Edges of the bins of distance, in cells.
DISTANCE_CELLS = (0.0, 0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0)
#: Edges of the bins of decisions.
DECISIONS = (0.0, 2.0, 4.0, 6.0, 8.0, 12.0, 16.0, 20.0, 30.0, 40.0, 80.0)
#: Edges of the bins of heading difference, in degrees.
HEADINGS = (0.0, 30.0, 60.0, 90.0, 120.0, 150.0, 180.0)


@dataclass(frozen=True)
class TCReport:
    """What a temporal correlation is worth, on P held-out pairs.

    The first block are single numbers, the second curves. "Near" means a similarity
    above 0.5, the decision that training asks for.

    Args:
        num_pairs: P.
        accuracy: balanced, in [0, 1].
        positive_accuracy: share of positives called near.
        negative_accuracy: share of negatives not called near.
        auc: area under the ROC curve.
        calibration_error: expected calibration error of "within k decisions".
        negatives_near: label noise; negatives that a perfect walker joins in at most
            k decisions, see ``decisions`` of `PairTruth`.
        positives_far: positives that even the least count puts beyond k decisions:
            zero, up to rounding, or the pairs are wrong.
        through_wall_rate: pairs near in the plan and far on foot that are called
            near; NaN without such pairs.
        num_through_wall: how many there are.
        by_distance: accuracy over walking distance in cells.
        positives_by_distance: share called near, of the positives.
        negatives_by_distance: share called near, of the negatives.
        by_decisions: accuracy over the decisions of a perfect walker.
        roc: false and true positive rates.
        calibration: mean similarity and share of positives, by similarity.
        similarity: mean similarity over distance in cells (columns) and heading
            difference in degrees (rows), NaN where nothing fell.
        similarity_count: pairs behind each entry of ``similarity``.
    """

    num_pairs: int
    accuracy: float
    positive_accuracy: float
    negative_accuracy: float
    auc: float
    calibration_error: float
    negatives_near: float
    positives_far: float
    through_wall_rate: float
    num_through_wall: int

    by_distance: Binned
    positives_by_distance: Binned
    negatives_by_distance: Binned
    by_decisions: Binned
    roc: tuple[Tensor, Tensor]
    calibration: tuple[Binned, Binned]
    similarity: Tensor
    similarity_count: Tensor

    def numbers(self) -> dict[str, float]:
        """The single numbers by name, for loggers and tables."""
        return {
            name: float(value)
            for name, value in vars(self).items()
            if isinstance(value, int | float)
        }


def tc_report(
    similarity: Tensor,
    label: Tensor,
    truth: PairTruth,
    *,
    max_action_distance: int = 4,
    cell_size: float = 128.0,
) -> TCReport:
    """Measure a temporal correlation on held-out pairs.

    Args:
        similarity: probabilities ``[P]``, float32.
        label: ``[P]``; 1: at most k decisions apart in the episode, 0: at least M k.
        truth: of the same pairs.
        max_action_distance: k.
        cell_size: side of a cell in map units.

    Returns:
        All measures. The calibration error holds for the mixture of labels given.

    Raises:
        ValueError: if the lengths differ, a class is missing, or a similarity is no
            probability.

    Examples:
        >>> from toponav.evaluation import MazeMetric, pair_truth
        >>> metric = MazeMetric(torch.ones(1, 4, dtype=torch.bool))
        >>> here = torch.tensor([[64.0, 64.0]]).expand(2, 2)
        >>> there = torch.tensor([[97.0, 64.0], [448.0, 64.0]])
        >>> truth = pair_truth(metric, (here, there), (torch.zeros(2), torch.zeros(2)))
        >>> report = tc_report(torch.tensor([0.9, 0.2]), torch.tensor([1, 0]), truth)
        >>> report.accuracy, report.auc, report.negatives_near
        (1.0, 1.0, 0.0)
    """
    if not len(similarity) == len(label) == len(truth.distance):
        raise ValueError(
            "similarity, label and truth must be of one length, got "
            f"{len(similarity)}, {len(label)} and {len(truth.distance)}."
        )
    positive = label > 0.5
    called_near = similarity > 0.5
    correct = called_near == positive
    cells = truth.distance / cell_size
    edges = torch.tensor(DISTANCE_CELLS)
    mean, count = _similarity_map(similarity, cells, truth.heading_difference)
    return TCReport(
        num_pairs=len(label),
        accuracy=balanced_accuracy(called_near, label),
        positive_accuracy=_share(called_near[positive]),
        negative_accuracy=_share(~called_near[~positive]),
        auc=roc_auc(similarity, label),
        calibration_error=expected_calibration_error(similarity, label),
        negatives_near=_share(truth.decisions[~positive] <= max_action_distance),
        # A walker's step is 33.1 map units to within a percent.
        positives_far=_share(
            truth.least_decisions[positive] > 1.02 * max_action_distance
        ),
        through_wall_rate=_share(called_near[truth.through_wall]),
        num_through_wall=int(truth.through_wall.sum()),
        by_distance=binned_mean(correct, cells, edges),
        positives_by_distance=binned_mean(
            called_near[positive], cells[positive], edges
        ),
        negatives_by_distance=binned_mean(
            called_near[~positive], cells[~positive], edges
        ),
        by_decisions=binned_mean(correct, truth.decisions, torch.tensor(DECISIONS)),
        roc=roc_curve(similarity, label),
        calibration=calibration_curve(similarity, label),
        similarity=mean,
        similarity_count=count,
    )


def pair_candidates(
    episode: Tensor, step: Tensor, *, min_gap: int, rows: Tensor | None = None
) -> Tensor:
    """Which views may stand for each other: of two episodes, or far apart in time.

    Args:
        episode: int64 ``[V]``.
        step: decision within the episode, int64 ``[V]``.
        min_gap: least number of decisions between two views of one episode; 1 for
            any other view.
        rows: int64 ``[Q]``, the views that look for others; all by default.

    Returns:
        bool ``[Q, V]``; never true for a view and itself.

    Raises:
        ValueError: if ``min_gap < 1``.

    Examples:
        >>> pair_candidates(
        ...     torch.tensor([0, 0, 1]), torch.tensor([3, 9, 3]), min_gap=20
        ... ).int()
        tensor([[0, 0, 1],
                [0, 0, 1],
                [1, 1, 0]], dtype=torch.int32)

    Shape notation:
        V: views.  Q: those of them that look for others.
    """
    if min_gap < 1:
        raise ValueError(f"min_gap must be at least 1, got {min_gap}.")
    rows = torch.arange(len(episode)) if rows is None else rows
    other = episode != episode[rows].unsqueeze(1)
    return other | ((step - step[rows].unsqueeze(1)).abs() >= min_gap)


def most_similar(similarity: Tensor, candidates: Tensor) -> Tensor:
    """Number of the most similar view, int64 ``[Q]``; -1 where there is no candidate.

    Args:
        similarity: float32 ``[Q, V]``.
        candidates: bool ``[Q, V]``, see `pair_candidates`.

    Examples:
        >>> similarity = torch.tensor([[1.0, 0.2, 0.9], [0.2, 1.0, 0.8]])
        >>> most_similar(similarity, ~torch.eye(3, dtype=torch.bool)[:2])
        tensor([2, 2])
    """
    best = similarity.masked_fill(~candidates, -torch.inf).argmax(1)
    return torch.where(candidates.any(1), best, -1)


def place_error(distance: Tensor, *, limit: float = 256.0) -> float:
    """Share of views whose most similar other view shows another place.

    A network can tell near from far pairs well and still be useless for localisation,
    where the maximum over many views decides: in our trials 84 % accuracy came with an
    error of 26 %.

    Args:
        distance: walking distance from each view to its `most_similar` one in map
            units, ``[Q]``; NaN without one, which is left out.
        limit: map units; beyond it is another place. Two cells.

    Returns:
        In [0, 1]; NaN if there is no view.

    Examples:
        >>> place_error(torch.tensor([10.0, 256.0, 257.0, 999.0]))
        0.5
    """
    return _share(distance[~distance.isnan()] > limit)


def _similarity_map(
    similarity: Tensor, cells: Tensor, heading: Tensor
) -> tuple[Tensor, Tensor]:
    """Mean similarity and count, ``[headings, distances]``."""
    edges = torch.tensor(DISTANCE_CELLS)
    headings = torch.tensor(HEADINGS[1:-1])
    row = torch.bucketize(heading, headings, right=True)
    rows = [
        binned_mean(similarity[row == i], cells[row == i], edges)
        for i in range(len(HEADINGS) - 1)
    ]
    return torch.stack([r.mean for r in rows]), torch.stack([r.count for r in rows])


def _share(flags: Tensor) -> float:
    """Share of true values, NaN of none."""
    return float(flags.double().mean())
