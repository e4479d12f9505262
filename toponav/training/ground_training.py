"""`train_ground`: a network that sees from a view where the ground is free."""

from collections.abc import Callable
from dataclasses import dataclass

from torch import Tensor
from torch.nn import functional as F  # noqa: N812

from toponav.graph.poses import BEARINGS, DISTANCES, WalkedGround
from toponav.modules import GroundNetwork
from toponav.training.fitting import FitRules, fit


@dataclass(frozen=True, kw_only=True)
class GroundRules(FitRules):
    """How a `GroundNetwork` learns."""

    updates: int = 1000
    views: int = 256
    lr: float = 2e-3
    weight_decay: float = 1e-3


def train_ground(
    embeddings: Tensor,
    poses: Tensor,
    rules: GroundRules,
    progress: Callable[[float], object] = lambda _: None,
) -> GroundNetwork:
    """Learn from V views where the ground before them is free.

    What an agent walked on in all of its episodes is the truth (`WalkedGround`): no
    depth, no plan. Poses are off by a step or so, each in another direction: the mean
    over views that look alike, which the network learns, is nearer to the walls than
    each of them. Views whose pose is not known, NaN, are left out.

    Reference:
        Beyond the paper. Free space learned from what was driven on: Hadsell et al.,
        "Learning long-range vision for autonomous off-road driving" (2009).

    Args:
        embeddings: of the views, ``[V, D]``, of any precision.
        poses: of the views, ``[V, 3]``: steps, steps and degrees.
        rules: how it learns.
        progress: called with the share of the updates that is done.
    """
    known = poses.isfinite().all(1).nonzero().flatten()
    if not len(known):
        raise ValueError("a view must have a known pose, got none")
    ground = WalkedGround(poses[known, :2].float())

    def loss(network: GroundNetwork, views: Tensor, drawn: Tensor) -> Tensor:
        wanted = ground.before(poses[drawn].float()).float()
        return F.binary_cross_entropy_with_logits(network(views), wanted)

    sizes = embeddings.shape[1], len(BEARINGS), len(DISTANCES)
    return fit(
        lambda: GroundNetwork(*sizes),
        loss,
        embeddings,
        known,
        rules,
        name="ground",
        progress=progress,
    )
