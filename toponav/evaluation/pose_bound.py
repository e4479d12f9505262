"""What a classifier of pairs gets that knows both true poses: the bound of perception.

The labels come from time, the poses do not tell it, so even the truth errs: what is
missing to 1 is label noise, and what a network lacks to this bound is perception.
"""

import torch
from torch import Tensor, nn

from toponav.evaluation.classification import balanced_accuracy
from toponav.evaluation.pair_truth import PairTruth

#: Map units that become about 1 for the network.
_SCALE = 100.0


# Mean loss at which nothing is left to learn.
_BY_HEART = 1e-3


def pose_features(
    positions: tuple[Tensor, Tensor], headings: tuple[Tensor, Tensor], truth: PairTruth
) -> Tensor:
    """Describe pairs of poses to a classifier.

    Both poses, the way between them in the anchor's frame, and the distances: on the
    straight line and on foot, on a linear and a logarithmic scale.

    Args:
        positions: of the anchors and the others, map units, ``[P, 2]`` each.
        headings: of both, degrees, ``[P]`` or ``[P, 1]`` each.
        truth: of the same pairs.

    Returns:
        float32 ``[P, 15]``.
    """
    anchor, other = (position / _SCALE for position in positions)
    facing, facing_other = (heading.reshape(-1).deg2rad() for heading in headings)
    gap = other - anchor
    ahead = gap[:, 0] * facing.cos() + gap[:, 1] * facing.sin()
    aside = gap[:, 1] * facing.cos() - gap[:, 0] * facing.sin()
    walk = truth.distance.clamp(max=1e4) / _SCALE
    columns = [
        *anchor.unbind(1),
        *other.unbind(1),
        facing.cos(),
        facing.sin(),
        facing_other.cos(),
        facing_other.sin(),
        ahead,
        aside,
        walk,
        walk.log1p(),
        truth.straight / _SCALE,
        truth.heading_difference / 90,
        truth.least_decisions.clamp(max=40) / 10,
    ]
    return torch.stack(columns, 1).float()


def pose_bound(
    train: tuple[Tensor, Tensor],
    test: tuple[Tensor, Tensor],
    *,
    steps: int = 1500,
    seed: int = 0,
) -> float:
    """Train a small classifier on true poses and return its balanced accuracy.

    Three layers of 64, AdamW with a falling rate, batches of 1024: some seconds on
    one core. The global random state is left as it was.

    Args:
        train: features ``[P, F]`` from `pose_features` and labels ``[P]``, 0 or 1, of
            pairs that the report does not use, 10,000 or more.
        test: the same of the report's pairs.
        steps: of training.
        seed: of the weights and batches.

    Returns:
        Balanced accuracy on ``test``, in [0, 1].

    Raises:
        ValueError: if there is nothing to train or test on.
    """
    features, label = train
    if not len(features) or not len(test[0]):
        raise ValueError(
            f"pairs must not be empty, got {len(features)} to train and "
            f"{len(test[0])} to test."
        )
    mean, spread = features.mean(0), features.std(0).clamp(min=1e-6)
    features = (features - mean) / spread
    with torch.enable_grad(), torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        network = nn.Sequential(
            nn.Linear(features.shape[1], 64),
            nn.ReLU(),
            nn.Linear(64, 64),
            nn.ReLU(),
            nn.Linear(64, 1),
        )
        optimizer = torch.optim.AdamW(network.parameters(), lr=3e-3)
        schedule = torch.optim.lr_scheduler.CosineAnnealingLR(optimizer, steps)
        for _ in range(steps):
            rows = torch.randint(len(features), (1024,))
            loss = nn.functional.binary_cross_entropy_with_logits(
                network(features[rows]).squeeze(1), label[rows].float()
            )
            # A few pairs are learned by heart; what follows would be steps on
            # denormal numbers, a hundred times as slow.
            if loss < _BY_HEART:
                break
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()
    with torch.no_grad():
        logit = network((test[0] - mean) / spread).squeeze(1)
    return balanced_accuracy(logit > 0, test[1])
