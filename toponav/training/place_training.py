"""Networks that know the waypoints of one map by their views."""

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn import functional as F  # noqa: N812

from toponav.graph.poses import decisions_apart
from toponav.modules import OffsetNetwork, PlaceNetwork
from toponav.training.fitting import FitRules, fit

#: Of the poses of a view and of waypoints that are compared in one call.
_CHUNK = 4096
#: A view without a waypoint at least so near teaches nothing: exp(-x^2 / 2).
_NEAR = 1e-2
#: Error, in units of the offsets, from which it counts by its size, not by its square.
_LARGE = 0.3


@dataclass(frozen=True, kw_only=True)
class PlaceRules(FitRules):
    """How a `PlaceNetwork` learns."""

    updates: int = 1500
    views: int = 512
    lr: float = 4e-3
    weight_decay: float = 3e-2
    #: Standard deviation, in decisions, of the distance from a view to its waypoints.
    spread: float = 1.5


@dataclass(frozen=True, kw_only=True)
class OffsetRules(PlaceRules):
    """How an `OffsetNetwork` learns: twice as many views bring no more."""

    updates: int = 1000
    views: int = 256


def train_places(
    embeddings: Tensor,
    poses: Tensor,
    waypoints: Tensor,
    turn: float,
    rules: PlaceRules,
    progress: Callable[[float], object] = lambda _: None,
) -> PlaceNetwork:
    """Learn which of a map's waypoints each of V views is close to.

    A view belongs to all waypoints around it, by a bell curve over the decisions to
    them in free space. Views whose pose is not known, NaN, are left out.

    Reference:
        Beyond the paper. Places as classes: Weyand, Kostrikov and Philbin, "PlaNet"
        (2016), https://arxiv.org/abs/1602.05314

    Args:
        embeddings: of the views, ``[V, D]``, of any precision.
        poses: of the views, ``[V, 3]``: steps, steps and degrees.
        waypoints: poses of the waypoints, ``[W, 3]``.
        turn: degrees that the fastest action turns.
        rules: how it learns.
        progress: called with the share of the updates that is done.

    Raises:
        ValueError: if no view has a known pose near a waypoint.
    """

    def loss(network: PlaceNetwork, views: Tensor, drawn: Tensor) -> Tensor:
        wanted = _shares(poses[drawn], waypoints, turn, rules)
        return F.cross_entropy(network(views), wanted)

    known = _near_views(poses, waypoints, turn, rules)
    sizes = len(waypoints), embeddings.shape[1]
    return fit(
        lambda: PlaceNetwork(*sizes),
        loss,
        embeddings,
        known,
        rules,
        name="places",
        progress=progress,
    )


def train_offsets(
    embeddings: Tensor,
    poses: Tensor,
    waypoints: Tensor,
    turn: float,
    rules: OffsetRules,
    progress: Callable[[float], object] = lambda _: None,
) -> OffsetNetwork:
    """Learn how far from the waypoints around it each of V views was taken.

    Waypoints count as `train_places` lets a view belong to them. Poses of views are off
    by a step or so, each in another direction: the mean over views that look alike,
    which the network learns, is nearer to where they were taken. Arguments, errors and
    views that are left out are those of `train_places`.

    Reference:
        Beyond the paper. Classes with offsets beside them: Mousavian et al., "3D
        bounding box estimation using deep learning and geometry" (2017),
        https://arxiv.org/abs/1612.00496
    """
    units = poses.new_tensor(OffsetNetwork.UNITS).float()

    def loss(network: OffsetNetwork, views: Tensor, drawn: Tensor) -> Tensor:
        wanted = poses[drawn].float().unsqueeze(1) - waypoints
        wanted[..., 2] = (wanted[..., 2] + 180) % 360 - 180
        error = F.smooth_l1_loss(
            network(views) / units, wanted / units, reduction="none", beta=_LARGE
        )
        shares = _shares(poses[drawn], waypoints, turn, rules)
        return (error.sum(2) * shares).sum(1).mean()

    known = _near_views(poses, waypoints, turn, rules)
    sizes = len(waypoints), embeddings.shape[1]
    return fit(
        lambda: OffsetNetwork(*sizes),
        loss,
        embeddings,
        known,
        rules,
        name="offsets",
        progress=progress,
    )


def _shares(poses: Tensor, waypoints: Tensor, turn: float, rules: PlaceRules) -> Tensor:
    """How far each view belongs to each waypoint, ``[N, W]``."""
    apart = decisions_apart(poses.unsqueeze(1), waypoints, turn)
    return (-0.5 * (apart / rules.spread).square()).softmax(1)


def _near_views(
    poses: Tensor, waypoints: Tensor, turn: float, rules: PlaceRules
) -> Tensor:
    near = [
        decisions_apart(some.unsqueeze(1), waypoints, turn).amin(1)
        for some in poses.split(_CHUNK)
    ]
    shares = (-0.5 * (torch.cat(near) / rules.spread).square()).exp()
    known = (shares > _NEAR).nonzero().flatten()  # NaN is not
    if not len(known):
        raise ValueError("a view must have a known pose near a waypoint, got none")
    return known
