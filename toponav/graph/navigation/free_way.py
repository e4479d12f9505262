"""`aim_where_free`: on the way to an aim, around what the view says is not free."""

import torch
from torch import Tensor

from toponav.graph.poses import DISTANCES, spots

#: Steps of the nearest spot that is aimed at, and the fewest that it must be worth.
_LEAST, _WORTH = 1.5, 0.3


def aim_where_free(pose: Tensor, aim: Tensor, chance: Tensor) -> Tensor:
    """The spot before each of N agents that most likely leads nearest to its ``aim``.

    A spot is worth the steps that it is nearer to the aim than the agent, times the
    chance that all spots on the straight way there are free. Near the aim, and where no
    spot is worth much, the aim stays.

    Reference:
        Beyond the paper. Directions judged by the free space in them: Borenstein and
        Koren, "The vector field histogram" (1991).

    Args:
        pose: float32 ``[N, 3]``: steps, steps and degrees.
        aim: ``[N, 2]``, in steps.
        chance: that each of the `spots` before an agent is free, ``[N, K, R]``.

    Examples:
        >>> east, aim = torch.tensor([[0.0, 0, 0]]), torch.tensor([[4.0, 0]])
        >>> chance = torch.ones(1, 13, 12)
        >>> aim_where_free(east, aim, chance)
        tensor([[4., 0.]])
        >>> chance[:, 5:8, 3:] = 0.0  # a wall two steps ahead, three bearings wide
        >>> aim_where_free(east, aim, chance)
        tensor([[ 3.0311, -1.7500]])
    """
    way = chance.cumprod(2)
    before = spots(pose)
    gap = aim - pose[:, :2]
    away = gap.norm(dim=1)
    left = (before - aim[:, None, None]).norm(dim=3)
    worth = way * (away[:, None, None] - left)
    worth = worth.masked_fill(DISTANCES < _LEAST, -torch.inf).flatten(1)
    most, spot = worth.max(1)
    found = before.flatten(1, 2)[torch.arange(len(spot)), spot]
    turns = (most > _WORTH) & (away > _LEAST)
    return torch.where(turns.unsqueeze(1), found, aim)
