"""`Chunks`: a few stretches of successive frames per episode, to mine pairs from."""

from dataclasses import dataclass

import torch
from torch import Tensor

from toponav.data.episodes import Episodes
from toponav.data.pairs import draw_below
from toponav.keys import EPISODE, STEP


@dataclass(frozen=True)
class Chunks:
    """Draw a batch of ``E`` episodes with ``C`` chunks of successive frames each.

    Pairs are mined from it (`TCPairs.mine`): close ones within a chunk, distant ones
    between the chunks of an episode. Episodes are drawn in proportion to their length,
    and not twice in a batch while there are enough; chunks start anywhere and may
    overlap. A sample is ``[E, C * chunk_len]``, with ``episode`` and ``step``.

    Args:
        chunks_per_episode: number C of chunks.
        chunk_len: frames in a chunk; more than the largest distance of a positive pair.
        min_length: shorter episodes are left out; TC pairs need more than M * k.

    Examples:
        >>> episodes = Episodes.from_lengths([50, 80])
        >>> place, extra = Chunks(2, 5).draw(episodes, 20, None)
        >>> place.shape, extra["step"].shape
        (torch.Size([2, 10]), torch.Size([2, 10]))
    """

    chunks_per_episode: int = 4
    chunk_len: int = 5
    min_length: int = 21

    def __post_init__(self) -> None:
        if min(self.chunks_per_episode, self.chunk_len, self.min_length) < 1:
            raise ValueError(f"every number of Chunks must be at least 1, got {self}")

    def draw(
        self, episodes: Episodes, batch_size: int, generator: torch.Generator | None
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """Draw ``batch_size`` frames: places ``[E, C * chunk_len]`` and the keys."""
        per_episode = self.chunks_per_episode * self.chunk_len
        num_episodes = batch_size // per_episode
        if num_episodes < 1 or batch_size % per_episode:
            nearest = max(round(batch_size / per_episode), 1) * per_episode
            raise ValueError(
                f"batch_size must be a multiple of chunks_per_episode * chunk_len = "
                f"{per_episode}, got {batch_size}; the nearest is {nearest}"
            )
        shortest = max(self.min_length, self.chunk_len)
        episodes.require(shortest, "min_length and chunk_len")
        usable = (episodes.length >= shortest).nonzero().squeeze(-1)
        chosen = torch.multinomial(
            episodes.length[usable].double(),
            num_episodes,
            replacement=num_episodes > len(usable),
            generator=generator,
        )
        run = usable[chosen].unsqueeze(-1)
        num_starts = episodes.length[run] - self.chunk_len + 1
        first = draw_below(num_starts.expand(-1, self.chunks_per_episode), generator)
        offset = (first.unsqueeze(-1) + torch.arange(self.chunk_len)).flatten(1)
        return episodes.start[run] + offset, {
            EPISODE: episodes.group_start[run].expand_as(offset),
            STEP: episodes.first_step[run] + offset,
        }
