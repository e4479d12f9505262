"""The locomotion network (L) against the truth, and what could be had at best."""

from dataclasses import dataclass

import torch
from torch import Tensor

from toponav.ground_truth import require_motion, wrap_degrees
from toponav.worlds import Motion, WorldSpec

#: Cells within which two poses are the same, up to rounding.
_SAME_POSE = 1e-5


def move(
    position: Tensor, heading: Tensor, *, world: WorldSpec
) -> tuple[Tensor, Tensor]:
    """Poses after each of the A actions, in free space: ``[*B, A, 2]``, ``[*B, A]``."""
    effects = position.new_tensor(require_motion(world).effects)
    ahead, left, turn = effects.unbind(-1)
    angle = heading.unsqueeze(-1).deg2rad()
    x = ahead * angle.cos() - left * angle.sin()
    y = ahead * angle.sin() + left * angle.cos()
    moved = position.unsqueeze(-2) + torch.stack([x, y], -1)
    return moved, heading.unsqueeze(-1) + turn


def useful_actions(
    positions: tuple[Tensor, Tensor],
    headings: tuple[Tensor, Tensor],
    *,
    world: WorldSpec,
) -> Tensor:
    """Which actions bring the target's pose closer, bool ``[P, A]``.

    As in free space: pairs of the L-network see each other. ``positions`` ``[P, 2]`` in
    map units and ``headings`` ``[P]`` in degrees are of the views and of the targets.

    Examples:
        >>> from toponav.worlds import Effect
        >>> effects = Effect(ahead=2.5), Effect(ahead=-2.5), Effect(turn=20.0)
        >>> motion = Motion(cell_size=10.0, effects=effects)
        >>> world = WorldSpec(view_size=(1, 1), actions=(*"abl",), motion=motion)
        >>> ahead = (torch.tensor([[0.0, 0.0]]), torch.tensor([[9.0, 0.0]]))
        >>> useful_actions(ahead, (torch.zeros(1), torch.zeros(1)), world=world).int()
        tensor([[1, 0, 0]], dtype=torch.int32)
    """
    motion = require_motion(world)
    here, target = positions
    heading, wanted = (angle.reshape(-1) for angle in headings)
    before = _cost(target - here, wanted - heading, motion)
    after_at, after_heading = move(here, heading, world=world)
    gap, turn = target.unsqueeze(1) - after_at, wanted.unsqueeze(1) - after_heading
    after = _cost(gap, turn, motion)
    # An action must gain a thousandth of a decision, more than rounding does.
    return after < before.unsqueeze(1) - 1e-3


def _cost(gap: Tensor, turn: Tensor, motion: Motion) -> Tensor:
    steps: Tensor = gap.norm(dim=-1) / motion.step
    return steps + wrap_degrees(turn).abs() / motion.turn


@dataclass(frozen=True)
class LReport:
    """What a locomotion network is worth, by offset 1..k; every tensor is ``[k]``.

    A *useful* action is one of `useful_actions`; NaN at offsets without pairs.
    """

    count: Tensor  # pairs
    accuracy: Tensor  # share whose most probable action is the one taken
    useful_argmax: Tensor  # share whose most probable action is useful
    useful_sampled: Tensor  # of actions sampled from the network (exact mean)
    useful_taken: Tensor  # of the actions taken
    useful_uniform: Tensor  # of uniform actions

    def numbers(self) -> dict[str, float]:
        """All values by name and offset."""
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

    Its ``logits`` ``[P, A]``, the ``action`` taken and the ``offset`` j in 1..k, int64
    ``[P]``, and which actions are ``useful``, bool ``[P, A]``, see `useful_actions`.
    """
    k = max_action_distance
    if ((offset < 1) | (offset > k)).any():
        got = f"{offset.min()} to {offset.max()}"
        raise ValueError(f"offset must lie in 1..{k}, got {got}.")
    if logits.isnan().any():
        raise ValueError("logits must be numbers, got NaN.")
    count = torch.bincount(offset - 1, minlength=k)

    def by_offset(value: Tensor) -> Tensor:
        return torch.bincount(offset - 1, value.double(), minlength=k) / count

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
    max_action_distance: int = 4, *, world: WorldSpec, resolution: float = 1 / 32
) -> Tensor:
    """How often the first of 1..k random actions can be inferred at best, ``[k]``.

    All A^j sequences of uniform actions in free space are simulated; those that end at
    the same pose, to ``resolution`` cells, cannot be told apart, and the best guess is
    their most frequent first action. In the paper's world that leaves about 1, .92, .79
    and .71: its 91 to 95 % cannot be the first of up to four random actions.

    Examples:
        >>> from toponav.worlds import Effect
        >>> effects = [Effect(ahead=step) for step in (2.5, -2.5)]
        >>> effects += [Effect(turn=turn) for turn in (20.0, -20.0)]
        >>> motion = Motion(cell_size=10.0, effects=tuple(effects))
        >>> world = WorldSpec(view_size=(1, 1), actions=(*"ablr",), motion=motion)
        >>> bayes_bound(2, world=world)  # 4 of 16 sequences return, 1 of 4 guessed
        tensor([1.0000, 0.8125], dtype=torch.float64)
    """
    cell = require_motion(world).cell_size
    position, heading = torch.zeros(1, 2).double(), torch.zeros(1).double()
    # Of the sequences that end at a pose, how many began with each action.
    counts = torch.eye(world.num_actions).double()
    bounds = []
    for offset in range(max_action_distance):
        position, heading = move(position, heading, world=world)
        position, heading = position.reshape(-1, 2), heading.reshape(-1) % 360
        if offset:
            counts = counts.repeat_interleave(world.num_actions, 0)
        # Most of the A^j sequences end where another one does.
        counts, one = _merge(position, heading, counts, _SAME_POSE * cell)
        position, heading = position[one], heading[one]
        alike, _ = _merge(position, heading, counts, resolution * cell)
        bounds.append(alike.max(1).values.sum() / alike.sum())
    return torch.stack(bounds)


def _merge(
    position: Tensor, heading: Tensor, counts: Tensor, resolution: float
) -> tuple[Tensor, Tensor]:
    place = torch.cat([position / resolution, heading.unsqueeze(1)], 1).round()
    found, number = place.unique(dim=0, return_inverse=True)
    merged = counts.new_zeros(len(found), counts.shape[1])
    one = torch.empty(len(found), dtype=torch.int64)
    one[number] = torch.arange(len(number))
    return merged.index_add_(0, number, counts), one
