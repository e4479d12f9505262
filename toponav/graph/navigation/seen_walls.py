"""`SeenWalls`: where the view says that a path cannot be walked."""

import torch
from torch import Tensor

from toponav.graph.navigation.path_following import aim_along
from toponav.graph.poses import spots

#: Steps ahead on the path that are looked at, nearest first.
_LOOKED_AT = (2.0, 3.0, 4.0, 5.0)
#: Steps around such a point of which no spot may be free, and the least chance of one
#: that is. The view shows nothing more than so many degrees aside.
_AROUND, _FREE, _ASIDE = 1.2, 0.55, 75.0
#: Decisions of which sightings count together, and steps between their places.
_WINDOW, _TOGETHER = 10, 1.5
#: Decisions after such a sighting in which views are not trusted, and after which they
#: are for as long at least.
_BLIND, _SEES_AGAIN = 12, 12
#: Steps behind what is seen, where the middle of what is closed is.
_BEHIND = 1.0


class SeenWalls:
    """Counts in how many decisions N agents saw the same place of their paths closed.

    A point of the path is seen to be closed if none of the `spots` around it is likely
    free. Where that was seen in ``sightings`` of the last ten decisions, near the same
    place, the path is closed there.

    Reference:
        Beyond the paper, in which only a goal that is not reached tells of a blockage.

    Args:
        num_agents: N.
        sightings: so many decisions, 1 to 10.
    """

    def __init__(self, num_agents: int, *, sightings: int) -> None:
        if not 1 <= sightings <= _WINDOW:
            raise ValueError(f"sightings must be 1 to {_WINDOW}, got {sightings}")
        self.sightings = sightings
        self._seen = torch.full((num_agents, _WINDOW, 2), torch.nan)
        # Decisions for which views are not trusted; below 0, since when they are.
        self._blind = torch.full((num_agents,), -_SEES_AGAIN)

    @property
    def trusts(self) -> Tensor:
        """Whose views say where they are, bool ``[N]``.

        Before what is closed an agent has never been: its views there are like those of
        other places. For a while it goes by its actions alone.
        """
        return self._blind <= 0

    def forget(self, agents: Tensor) -> None:
        """The agents of a mask, bool ``[N]``, are elsewhere, or have other paths."""
        self._seen[agents] = torch.nan
        self._blind[agents] = -_SEES_AGAIN

    def look(self, pose: Tensor, path: Tensor, chance: Tensor) -> Tensor:
        """Where each path is closed, float32 ``[N, 2]``, NaN where it is not.

        Args:
            pose: of the agents, ``[N, 3]``: steps, steps and degrees.
            path: the points of each path, ``[N, L, 2]``.
            chance: that each of the `spots` before an agent is free, ``[N, K, R]``.
        """
        seen = closed_ahead(pose, path, chance)
        self._seen = torch.cat([self._seen[:, 1:], seen.unsqueeze(1)], 1)
        away = (self._seen - seen.unsqueeze(1)).norm(dim=2)
        often = (away < _TOGETHER).sum(1) >= self.sightings
        self._blind -= 1
        fresh = self._blind <= -_SEES_AGAIN
        begins = seen.isfinite().all(1) & (fresh | (self._blind >= 0))
        self._blind = torch.where(begins, self._blind.clamp(min=_BLIND), self._blind)
        self._seen[often] = torch.nan
        return seen.masked_fill(~often.unsqueeze(1), torch.nan)


def closed_ahead(pose: Tensor, path: Tensor, chance: Tensor) -> Tensor:
    """The nearest point of each path that is seen to be closed, ``[N, 2]``, or NaN.

    It lies a step behind what is seen. Arguments as in `SeenWalls.look`.

    Examples:
        >>> east, path = torch.zeros(1, 3), torch.tensor([[[3.0, 0], [9.0, 0]]])
        >>> chance = torch.ones(1, 13, 12)
        >>> closed_ahead(east, path, chance)
        tensor([[nan, nan]])
        >>> chance[:, :, 5:] = 0.0  # a wall from three steps on
        >>> closed_ahead(east, path, chance)
        tensor([[5., 0.]])
    """
    position = pose[:, :2]
    aims = [aim_along(position, path, ahead=ahead) for ahead in _LOOKED_AT]
    points = torch.stack([aim.point for aim in aims], 1)
    near = torch.cdist(points, spots(pose).flatten(1, 2)) < _AROUND
    free = (near & (chance.flatten(1) > _FREE).unsqueeze(1)).any(2)
    gap = points - position.unsqueeze(1)
    bearing = torch.atan2(gap[..., 1], gap[..., 0]).rad2deg()
    aside = ((bearing - pose[:, 2:] + 180) % 360 - 180).abs()
    # Where the path ends before, its last point has been looked at already.
    away = gap.norm(dim=2)
    reaches = away > torch.tensor(_LOOKED_AT) - 0.5
    closed = ~free & near.any(2) & (aside < _ASIDE) & reaches
    first = closed.int().argmax(1)
    row = torch.arange(len(pose))
    behind = gap[row, first] * (1 + _BEHIND / away[row, first].clamp(min=0.1))[:, None]
    found = position + behind
    return found.masked_fill(~closed.any(1, keepdim=True), torch.nan)
