"""What a classifier of pairs gets that knows both true poses: the bound of perception.

The labels come from time, which poses do not determine, so even true poses err: what is
missing to 1 is label noise, and what a network lacks to this bound is perception.
"""

import torch
from sklearn.ensemble import HistGradientBoostingClassifier
from sklearn.metrics import balanced_accuracy_score
from torch import Tensor

from toponav.ground_truth import PairTruth


def pose_features(
    positions: tuple[Tensor, Tensor], headings: tuple[Tensor, Tensor], truth: PairTruth
) -> Tensor:
    """Both poses, the gap between them in the anchor's frame, and the distances.

    The arguments are those of `pair_truth`, and its result; float32 ``[P, 14]``.
    """
    anchor, other = positions
    facing, facing_other = (heading.reshape(-1).deg2rad() for heading in headings)
    gap = other - anchor
    east, north = facing.cos(), facing.sin()
    columns = [
        *anchor.unbind(1),
        *other.unbind(1),
        east,
        north,
        facing_other.cos(),
        facing_other.sin(),
        gap[:, 0] * east + gap[:, 1] * north,
        gap[:, 1] * east - gap[:, 0] * north,
        truth.distance,
        truth.straight,
        truth.heading_difference,
        truth.least_decisions,
    ]
    return torch.stack(columns, 1).float()


def pose_bound(
    train: tuple[Tensor, Tensor], test: tuple[Tensor, Tensor], *, seed: int = 0
) -> float:
    """Fit boosted trees to true poses and return their balanced accuracy.

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
