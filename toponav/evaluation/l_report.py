"""The locomotion network (L) against the truth, and what could be had at best.

- `useful_actions`: which actions bring a walker closer to a target pose.
- `l_report`: accuracy and share of useful actions by offset, an `LReport`.
- `bayes_bound`: how often the first of j random actions can be told at all.
"""

from dataclasses import dataclass

import torch
from torch import Tensor

from toponav.evaluation.steering import Motion, wrap_degrees

#: Steps forward and turns to the left of each action, in `Action`'s order.
_WALK = (1.0, -1.0, 0.0, 0.0, 1.0, 1.0)
_TURN = (0.0, 0.0, 1.0, -1.0, 1.0, -1.0)
#: A decision is four tics, and each tic turns before it walks: the four steps point
#: 5, 10, 15 and 20 degrees aside, on average 12.5 of the 20.
_ARC = 0.625
#: Map units within which two ways end at the same pose, up to rounding.
_SAME_POSE = 1e-3


def move(
    position: Tensor, heading: Tensor, *, motion: Motion | None = None
) -> tuple[Tensor, Tensor]:
    """Poses after each of the six actions, in free space.

    While it walks and turns, a walker moves along an arc, whose chord points five
    eighths of the turn aside: it turns first in each of the four tics.

    Args:
        position: map units, ``[*B, 2]``.
        heading: degrees, ``[*B]``.
        motion: what one decision does; ViZDoom's by default.

    Returns:
        Positions ``[*B, 6, 2]`` and headings ``[*B, 6]``.
    """
    motion = Motion() if motion is None else motion
    walk = motion.step * torch.tensor(_WALK, dtype=position.dtype)
    turn = motion.turn * torch.tensor(_TURN, dtype=position.dtype)
    along = (heading.unsqueeze(-1) + _ARC * turn).deg2rad()
    offset = torch.stack([along.cos(), along.sin()], -1) * walk.unsqueeze(-1)
    return position.unsqueeze(-2) + offset, heading.unsqueeze(-1) + turn


def useful_actions(
    positions: tuple[Tensor, Tensor],
    headings: tuple[Tensor, Tensor],
    *,
    motion: Motion | None = None,
) -> Tensor:
    """Which actions reduce |dp| / 33.1 + |dh| / 20 to the target's pose.

    The distance is straight and the motion free of walls: pairs of the L-network are
    a few decisions apart and see each other.

    Args:
        positions: of the views and of the targets, map units, ``[P, 2]`` each.
        headings: of both, degrees, ``[P]`` or ``[P, 1]`` each.
        motion: what one decision does.

    Returns:
        bool ``[P, 6]``, see `Action`.

    Examples:
        >>> ahead = (torch.tensor([[0.0, 0.0]]), torch.tensor([[90.0, 0.0]]))
        >>> useful_actions(ahead, (torch.zeros(1), torch.zeros(1))).int()
        tensor([[1, 0, 0, 0, 0, 0]], dtype=torch.int32)
    """
    motion = Motion() if motion is None else motion
    here, target = positions
    heading, wanted = (angle.reshape(-1) for angle in headings)
    before = _cost(target - here, wanted - heading, motion)
    after_at, after_heading = move(here, heading, motion=motion)
    after = _cost(
        target.unsqueeze(1) - after_at, wanted.unsqueeze(1) - after_heading, motion
    )
    # An action must gain a thousandth of a decision, more than rounding does.
    return after < before.unsqueeze(1) - 1e-3


def _cost(gap: Tensor, turn: Tensor, motion: Motion) -> Tensor:
    steps: Tensor = gap.norm(dim=-1) / motion.step
    return steps + wrap_degrees(turn).abs() / motion.turn


@dataclass(frozen=True)
class LReport:
    """What a locomotion network is worth, by offset 1..k; every tensor is ``[k]``.

    Args:
        count: pairs.
        accuracy: share whose most probable action is the one taken.
        useful_argmax: share whose most probable action is useful.
        useful_sampled: the same of an action sampled from the network (exact mean).
        useful_taken: the same of the action taken.
        useful_uniform: the same of a uniform action.
    """

    count: Tensor
    accuracy: Tensor
    useful_argmax: Tensor
    useful_sampled: Tensor
    useful_taken: Tensor
    useful_uniform: Tensor

    def numbers(self) -> dict[str, float]:
        """All values by name and offset, for loggers and tables."""
        return {
            f"{name}_{offset}": float(value)
            for name, values in vars(self).items()
            for offset, value in enumerate(values, start=1)
        }


