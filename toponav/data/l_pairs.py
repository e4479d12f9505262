"""`LPairs`: two views of an episode and the action between, for the L-network."""

from dataclasses import dataclass

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from toponav.data.episodes import Episodes
from toponav.data.pairs import (
    compare_steps,
    distance_weights,
    draw_near,
    gather_pairs,
)
from toponav.keys import ACTION, WEIGHT


@dataclass(frozen=True)
class LPairs:
    """The rule of the L-network's pairs ``(o_i, o_(i+j), a_i)``, and how to get them.

    The distance j is uniform in 1..k, no pair spans two episodes, and the earlier view
    always comes first: the action is the first one on the path.

    Reference:
        The paper, "Navigation implementation", eq. 14; the uniform distance from
        Savinov et al., "Semi-parametric Topological Memory" (2018).
        https://arxiv.org/abs/1803.00653

    Args:
        max_action_distance: k, the largest distance in decisions.

    Examples:
        >>> place, _ = LPairs(4).draw(Episodes.from_lengths([9, 9]), 8, None)
        >>> distance = place[:, 1] - place[:, 0]
        >>> bool(((distance >= 1) & (distance <= 4)).all())
        True
    """

    max_action_distance: int = 4

    def __post_init__(self) -> None:
        k = self.max_action_distance
        if k < 1:
            raise ValueError(f"max_action_distance must be at least 1, got {k}")

    def draw(
        self, episodes: Episodes, batch_size: int, generator: torch.Generator | None
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """Draw pairs: places ``[P, 2]`` of anchor and other, in this order."""
        k = self.max_action_distance
        episodes.require(k + 1, "more than max_action_distance")
        return draw_near(episodes, batch_size, k, generator), {}

    def mine(self, frames: TensorDictBase) -> TensorDict:
        """All pairs of embeddings of a batch of `Chunks`, as `TCPairs.mine`.

        ``action`` replaces ``label``; weights make every distance count the same.
        """
        same, gap = compare_steps(frames)
        near = same & (gap >= 1) & (gap <= self.max_action_distance)
        pair = near.nonzero()
        weight = distance_weights(gap[near], self.max_action_distance)
        action = frames.get(ACTION).flatten()
        entries = {ACTION: action[pair[:, 0].to(action.device)], WEIGHT: weight}
        return gather_pairs(frames, pair, entries)
