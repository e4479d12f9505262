"""`HeldOut`: episodes that no training sees, and fixed pairs of their frames."""

from dataclasses import dataclass

import torch
from tensordict import TensorDictBase
from torch import Tensor

from toponav.actions import as_numbers
from toponav.data.episodes import Episodes
from toponav.data.pair_sources import DrawRule
from toponav.keys import (
    ACTION,
    DONE,
    HEADING,
    LABEL,
    NETWORK_PIXELS,
    POSITION,
    read_entry,
)
from toponav.parts import require_parts


@dataclass(frozen=True)
class PairSet:
    """Pairs of held-out frames; each entry is ``[P]``, int64 but for the labels."""

    first: Tensor  # numbers of the anchors among the flattened frames
    second: Tensor  # and of the others
    distance: Tensor  # decisions between them, 0 for frames of two episodes
    label: Tensor  # float32; of TC pairs, else zeros
    action: Tensor  # the one taken at the anchor


class HeldOut:
    """A number of walks in one world, all of one length; with poses where it has them.

    A walk is one episode, or several if the world ends them early.

    Args:
        frames: ``[E, T]`` with ``network_pixels`` and ``action``, a number or one-hot;
            ``("next", "done")`` says where episodes end, without it walks alone do.
        name: of the world.

    Examples:
        >>> from tensordict import TensorDict
        >>> from toponav.data import LPairs
        >>> frames = TensorDict({"action": torch.zeros(2, 9).long()}, [2, 9])
        >>> held_out = HeldOut(frames, name="maze1")
        >>> pairs = held_out.draw(LPairs(4), 10, seed=0)
        >>> bool((pairs.second - pairs.first == pairs.distance).all())
        True
    """

    def __init__(self, frames: TensorDictBase, *, name: str) -> None:
        if frames.ndim != 2:
            raise ValueError(f"frames must be [E, T], got {list(frames.shape)}")
        self.name = name
        self.num_walks, self.length = frames.shape
        self.frames = frames.flatten()
        self.episodes = Episodes.from_lengths(_episode_lengths(frames))

    @property
    def pixels(self) -> Tensor:
        """Views of all frames, ``[E * T, H, W, 3]``, episode after episode."""
        return read_entry(self.frames, NETWORK_PIXELS)

    @property
    def episode(self) -> Tensor:
        """Number of each frame's episode, int64 ``[E * T]``, ascending."""
        return self.episodes.run_of(torch.arange(len(self.frames)))

    def draw(self, rule: DrawRule, num_pairs: int, *, seed: int) -> PairSet:
        """Draw pairs by a rule, such as `TCPairs` or `LPairs`."""
        require_parts(rule, "rule", "TCPairs or LPairs", "draw")
        action = as_numbers(read_entry(self.frames, ACTION), self.frames.shape)
        generator = torch.Generator().manual_seed(seed)
        place, extra = rule.draw(self.episodes, num_pairs, generator)
        first, second = place.T.contiguous()
        same = self.episodes.run_of(first) == self.episodes.run_of(second)
        return PairSet(
            first,
            second,
            torch.where(same, (second - first).abs(), 0),
            extra.get(LABEL, torch.zeros(num_pairs)),
            action[first],
        )

    def poses(
        self, pairs: PairSet
    ) -> tuple[tuple[Tensor, Tensor], tuple[Tensor, Tensor]]:
        """The ground truth: both positions ``[P, 2]``, both headings ``[P]``."""
        rows = torch.stack([pairs.first, pairs.second])
        here, there = read_entry(self.frames, POSITION)[rows]
        heading, other = read_entry(self.frames, HEADING).squeeze(-1)[rows]
        return (here, there), (heading, other)


def _episode_lengths(frames: TensorDictBase) -> list[int]:
    done = frames.get(("next", DONE), None)
    ends = torch.zeros(frames.shape, dtype=torch.bool)
    if done is not None:
        ends |= done.reshape(frames.shape).cpu()
    ends[:, -1] = True
    last = ends.flatten().nonzero().squeeze(-1)
    lengths: list[int] = last.diff(prepend=torch.tensor([-1])).tolist()
    return lengths
