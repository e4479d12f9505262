"""`train_places`: a network that knows the waypoints of one map by their views."""

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional as F  # noqa: N812
from torch.optim import AdamW
from torch.optim.lr_scheduler import OneCycleLR
from tqdm import tqdm

from toponav.graph.poses import decisions_apart
from toponav.modules import PlaceNetwork

#: Of the poses of a view and of waypoints that are compared in one call.
_CHUNK = 4096
#: A view without a waypoint at least so near teaches nothing: exp(-x^2 / 2).
_NEAR = 1e-2


@dataclass(frozen=True, kw_only=True)
class PlaceRules:
    """How a `PlaceNetwork` learns."""

    updates: int = 1500
    views: int = 512  # in each update
    lr: float = 4e-3  # at its largest
    weight_decay: float = 3e-2
    #: Standard deviation, in decisions, of the distance from a view to its waypoints.
    spread: float = 1.5
    seed: int = 0


def train_places(
    embeddings: Tensor,
    poses: Tensor,
    waypoints: Tensor,
    turn: float,
    rules: PlaceRules,
) -> PlaceNetwork:
    """Learn which of a map's waypoints each of V views is close to.

    A view belongs to all waypoints around it, by a bell curve over the decisions to
    them in free space, so that what the network says of a view has its pose as the mean
    of theirs. Views whose pose is not known, NaN, are left out.

    Reference:
        Beyond the paper. Places as classes: Weyand, Kostrikov and Philbin, "PlaNet"
        (2016), https://arxiv.org/abs/1602.05314

    Args:
        embeddings: of the views, ``[V, D]``, of any precision.
        poses: of the views, ``[V, 3]``: steps, steps and degrees.
        waypoints: poses of the waypoints, ``[W, 3]``.
        turn: degrees that the fastest action turns.
        rules: how it learns.
    """
    near = [
        decisions_apart(some.unsqueeze(1), waypoints, turn).amin(1)
        for some in poses.split(_CHUNK)
    ]
    shares = (-0.5 * (torch.cat(near) / rules.spread).square()).exp()
    known = (shares > _NEAR).nonzero().flatten()  # NaN is not
    if not len(known):
        raise ValueError("a view must have a known pose near a waypoint, got none")
    # The draws of the caller stay as they are.
    with torch.random.fork_rng(devices=[]), torch.enable_grad():
        torch.manual_seed(rules.seed)
        network = PlaceNetwork(len(waypoints), embeddings.shape[1])
        network.scale_by(embeddings[known].float())
        optimizer = AdamW(
            network.parameters(), lr=rules.lr, weight_decay=rules.weight_decay
        )
        schedule = OneCycleLR(optimizer, rules.lr, total_steps=rules.updates)
        for _ in tqdm(range(rules.updates), desc="places", unit="update", leave=False):
            drawn = known[torch.randint(len(known), (rules.views,))]
            apart = decisions_apart(poses[drawn].unsqueeze(1), waypoints, turn)
            wanted = (-0.5 * (apart / rules.spread).square()).softmax(1)
            loss = F.cross_entropy(network(embeddings[drawn].float()), wanted)
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()
    return network.eval()
