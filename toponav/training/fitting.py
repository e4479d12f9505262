"""`fit`: trains a small network on what a map's views say."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

import torch
from torch import Tensor
from torch.optim import AdamW
from torch.optim.lr_scheduler import OneCycleLR
from tqdm import tqdm

from toponav.modules import ScaledMLP

_Network = TypeVar("_Network", bound=ScaledMLP)


@dataclass(frozen=True, kw_only=True)
class FitRules:
    """How a small network learns."""

    updates: int
    views: int  # in each update
    lr: float  # at its largest
    weight_decay: float
    seed: int = 0


def fit(
    make: Callable[[], _Network],
    loss: Callable[[_Network, Tensor, Tensor], Tensor],
    embeddings: Tensor,
    views: Tensor,
    rules: FitRules,
    *,
    name: str,
    progress: Callable[[float], object],
) -> _Network:
    """Make a network and train it on views that are drawn uniformly.

    Args:
        make: the network, whose weights are of the rules' seed.
        loss: of the network, embeddings ``[N, D]`` of the drawn views, and their
            numbers ``[N]``.
        embeddings: of all views, ``[V, D]``, of any precision.
        views: numbers of those that are drawn from, int64.
        rules: how it learns.
        name: of the progress bar.
        progress: called with the share of the updates that is done.

    Returns:
        The network, in ``eval()`` mode.
    """
    # The draws of the caller stay as they are.
    with torch.random.fork_rng(devices=[]), torch.enable_grad():
        torch.manual_seed(rules.seed)
        network = make()
        network.scale_by(embeddings[views].float())
        optimizer = AdamW(
            network.parameters(), lr=rules.lr, weight_decay=rules.weight_decay
        )
        schedule = OneCycleLR(optimizer, rules.lr, total_steps=rules.updates)
        updates = range(1, rules.updates + 1)
        for update in tqdm(updates, desc=name, unit="update", leave=False):
            drawn = views[torch.randint(len(views), (rules.views,))]
            found = loss(network, embeddings[drawn].float(), drawn)
            optimizer.zero_grad()
            found.backward()
            optimizer.step()
            schedule.step()
            progress(update / rules.updates)
    return network.eval()
