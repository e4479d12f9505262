"""`place_errors`: how often the view most like another one shows another place."""

import torch
from torch import Tensor

from toponav.builders.mazes import make_layout
from toponav.builders.networks import Networks
from toponav.builders.validation import Validation, embed_views
from toponav.config import MazeConfig
from toponav.data import HeldOut
from toponav.evaluation import (
    MazeMetric,
    most_similar,
    pair_candidates,
    place_error,
)
from toponav.keys import HEADING, POSITION

# Views that look for the one most like them, and views among which they look.
_QUERIES, _MEMORY = 400, 18_000
# A view that stands less than this before a wall, in cells, is a close-up.
_CLOSE_UP = 0.75


@torch.no_grad()
def place_errors(
    networks: Networks,
    validation: Validation,
    maze: MazeConfig,
    held_out: HeldOut,
    *,
    min_gap: int,
) -> dict[str, float]:
    """Share of views whose most similar other view lies more than two cells away.

    Some views of the first held-out episodes look among all views of these episodes.

    Args:
        networks: in ``eval()`` mode.
        validation: how to embed.
        maze: its settings.
        held_out: its episodes.
        min_gap: decisions between two visits of one episode.

    Returns:
        ``place_error``: any other view counts, those just before and after too;
        ``place_error_revisit``: only views of another visit, as a map needs it;
        ``place_error_far_sighted``: the same, of views that are no close-ups of a wall;
        ``far_sighted``: their share.
    """
    num_views = min(held_out.num_episodes, -(-_MEMORY // held_out.length))
    num_views *= held_out.length
    number = torch.arange(num_views)
    queries = number[:: max(1, num_views // _QUERIES)]
    similarity = _similarity(networks, validation, held_out.pixels[:num_views], queries)
    layout = make_layout(maze)
    metric = MazeMetric(torch.from_numpy(layout.open_mask))
    position = held_out.frames.get(POSITION)[:num_views]
    heading = held_out.frames.get(HEADING)[:num_views].squeeze(-1)

    def distance(gap: int) -> Tensor:
        """To the most similar view at least so many decisions away, ``[Q]``."""
        candidates = pair_candidates(
            number // held_out.length,
            number % held_out.length,
            min_gap=gap,
            rows=queries,
        )
        best = most_similar(similarity, candidates)
        found = metric.geodesic(position[queries], position[best])
        return torch.where(best >= 0, found, torch.nan)

    revisit = distance(min_gap)
    far_sighted = _is_open_ahead(metric, position[queries], heading[queries])
    return {
        "place_error": place_error(distance(1)),
        "place_error_revisit": place_error(revisit),
        "place_error_far_sighted": place_error(revisit[far_sighted]),
        "far_sighted": far_sighted.float().mean().item(),
    }


def _is_open_ahead(metric: MazeMetric, position: Tensor, heading: Tensor) -> Tensor:
    """Whether there is floor a little ahead, bool ``[Q]``."""
    angle = torch.deg2rad(heading)
    step = _CLOSE_UP * metric.cell_size * torch.stack([angle.cos(), angle.sin()], -1)
    column, up = ((position + step) / metric.cell_size).long().unbind(-1)
    return metric.open_mask[len(metric.open_mask) - 1 - up, column]


def _similarity(
    networks: Networks, validation: Validation, pixels: Tensor, queries: Tensor
) -> Tensor:
    """Of some views to all, float32 ``[Q, V]``."""
    embeddings = embed_views(
        networks.tc.encoder,
        pixels,
        device=validation.device,
        autocast=validation.autocast,
    )
    prepared = networks.tc.prepare_memory(embeddings)
    return torch.cat(
        [
            networks.tc.compare_prepared(some, prepared.expand(len(some), -1, -1)).cpu()
            for some in embeddings[queries].split(4)
        ]
    )
