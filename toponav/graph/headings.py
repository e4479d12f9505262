"""Which way views look, by the turns that the agent made; no compass, and no pose."""

import torch
from torch import Tensor

#: Votes for an angle that are needed, the share of them that must agree, and how far
#: from each other those may be, in degrees.
_VOTES, _SHARE, _APART = 16, 0.45, 20.0


def look_alike(one: Tensor, other: Tensor, tolerance: float) -> Tensor:
    """Whether headings in degrees differ by at most ``tolerance``; they broadcast.

    One that is not known, NaN, may be any.

    Examples:
        >>> look_alike(torch.tensor([350.0, 90.0]), torch.tensor(10.0), 30.0)
        tensor([ True, False])
    """
    apart = ((one - other + 180) % 360 - 180).abs()
    return ~(apart > tolerance)


def agreed_angle(votes: Tensor, *, share: float = _SHARE) -> float | None:
    """The angle in degrees, [-180, 180), that most votes ``[N]`` are for, or ``None``.

    Of 16 votes or more, a ``share`` must lie within 20 degrees of one of them.

    Examples:
        >>> votes = torch.tensor([181.0, 179.0, 540.0] * 6 + [0.0, 90.0] * 3)
        >>> round(agreed_angle(votes), 3)
        -180.0
    """
    votes = votes[~votes.isnan()]
    if len(votes) < _VOTES:
        return None
    agree = look_alike(votes.unsqueeze(1), votes, _APART)
    most = agree.sum(1).argmax()
    if agree[most].sum() < share * len(votes):
        return None
    angles = votes[agree[most]].double().deg2rad()
    mean = torch.atan2(angles.sin().mean(), angles.cos().mean())
    return float((mean.rad2deg() + 180) % 360 - 180)
