"""`place_errors`: how often the view most like another one shows another place."""

import torch
from torch import Tensor

from toponav.data import HeldOut
from toponav.ground_truth import GroundTruthDistances
from toponav.keys import HEADING, POSITION
from toponav.metrics import most_similar
from toponav.training import Validation

# Views that look for the one most like them, and views among which they look.
_QUERIES, _MEMORY = 400, 18_000
# Cells: farther apart, two views show different places.
_OTHER_PLACE = 2.0
# A view that stands less than this before a wall, in cells, is a close-up.
_CLOSE_UP = 0.75


@torch.no_grad()
def place_errors(
    validation: Validation,
    distances: GroundTruthDistances,
    held_out: HeldOut,
    *,
    min_gap: int,
) -> dict[str, float]:
    """Share of views whose most similar other view lies more than two cells away.

    Some views of the first held-out episodes look among all views of these episodes.

    Returns:
        ``place_error``: any other view counts, those just before and after too;
        ``place_error_revisit``: only views of another visit, ``min_gap`` decisions or
        an episode apart, as a map needs it; ``place_error_far_sighted``: the same, of
        views that are no close-ups of a wall; ``far_sighted``: their share.
    """
    num_views = min(held_out.num_walks, -(-_MEMORY // held_out.length))
    num_views *= held_out.length
    number, episode = torch.arange(num_views), held_out.episode[:num_views]
    step = number - held_out.episodes.start[episode]
    queries = number[:: max(1, num_views // _QUERIES)]
    tc = validation.networks.tc
    embeddings = validation.embed(tc.encoder, held_out.pixels[:num_views])
    memory = tc.prepare_memory(embeddings)
    rows = [
        tc.compare_prepared(some, memory.expand(len(some), -1, -1)).cpu()
        for some in embeddings[queries].split(4)
    ]
    similarity = torch.cat(rows)
    position = held_out.frames.get(POSITION)[:num_views]
    heading = held_out.frames.get(HEADING)[:num_views].squeeze(-1)

    def distance(gap: int) -> Tensor:
        """To the most similar view ``gap`` or more decisions away, NaN without one."""
        best = most_similar(similarity, episode, step, rows=queries, min_gap=gap)
        found = distances.geodesic(position[queries], position[best])
        return torch.where(best >= 0, found, torch.nan)

    def error(distance: Tensor) -> float:
        known = distance[~distance.isnan()]
        return float((known > _OTHER_PLACE * distances.cell_size).double().mean())

    revisit = distance(min_gap)
    angle = heading[queries].deg2rad()
    ahead = torch.stack([angle.cos(), angle.sin()], -1)
    ahead = position[queries] + _CLOSE_UP * distances.cell_size * ahead
    cell = (ahead / distances.cell_size).long()
    # Rows count from the top.
    far_sighted = distances.open_mask.flip(0)[cell[:, 1], cell[:, 0]]
    return {
        "place_error": error(distance(1)),
        "place_error_revisit": error(revisit),
        "place_error_far_sighted": error(revisit[far_sighted]),
        "far_sighted": far_sighted.float().mean().item(),
    }
