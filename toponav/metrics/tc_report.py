"""The temporal correlation (TC) against the truth, of pairs, places and poses."""

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import ArrayLike
from scipy.stats import binned_statistic
from sklearn.ensemble import HistGradientBoostingClassifier
from sklearn.metrics import balanced_accuracy_score, roc_auc_score, roc_curve
from torch import Tensor

from toponav.ground_truth import PairTruth

#: Edges of the bins of distance, in cells.
DISTANCE_CELLS = (0.0, 0.25, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0, 8.0, 12.0, 16.0)
#: Edges of the bins of heading difference, in degrees.
HEADINGS = (0.0, 30.0, 60.0, 90.0, 120.0, 150.0, 180.0)
_PROBABILITIES = np.linspace(0, 1, 11)


@dataclass(frozen=True)
class Binned:
    """A mean per bin of another quantity, NaN in an empty one."""

    edges: Tensor
    mean: Tensor
    count: Tensor

    @property
    def centres(self) -> Tensor:
        """The middle of each bin, ``[K]`` of K bins."""
        return (self.edges[1:] + self.edges[:-1]) / 2


def binned_mean(value: Tensor, by: Tensor, edges: ArrayLike) -> Binned:
    """Mean of ``value`` ``[P]`` in bins of ``by`` ``[P]``.

    What lies outside the ascending edges is left out; a bin holds its lower edge, the
    last one both.
    """
    values = value.double().numpy()
    mean, bins, _ = binned_statistic(by.double().numpy(), values, "mean", edges)
    count, _ = np.histogram(by.double(), bins)
    return Binned(*map(torch.from_numpy, (bins, mean, count)))


@dataclass(frozen=True)
class TCReport:
    """What a temporal correlation is worth, on P held-out pairs.

    The first block are single numbers, the second curves; shares are in [0, 1]. "Near"
    means a similarity above 0.5, the decision that training asks for.
    ``calibration_error`` is the expected one of "within k decisions" (Guo et al. 2017,
    eq. 3, https://arxiv.org/abs/1706.04599), for the given mixture of labels.
    """

    num_pairs: int
    accuracy: float  # balanced
    positive_accuracy: float  # share of positives called near
    negative_accuracy: float  # share of negatives not called near
    auc: float  # area under the ROC curve
    calibration_error: float
    #: Label noise: negatives at most k ``decisions`` of `PairTruth` apart.
    negatives_near: float
    #: Positives that even the least count puts beyond k decisions: zero, up to
    #: rounding, or the pairs are wrong.
    positives_far: float
    #: Of the pairs near in the plan and far on foot, those called near; NaN if none.
    through_wall_rate: float
    num_through_wall: int

    by_distance: Binned  # accuracy over walking distance in cells
    positives_by_distance: Binned  # share called near
    negatives_by_distance: Binned  # share called near
    roc: tuple[Tensor, Tensor]  # false and true positive rates, at every threshold
    calibration: tuple[Binned, Binned]  # mean similarity and positives, by similarity
    #: Mean over distance in cells (columns) and heading difference (rows), or NaN.
    similarity: Tensor
    similarity_count: Tensor  # pairs behind each entry

    def numbers(self) -> dict[str, float]:
        """The single numbers by name."""
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
    cell_size: float,
    max_action_distance: int = 4,
) -> TCReport:
    """Measure a temporal correlation on held-out pairs.

    ``similarity`` are probabilities ``[P]``, float32. A ``label`` ``[P]`` is 1 for at
    most k decisions apart in the episode, 0 for at least M k; k is
    ``max_action_distance``, and ``cell_size`` is in map units.
    """
    if not len(similarity) == len(label) == len(truth.distance):
        got = f"{len(similarity)}, {len(label)} and {len(truth.distance)}"
        raise ValueError(f"similarity, label, truth must be of one length, got {got}.")
    if not ((similarity >= 0) & (similarity <= 1)).all():
        raise ValueError("similarity must lie in [0, 1].")
    positive, near = label > 0.5, similarity > 0.5
    if positive.all() or not positive.any():
        got = f"{int(positive.sum())} positives among {len(positive)} pairs"
        raise ValueError(f"both classes must occur, got {got}.")
    cells = truth.distance / cell_size

    def called_near(of: Tensor) -> Binned:
        return binned_mean(near[of], cells[of], DISTANCE_CELLS)

    said = binned_mean(similarity, similarity, _PROBABILITIES)
    true = binned_mean(positive, similarity, _PROBABILITIES)
    judged = positive.numpy(), similarity.numpy()
    false_rate, true_rate, _ = roc_curve(*judged, drop_intermediate=False)
    bins = (HEADINGS, DISTANCE_CELLS)
    plane = (truth.heading_difference.double(), cells.double(), bins)
    total, *_ = np.histogram2d(*plane, weights=similarity.double())
    count, *_ = np.histogram2d(*plane)
    counts = torch.from_numpy(count)
    limit = max_action_distance
    gap = ((said.mean - true.mean).abs() * said.count).nansum()
    return TCReport(
        num_pairs=len(label),
        accuracy=float(balanced_accuracy_score(positive.numpy(), near.numpy())),
        positive_accuracy=_share(near[positive]),
        negative_accuracy=_share(~near[~positive]),
        auc=float(roc_auc_score(*judged)),
        calibration_error=float(gap / len(label)),
        negatives_near=_share(truth.decisions[~positive] <= limit),
        # A step varies by a percent.
        positives_far=_share(truth.least_decisions[positive] > 1.02 * limit),
        through_wall_rate=_share(near[truth.through_wall]),
        num_through_wall=int(truth.through_wall.sum()),
        by_distance=binned_mean(near == positive, cells, DISTANCE_CELLS),
        positives_by_distance=called_near(positive),
        negatives_by_distance=called_near(~positive),
        roc=(torch.from_numpy(false_rate), torch.from_numpy(true_rate)),
        calibration=(said, true),
        similarity=torch.from_numpy(total) / counts,
        similarity_count=counts,
    )


