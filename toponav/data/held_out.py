"""`HeldOut`: episodes that no training sees, and fixed pairs of their frames."""

from dataclasses import dataclass

import torch
from tensordict import TensorDictBase
from torch import Tensor

from toponav.data.episode_sampler import DrawRule
from toponav.data.episodes import Episodes
from toponav.keys import ACTION, HEADING, LABEL, PIXELS, POSITION


@dataclass(frozen=True)
class PairSet:
    """Pairs of held-out frames.

    Args:
        first: int64 ``[P]``; numbers of the anchors among the flattened frames.
        second: the same of the others.
        distance: int64 ``[P]``; decisions between them, 0 for frames of two episodes.
        label: float32 ``[P]``; of TC pairs, else zeros.
        action: int64 ``[P]``; the action taken at the anchor.
    """

    first: Tensor
    second: Tensor
    distance: Tensor
    label: Tensor
    action: Tensor


class HeldOut:
    """Episodes of one maze, all of one length, with the poses beside the views.

    Args:
        frames: ``[E, T]`` with ``pixels``, ``action``, position and heading.
        name: of the maze.

    Raises:
        ValueError: if the frames are not ``[E, T]``.

    Examples:
        >>> from tensordict import TensorDict
        >>> from toponav.data import LPairs
        >>> frames = {"pixels": torch.zeros(2, 9, 4, 6, 3, dtype=torch.uint8)}
        >>> frames |= {"action": torch.zeros(2, 9, dtype=torch.int64)}
        >>> held_out = HeldOut(TensorDict(frames, [2, 9]), name="maze1")
        >>> pairs = held_out.draw(LPairs(4), 10, seed=0)
        >>> bool((pairs.second - pairs.first == pairs.distance).all())
        True

    Shape notation:
        E: episodes.  T: decisions of each.  P: pairs.
    """

    def __init__(self, frames: TensorDictBase, *, name: str) -> None:
        if frames.ndim != 2:
            raise ValueError(f"frames must be [E, T], got {list(frames.shape)}.")
        self.name = name
        self.num_episodes, self.length = frames.shape
        self.frames = frames.flatten()

    @property
    def pixels(self) -> Tensor:
        """Views of all frames, ``[E * T, H, W, 3]``, episode after episode."""
        pixels: Tensor = self.frames.get(PIXELS)
        return pixels

    def draw(self, rule: DrawRule, num_pairs: int, *, seed: int) -> PairSet:
        """Draw pairs by a rule, such as `TCPairs` or `LPairs`.

        Args:
            rule: which pairs.
            num_pairs: number P of pairs.
            seed: of the draw.
        """
        episodes = Episodes.from_lengths([self.length] * self.num_episodes)
        generator = torch.Generator().manual_seed(seed)
        place, extra = rule.draw(episodes, num_pairs, generator)
        first, second = episodes.order[place].unbind(-1)
        same = first // self.length == second // self.length
        return PairSet(
            first,
            second,
            torch.where(same, (second - first).abs(), 0),
            extra.get(LABEL, torch.zeros(num_pairs)),
            self.frames.get(ACTION)[first],
        )

    def poses(
        self, pairs: PairSet
    ) -> tuple[tuple[Tensor, Tensor], tuple[Tensor, Tensor]]:
        """The truth for reports: both positions ``[P, 2]``, both headings ``[P]``."""
        position = self.frames.get(POSITION)
        heading = self.frames.get(HEADING).squeeze(-1)
        return (position[pairs.first], position[pairs.second]), (
            heading[pairs.first],
            heading[pairs.second],
        )
