"""`TCPairs` and `LPairs`: the rules by which pairs train the two networks."""

from dataclasses import dataclass

import torch
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torch.nn.functional import embedding

from toponav.actions import as_numbers
from toponav.data.episodes import Episodes
from toponav.keys import (
    ACTION,
    ANCHOR,
    EMBEDDING,
    EPISODE,
    LABEL,
    OTHER,
    STEP,
    WEIGHT,
    read_entry,
)

# Numbers of a pair's two frames, while pairs are chosen.
_PAIR = "pair"


@dataclass(frozen=True)
class TCPairs:
    """The rule of the TC-network's pairs, and how to get them.

    A pair is positive at 1..k decisions and negative from M * k on; what lies between
    is not used. Half the pairs are positive, their distance is uniform, and the order
    of the two views is random. `draw` draws pair by pair, as the paper does; `mine`
    takes all pairs of a batch of `Chunks`, where a view is embedded once for many
    pairs, and weights replace what `draw` does by chance.

    Reference:
        The paper, "Temporal correlation network"; M = 5 and the random order from
        Savinov et al., "Episodic Curiosity through Reachability" (2019).
        https://arxiv.org/abs/1810.02274

    Examples:
        >>> rule = TCPairs(max_action_distance=4, negative_sample_multiplier=5)
        >>> episodes = Episodes.from_lengths([30, 100])
        >>> place, extra = rule.draw(episodes, 6, torch.Generator().manual_seed(0))
        >>> place.shape, extra["label"].sum().item()
        (torch.Size([6, 2]), 3.0)
    """

    max_action_distance: int = 4  # k
    negative_sample_multiplier: int = 5  # M
    other_episode_share: float = 0.0  # of the negatives, views of two episodes

    def __post_init__(self) -> None:
        k, m = self.max_action_distance, self.negative_sample_multiplier
        if k < 1:
            raise ValueError(f"max_action_distance must be at least 1, got {k}")
        if m < 2:
            raise ValueError(f"negative_sample_multiplier must be at least 2, got {m}")
        share = self.other_episode_share
        if not 0 <= share <= 1:
            raise ValueError(f"other_episode_share must lie in [0, 1], got {share}")

    @property
    def min_distance(self) -> int:
        """M * k, the smallest distance of a negative pair in decisions."""
        return self.max_action_distance * self.negative_sample_multiplier

    def draw(
        self, episodes: Episodes, batch_size: int, generator: torch.Generator | None
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """Draw pairs: places ``[P, 2]`` of anchor and other, and ``label`` ``[P]``."""
        k, m = self.max_action_distance, self.negative_sample_multiplier
        episodes.require(m * k + 1, f"more than M * k = {m} * {k}")
        is_one_episode = len(episodes.order) in episodes.group_length
        if self.other_episode_share > 0 and is_one_episode:
            raise ValueError(
                "the buffer must hold at least two episodes to pair frames of "
                "different ones, got one; collect more, or set other_episode_share=0"
            )
        num_positives = (batch_size + 1) // 2
        num_negatives = batch_size - num_positives
        across = torch.rand(num_negatives, generator=generator)
        num_across = int((across < self.other_episode_share).sum())
        num_apart = num_negatives - num_across
        place = [
            draw_near(episodes, num_positives, k, generator),
            _draw_apart(episodes, num_apart, m * k, generator),
            _draw_across(episodes, num_across, generator),
        ]
        label = (torch.arange(batch_size) < num_positives).float()
        return _swap_half(torch.cat(place), generator), {LABEL: label}

    def mine(
        self,
        frames: TensorDictBase,
        *,
        max_pairs: int | None = None,
        generator: torch.Generator | None = None,
    ) -> TensorDict:
        """All pairs of frames ``[*B]`` with ``embedding``, ``episode`` and ``step``.

        ``[P]`` with ``anchor``, ``other``, ``label`` and ``weight``. The weights make
        every positive distance count the same, and positives and negatives half each;
        they sum to one, unless the batch lacks a kind. Of each kind at most half of
        ``max_pairs`` are kept, drawn at random. The embeddings have gradients.
        """
        same, gap = compare_steps(frames)
        gap = gap.abs()
        once = torch.ones_like(same).triu(1)
        near = once & same & (gap >= 1) & (gap <= self.max_action_distance)
        positives = near.nonzero()
        far = (once & same & (gap >= self.min_distance)).nonzero()
        across = far[:0]
        share = self.other_episode_share
        if share > 0:
            across = (once & ~same).nonzero()
            if len(across) > (limit := max(len(far), len(positives))):
                order = torch.randperm(len(across), generator=generator)
                across = across[order[:limit]]
        pair = _swap_half(torch.cat([positives, far, across]), generator)
        weights = [
            0.5 * distance_weights(gap[near], self.max_action_distance),
            torch.full((len(far),), 0.5 * (1 - share) / max(len(far), 1)),
            torch.full((len(across),), 0.5 * share / max(len(across), 1)),
        ]
        label = (torch.arange(len(pair)) < len(positives)).float()
        numbers = {_PAIR: pair, LABEL: label, WEIGHT: torch.cat(weights)}
        found = TensorDict(numbers, [len(pair)])
        if max_pairs is not None:
            kinds = found.split([len(positives), len(pair) - len(positives)])
            kept = [keep_some(kind, max_pairs // 2, generator) for kind in kinds]
            found = torch.cat(kept)
        return gather_pairs(frames, found)


@dataclass(frozen=True)
class LPairs:
    """The rule of the L-network's pairs ``(o_i, o_(i+j), a_i)``, and how to get them.

    The distance j is uniform in 1..k, or k itself if it is to be ``exact``; no pair
    spans two episodes, and the earlier view always comes first: the action is the first
    one on the path.

    Reference:
        The paper, "Navigation implementation", eq. 14; the uniform distance from
        Savinov et al., "Semi-parametric Topological Memory" (2018).
        https://arxiv.org/abs/1803.00653

    Examples:
        >>> place, _ = LPairs(4).draw(Episodes.from_lengths([9, 9]), 8, None)
        >>> distance = place[:, 1] - place[:, 0]
        >>> bool(((distance >= 1) & (distance <= 4)).all())
        True
    """

    max_action_distance: int = 4  # k
    exact: bool = False

    def __post_init__(self) -> None:
        k = self.max_action_distance
        if k < 1:
            raise ValueError(f"max_action_distance must be at least 1, got {k}")

    @property
    def min_distance(self) -> int:
        """The smallest distance of a pair in decisions: k if ``exact``, else 1."""
        return self.max_action_distance if self.exact else 1

    def draw(
        self, episodes: Episodes, batch_size: int, generator: torch.Generator | None
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """Draw pairs: places ``[P, 2]`` of anchor and other, in this order."""
        k = self.max_action_distance
        episodes.require(k + 1, "more than max_action_distance")
        least = self.min_distance
        return draw_near(episodes, batch_size, k, generator, least=least), {}

    def mine(
        self,
        frames: TensorDictBase,
        *,
        max_pairs: int | None = None,
        generator: torch.Generator | None = None,
    ) -> TensorDict:
        """As `TCPairs.mine`, with ``action`` for ``label``; distances weigh alike."""
        same, gap = compare_steps(frames)
        near = same & (gap >= self.min_distance) & (gap <= self.max_action_distance)
        pair = near.nonzero()
        weight = distance_weights(gap[near], self.max_action_distance)
        action = as_numbers(read_entry(frames, ACTION), frames.shape).flatten()
        taken = action[pair[:, 0].to(action.device)].to(pair.device)
        numbers = {_PAIR: pair, ACTION: taken, WEIGHT: weight}
        found: TensorDictBase = TensorDict(numbers, [len(pair)])
        if max_pairs is not None:
            found = keep_some(found, max_pairs, generator)
        return gather_pairs(frames, found)


def _swap_half(pair: Tensor, generator: torch.Generator | None) -> Tensor:
    """Pairs ``[P, 2]``, each in a random order."""
    swap = torch.rand(len(pair), generator=generator) < 0.5
    return torch.where(swap.unsqueeze(-1), pair.flip(-1), pair)


def _draw_apart(
    episodes: Episodes, num: int, gap: int, generator: torch.Generator | None
) -> Tensor:
    """Places ``[num, 2]`` of frames of one run at least ``gap`` decisions apart."""
    length = episodes.length
    # Of a run of length L, frames t < L - gap and t >= gap have a partner.
    with_partner = torch.minimum(2 * (length - gap), length).clamp(min=0)
    before = with_partner.cumsum(0)
    target = draw_below(before[-1].expand(num), generator)
    run = torch.searchsorted(before, target, right=True)
    offset = target - (before - with_partner)[run]
    # In a run shorter than 2 * gap the frames in the middle have none: step over them.
    middle = length[run] - with_partner[run]
    offset += torch.where(offset < length[run] - gap, 0, middle)
    earlier = (offset - gap + 1).clamp(min=0)
    later = (length[run] - gap - offset).clamp(min=0)
    choice = draw_below(earlier + later, generator)
    partner = torch.where(choice < earlier, choice, offset + gap + choice - earlier)
    return episodes.start[run].unsqueeze(-1) + torch.stack([offset, partner], dim=-1)


def _draw_across(
    episodes: Episodes, num: int, generator: torch.Generator | None
) -> Tensor:
    """Places ``[num, 2]`` of frames of two different episodes."""
    total = len(episodes.order)
    anchor = draw_below(torch.full((num,), total), generator)
    run = episodes.run_of(anchor)
    other = draw_below(total - episodes.group_length[run], generator)
    behind = other >= episodes.group_start[run]
    other = other + torch.where(behind, episodes.group_length[run], 0)
    return torch.stack([anchor, other], dim=-1)


def compare_steps(frames: TensorDictBase) -> tuple[Tensor, Tensor]:
    """Of F frames ``[F, F]``: same episode or not, and decisions from row to column."""
    episode = read_entry(frames, EPISODE).flatten().cpu()
    step = read_entry(frames, STEP).flatten().cpu()
    same = episode.unsqueeze(0) == episode.unsqueeze(1)
    return same, step.unsqueeze(0) - step.unsqueeze(1)


def distance_weights(distance: Tensor, max_distance: int) -> Tensor:
    """Weights that make every distance that occurs count the same; they sum to one."""
    count = torch.bincount(distance, minlength=max_distance + 1)
    return 1 / (count[distance] * (count > 0).sum().clamp(min=1)).float()


def keep_some(
    pairs: TensorDictBase, limit: int, generator: torch.Generator | None
) -> TensorDictBase:
    """At most ``limit`` pairs ``[P]``, drawn at random; the sum of weights is kept."""
    if len(pairs) <= limit:
        return pairs
    weight = pairs.get(WEIGHT)
    chosen = torch.randperm(len(pairs), generator=generator)[:limit].to(weight.device)
    kept = pairs[chosen]
    share = weight.sum() / weight[chosen].sum()
    return kept.set(WEIGHT, weight[chosen] * share)


def gather_pairs(frames: TensorDictBase, numbers: TensorDictBase) -> TensorDict:
    """Embeddings of the pairs, numbers of flattened frames, and all other entries."""
    views = read_entry(frames, EMBEDDING).flatten(0, frames.ndim - 1)
    found = {str(key): entry.to(views.device) for key, entry in numbers.items()}
    anchor, other = found.pop(_PAIR).unbind(-1)
    # As ``views[anchor]``, whose gradient takes four times as long.
    found |= {ANCHOR: embedding(anchor, views), OTHER: embedding(other, views)}
    return TensorDict(found, numbers.batch_size)


def draw_near(
    episodes: Episodes,
    num: int,
    k: int,
    generator: torch.Generator | None,
    *,
    least: int = 1,
) -> Tensor:
    """Places ``[num, 2]``, evenly ``least``..k decisions apart, the earlier first."""
    number = draw_below(torch.full((num,), k + 1 - least), generator)
    distances = torch.arange(least, k + 1)
    # A run of length L has L - j frames that have a partner j decisions later.
    room = (episodes.length.unsqueeze(-1) - distances).clamp(min=0)
    before = room.cumsum(0)
    target = draw_below(before[-1, number], generator)
    run = (before[:, number] <= target).sum(0)
    offset = target - (before - room)[run, number]
    anchor = episodes.start[run] + offset
    return torch.stack([anchor, anchor + distances[number]], dim=-1)


def draw_below(limit: Tensor, generator: torch.Generator | None) -> Tensor:
    """Uniform integers in ``[0, limit)``, elementwise; every limit is at least 1."""
    uniform = torch.rand(limit.shape, dtype=torch.float64, generator=generator)
    return (uniform * limit).long()