def _share(flags: Tensor) -> float:
    return float(flags.double().mean())


def most_similar(
    similarity: Tensor, episode: Tensor, step: Tensor, *, rows: Tensor, min_gap: int
) -> Tensor:
    """The view of another visit that is most like each of Q, int64 ``[Q]``, or -1.

    The views ``rows`` ``[Q]`` look among all V, by their ``similarity`` ``[Q, V]``. Two
    views are of one visit if they are of one ``episode`` ``[V]`` and less than
    ``min_gap`` decisions apart, by the ``step`` ``[V]`` within it.
    """
    gap = (step - step[rows].unsqueeze(1)).abs()
    candidates = (episode != episode[rows].unsqueeze(1)) | (gap >= min_gap)
    best = similarity.masked_fill(~candidates, -torch.inf).argmax(1)
    return torch.where(candidates.any(1), best, -1)


def pose_features(
    positions: tuple[Tensor, Tensor], headings: tuple[Tensor, Tensor], truth: PairTruth
) -> Tensor:
    """Both poses, the gap between them in the anchor's frame, and the distances.

    The arguments are those of `pair_truth`, and its result; float32 ``[P, 14]``.
    """
    angles = (heading.reshape(-1).deg2rad() for heading in headings)
    facing, facing_other = (torch.stack([a.cos(), a.sin()], 1) for a in angles)
    (east, north), (x, y) = facing.unbind(1), (positions[1] - positions[0]).unbind(1)
    columns = [
        x * east + y * north,
        y * east - x * north,
        truth.distance,
        truth.straight,
        truth.heading_difference,
        truth.least_decisions,
    ]
    both = torch.cat([*positions, facing, facing_other], 1)
    return torch.cat([both, torch.stack(columns, 1)], 1).float()


def pose_bound(
    train: tuple[Tensor, Tensor], test: tuple[Tensor, Tensor], *, seed: int = 0
) -> float:
    """Balanced accuracy of boosted trees that know both true poses of a pair.

    The labels come from time, which poses do not determine: what is missing to 1 is
    label noise, and what a network lacks to this bound is perception.

    Both sets are features ``[P, F]`` and labels ``[P]``, 0 or 1; ``test`` has the
    report's pairs, ``train`` 10,000 or more others.
    """
    if not len(train[0]) or not len(test[0]):
        got = f"{len(train[0])} to train and {len(test[0])} to test"
        raise ValueError(f"pairs must not be empty, got {got}.")
    trees = HistGradientBoostingClassifier(random_state=seed)
    trees.fit(train[0].numpy(), train[1].numpy() > 0.5)
    found = trees.predict(test[0].numpy())
    return float(balanced_accuracy_score(test[1].numpy() > 0.5, found))
