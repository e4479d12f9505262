"""`PairTruth`: how far apart two poses in a maze truly are."""

from dataclasses import dataclass

import torch
from torch import Tensor

from toponav.ground_truth.distances import GroundTruthDistances
from toponav.ground_truth.steering import wrap_degrees
from toponav.worlds import Motion


@dataclass(frozen=True)
class PairTruth:
    """The truth about P pairs of poses; every tensor is ``[P]``."""

    distance: Tensor  # on foot, in map units
    straight: Tensor  # in map units
    heading_difference: Tensor  # degrees in [0, 180]
    decisions: Tensor  # steps and turns one after the other
    least_decisions: Tensor  # the larger of both: one action may do both
    through_wall: Tensor  # near in the plan, at least twice as far on foot


def pair_truth(
    distances: GroundTruthDistances,
    positions: tuple[Tensor, Tensor],
    headings: tuple[Tensor, Tensor],
    *,
    motion: Motion,
    near_cells: float = 2.5,
) -> PairTruth:
    """Measure pairs of poses, ``[P, 2]`` in map units and ``[P]`` in degrees.

    Pairs ``through_wall`` are up to ``near_cells`` apart: parallel corridors are two
    cells apart, and the agents may stand off their middles.

    Examples:
        >>> distances = GroundTruthDistances(torch.ones(1, 4).bool(), cell_size=10)
        >>> here, there = torch.tensor([[5.0, 5.0]]), torch.tensor([[10.0, 5.0]])
        >>> headings = (torch.tensor([350.0]), torch.tensor([30.0]))
        >>> motion = Motion(cell_size=10, step=2.5, turn=20)
        >>> pair_truth(distances, (here, there), headings, motion=motion).decisions
        tensor([4.])
    """
    anchor, other = positions
    if anchor.shape != other.shape or anchor.shape[-1:] != (2,):
        shapes = f"{tuple(anchor.shape)} and {tuple(other.shape)}"
        raise ValueError(f"positions must be two of [P, 2], got {shapes}.")
    difference = wrap_degrees(headings[0].reshape(-1) - headings[1].reshape(-1)).abs()
    distance = distances.geodesic(anchor, other)
    straight = (anchor - other).norm(dim=-1)
    near = near_cells * distances.cell_size
    steps, turns = distance / motion.step, difference / motion.turn
    return PairTruth(
        distance=distance,
        straight=straight,
        heading_difference=difference,
        decisions=steps + turns,
        least_decisions=torch.maximum(steps, turns),
        through_wall=(straight <= near) & (distance >= 2 * near),
    )