def l_report(
    logits: Tensor,
    action: Tensor,
    offset: Tensor,
    useful: Tensor,
    *,
    max_action_distance: int = 4,
) -> LReport:
    """Measure a locomotion network on held-out pairs ``(o_i, o_(i+j), a_i)``.

    Args:
        logits: ``[P, 6]``.
        action: the action taken, int64 ``[P]``.
        offset: j, in 1..k, int64 ``[P]``.
        useful: bool ``[P, 6]``, see `useful_actions`.
        max_action_distance: k.

    Returns:
        All measures; NaN at offsets without pairs.

    Raises:
        ValueError: if an offset is out of range or a logit is NaN.

    Examples:
        >>> useful = torch.tensor([[True, False, False, False, True, False]])
        >>> report = l_report(
        ...     torch.zeros(1, 6), torch.tensor([4]), torch.tensor([1]), useful
        ... )
        >>> report.useful_taken[0].item(), round(report.useful_sampled[0].item(), 3)
        (1.0, 0.333)
    """
    if ((offset < 1) | (offset > max_action_distance)).any():
        raise ValueError(
            f"offset must lie in 1..{max_action_distance}, got {offset.min()} to "
            f"{offset.max()}."
        )
    if logits.isnan().any():
        raise ValueError("logits must be numbers, got NaN.")
    at = offset - 1
    count = torch.bincount(at, minlength=max_action_distance)

    def by_offset(value: Tensor) -> Tensor:
        total = torch.bincount(
            at, weights=value.double(), minlength=max_action_distance
        )
        return total / count

    best = logits.argmax(1, keepdim=True)
    chance = logits.double().softmax(1)
    return LReport(
        count=count,
        accuracy=by_offset(best.squeeze(1) == action),
        useful_argmax=by_offset(useful.gather(1, best).squeeze(1)),
        useful_sampled=by_offset((chance * useful).sum(1)),
        useful_taken=by_offset(useful.gather(1, action.unsqueeze(1)).squeeze(1)),
        useful_uniform=by_offset(useful.double().mean(1)),
    )


def bayes_bound(
    max_action_distance: int = 4,
    *,
    resolution: float = 4.0,
    motion: Motion | None = None,
) -> Tensor:
    """How often the first of j random actions can be told from both poses, at best.

    All 6^j sequences of uniform actions in free space are walked, those that end at the
    same pose as one. They cannot be told apart, and the best guess is their most
    frequent first action. For k = 1..4 that leaves about 1, .92, .79 and .71: the
    paper's 91 to 95 % cannot be the first of up to four random actions.

    Args:
        max_action_distance: k.
        resolution: map units to which the final position is known; the heading is
            known exactly.
        motion: what one decision does.

    Returns:
        float64 ``[k]``, for offsets 1..k.

    Examples:
        >>> bayes_bound(3).mul(1000).round().tolist()  # 1, 33 / 36, 171 / 216
        [1000.0, 917.0, 792.0]
    """
    position = torch.zeros(1, 2, dtype=torch.float64)
    heading = torch.zeros(1, dtype=torch.float64)
    # Of the sequences that end at a pose, how many began with each action.
    ways = torch.ones(1, 1, dtype=torch.float64)
    bounds = []
    for offset in range(1, max_action_distance + 1):
        position, heading = move(position, heading, motion=motion)
        position, heading = position.reshape(-1, 2), heading.reshape(-1) % 360
        # The first decision's six ends tell the first actions apart.
        ways = torch.eye(6).double() if offset == 1 else ways.repeat_interleave(6, 0)
        # 6^10 sequences take 20 GB one by one; most end where another one does.
        ways, one = _merge(position, heading, ways, _SAME_POSE)
        position, heading = position[one], heading[one]
        told, _ = _merge(position, heading, ways, resolution)
        bounds.append(told.max(1).values.sum() / told.sum())
    return torch.stack(bounds)


def _merge(
    position: Tensor, heading: Tensor, ways: Tensor, resolution: float
) -> tuple[Tensor, Tensor]:
    """Sum the ways to poses that cannot be told apart.

    Args:
        position: map units, ``[S, 2]``.
        heading: degrees, ``[S]``.
        ways: ``[S, 6]``.
        resolution: map units.

    Returns:
        The ways to each place, ``[U, 6]``, and one pose that lies there, int64 ``[U]``.
    """
    place = torch.cat([position / resolution, heading.unsqueeze(1)], 1).round()
    # One number a place: several times as fast as unique rows.
    place = (place - place.amin(0)).long()
    size = place.amax(0) + 1
    key = (place[:, 0] * size[1] + place[:, 1]) * size[2] + place[:, 2]
    found, number = key.unique(return_inverse=True)
    merged = ways.new_zeros(len(found), 6).index_add_(0, number, ways)
    one = torch.empty(len(found), dtype=torch.int64)
    one[number] = torch.arange(len(number))
    return merged, one
