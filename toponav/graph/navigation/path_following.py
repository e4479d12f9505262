"""Paths by poses: what they cost, the point to aim at, and what leads there."""

from typing import NamedTuple

import torch
from torch import Tensor

from toponav.graph.poses import fastest_turn, moved

#: Means that are taken of the positions around each, one after the other.
_ROUNDS = 2
#: Decisions that an edge costs beside its steps, so that of equal paths the one with
#: fewer waypoints is walked; and, divided by how often it was traversed, for the doubt
#: whether it can be: an edge through a wall comes from a view taken for another place.
_EDGE_COST, _DOUBT = 0.3, 1.0


def walking_costs(positions: Tensor, edges: Tensor, traversals: Tensor) -> Tensor:
    """Decisions that each of E edges costs, float32 ``[E]``: its steps, and doubts.

    Args:
        positions: of the map's waypoints, ``[W, 2]``, in steps.
        edges: int64 ``[E, 2]``.
        traversals: how often agents went there and back, ``[E, 2]``.

    Examples:
        >>> positions, edges = torch.tensor([[0.0, 0], [3, 4]]), torch.tensor([[0, 1]])
        >>> walking_costs(positions, edges, torch.tensor([[1, 1]]))  # 5 + 0.3 + 1 / 2
        tensor([5.8000])
    """
    one, other = edges.unbind(1)
    steps: Tensor = (positions[one] - positions[other]).norm(dim=1)
    doubt: Tensor = _DOUBT / traversals.sum(1).clamp(min=1)
    return steps + _EDGE_COST + doubt


def edges_through(point: Tensor, within: float, starts: Tensor, ends: Tensor) -> Tensor:
    """Which of E edges pass a ``point`` ``[2]`` at most ``within`` steps away.

    They are straight, from ``starts`` to ``ends``, ``[E, 2]``. Returns bool ``[E]``.

    Examples:
        >>> starts, ends = torch.zeros(2, 2), torch.tensor([[9.0, 0.0], [0.0, 9.0]])
        >>> edges_through(torch.tensor([5.0, 1.0]), 2.0, starts, ends)
        tensor([ True, False])
    """
    along, gap = ends - starts, point - starts
    length = along.square().sum(1).clamp(min=1e-6)
    share = ((gap * along).sum(1) / length).clamp(0, 1).unsqueeze(1)
    away: Tensor = (gap - share * along).norm(dim=1)
    return away <= within


class Aim(NamedTuple):
    """What N agents aim at."""

    point: Tensor  # float32 [N, 2], in steps
    passed: Tensor  # int64 [N]; how many points of the path are nearer than that
    is_end: Tensor  # bool [N]; whether it is the path's last point


def aim_along(position: Tensor, path: Tensor, *, ahead: float) -> Aim:
    """The point of each path that is ``ahead`` steps away, as the crow flies.

    It lies on the first leg of the path ``[N, L, 2]`` that leaves the circle of that
    radius around ``position`` ``[N, 2]``; if none does, it is the path's end.

    Reference:
        Coulter, "Implementation of the pure pursuit path tracking algorithm" (1992).

    Examples:
        >>> path = torch.tensor([[[2.0, 0.0], [4.0, 0.0], [4.0, 4.0]]])
        >>> aim_along(torch.zeros(1, 2), path, ahead=3.0).point.tolist()
        [[3.0, 0.0]]
        >>> aim_along(torch.zeros(1, 2), path, ahead=9.0).point.tolist()
        [[4.0, 4.0]]
    """
    here = position.unsqueeze(1)
    points = torch.cat([here, path], 1)
    away = (points - here).norm(dim=2)
    passed = (away <= ahead).long().cumprod(1).sum(1) - 1
    row = torch.arange(len(passed))
    then = (passed + 1).clamp(max=path.shape[1])
    leg = (away[row, then] - away[row, passed]).clamp(min=1e-6)
    share = ((ahead - away[row, passed]) / leg).clamp(0, 1).unsqueeze(1)
    point = torch.lerp(points[row, passed], points[row, then], share)
    return Aim(point, passed, passed == path.shape[1])


def steer(pose: Tensor, aim: Tensor, effects: Tensor) -> Tensor:
    """Logits of the actions, ``[N, A]``: minus the decisions that are left after each.

    An action leads agents of ``pose`` ``[N, 3]`` where its ``effects`` ``[A, 3]`` in
    free space do; from there it takes the steps to ``aim`` ``[N, 2]``, and the turns
    until they look at it, which count less the nearer it is.

    Examples:
        >>> effects = torch.tensor([[1.0, 0, 0], [0, 0, 20], [0, 0, -20]])
        >>> behind_to_the_left = torch.tensor([[-3.0, 1.0]])
        >>> steer(torch.zeros(1, 3), behind_to_the_left, effects).argmax(1)
        tensor([1])
    """
    turn = fastest_turn(effects)
    then = moved(pose.unsqueeze(1), effects)
    gap = aim.unsqueeze(1) - then[..., :2]
    bearing = torch.atan2(gap[..., 1], gap[..., 0]).rad2deg()
    off = ((bearing - then[..., 2] + 180) % 360 - 180).abs()
    away = gap.norm(dim=2)
    # Within a step it matters less and less where the aim is seen.
    left: Tensor = away + away.clamp(max=1) * off / turn
    return -left


def to_the_middle(positions: Tensor, *, width: float) -> Tensor:
    """Positions ``[W, 2]``, drawn to where most others around them are.

    Where agents walked is bounded by walls: what lies beside one has others on the
    other side alone, and moves away from it. ``width`` is the deviation, in steps, of
    the bell curve by which others count.

    Reference:
        Mean shift: Fukunaga and Hostetler, "The estimation of the gradient of a density
        function" (1975).

    Examples:
        >>> corridor = torch.tensor([[0.0, -1.0], [0.0, 1.0]])
        >>> to_the_middle(corridor, width=9.0).abs().max().item() < 0.1
        True
    """
    middle = positions
    for _ in range(_ROUNDS):
        near: Tensor = (
            -0.5 * (torch.cdist(middle, positions) / width).square()
        ).softmax(1)
        middle = near @ positions
    return middle
