"""The oracle: walks shortest paths, an upper bound."""

import torch

from toponav.builders import GroundTruth
from toponav.config import NavigatorConfig
from toponav.methods.navigators.method import NavigatorMethod
from toponav.policies import PathFollower
from toponav.worlds import WorldSpec


def make_oracle(
    config: NavigatorConfig, *, world: WorldSpec, truth: GroundTruth, seed: int
) -> PathFollower:
    """Knows the plan, where it is, where the goal is, and what is closed."""
    return PathFollower(
        torch.as_tensor(truth.layout.open_mask),
        slot_cells=list(truth.layout.slots.values()),
        world=world,
        seed=seed,
    )


ORACLE = NavigatorMethod(
    schema=NavigatorConfig, needs=("world", "truth"), make=make_oracle
)
