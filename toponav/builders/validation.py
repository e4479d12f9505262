"""How good networks are on held-out episodes, while they train."""

from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager

import torch
from torch import Tensor

from toponav.builders.networks import Networks
from toponav.config import PretrainConfig
from toponav.data import DrawRule, HeldOut, LPairs, PairSet, TCPairs
from toponav.evaluation import balanced_accuracy, roc_auc

#: k and M of the paper's figures.
PAPER_K, PAPER_M = 4, 5
_VIEWS_AT_ONCE = 256


@torch.no_grad()
def embed_views(
    encoder: Callable[[Tensor], Tensor],
    pixels: Tensor,
    *,
    device: torch.device,
    autocast: AbstractContextManager[None],
) -> Tensor:
    """Embed many views in pieces: ``[N, H, W, 3]`` to float32 ``[N, D]``.

    Args:
        encoder: in ``eval()`` mode.
        pixels: the views.
        device: of the encoder; the embeddings stay there.
        autocast: the precision to compute in.
    """
    with autocast:
        return torch.cat(
            [encoder(some.to(device)).float() for some in pixels.split(_VIEWS_AT_ONCE)]
        )


class Validation:
    """Measures networks on the same held-out pairs every time.

    Args:
        config: settings of the run.
        held_out: the episodes, one entry a maze.
        device: of the networks.
        autocast: the precision to embed in; comparisons are made in float32.

    Shape notation:
        P: pairs.  D: embedding.
    """

    def __init__(
        self,
        config: PretrainConfig,
        held_out: Sequence[HeldOut],
        *,
        device: torch.device,
        autocast: AbstractContextManager[None],
    ) -> None:
        pairs, validate, seed = config.pairs, config.validate, config.seed
        rules: dict[str, DrawRule] = {
            "tc": TCPairs(pairs.k, validate.m),
            "tc_paper": TCPairs(PAPER_K, PAPER_M),
            "l": LPairs(pairs.locomotion_k),
        }
        self.locomotion_k = pairs.locomotion_k
        self.held_out = held_out
        self.pairs: list[dict[str, PairSet]] = [
            {
                name: maze.draw(rule, validate.pairs, seed=seed + number)
                for name, rule in rules.items()
            }
            for number, maze in enumerate(held_out)
        ]
        self.device = device
        self.autocast = autocast

    def __call__(self, networks: Networks) -> dict[str, float]:
        """Measure; leaves the networks in the mode in which they came.

        Returns:
            Figures by name, means over the mazes; with several mazes also each
            maze's ``tc_accuracy``.
        """
        was_training = networks.tc.training
        networks.modules.eval()
        each = [
            self._measure(networks, maze, pairs)
            for maze, pairs in zip(self.held_out, self.pairs, strict=True)
        ]
        networks.modules.train(was_training)
        figures = {name: sum(one[name] for one in each) / len(each) for name in each[0]}
        if len(each) > 1:
            for maze, one in zip(self.held_out, each, strict=True):
                figures[f"tc_accuracy_{maze.name}"] = one["tc_accuracy"]
        return figures

    def _measure(
        self, networks: Networks, maze: HeldOut, pairs: dict[str, PairSet]
    ) -> dict[str, float]:
        """Figures of one maze."""
        tc, paper, way = pairs["tc"], pairs["tc_paper"], pairs["l"]
        similarity = self.similarity(networks, maze, tc)
        close = tc.label > 0.5
        figures = {
            "tc_accuracy": balanced_accuracy(similarity > 0.5, tc.label),
            "tc_positives": float((similarity[close] > 0.5).float().mean()),
            "tc_negatives": float((similarity[~close] <= 0.5).float().mean()),
            "tc_auc": roc_auc(similarity, tc.label),
            "tc_accuracy_k4_m5": balanced_accuracy(
                self.similarity(networks, maze, paper) > 0.5, paper.label
            ),
        }
        right = self.logits(networks, maze, way).argmax(-1) == way.action
        figures["l_accuracy"] = float(right.float().mean())
        for offset in range(1, self.locomotion_k + 1):
            share = right[way.distance == offset].float().mean()
            figures[f"l_accuracy_{offset}"] = float(share)
        return figures

    @torch.no_grad()
    def similarity(self, networks: Networks, maze: HeldOut, pairs: PairSet) -> Tensor:
        """The TC-network's probabilities of held-out pairs, ``[P]``, on the CPU."""
        first, second = self._embed_pairs(networks.tc.encoder, maze, pairs)
        logit = networks.tc.comparator(first, second)
        return logit.float().sigmoid().cpu()

    @torch.no_grad()
    def logits(self, networks: Networks, maze: HeldOut, pairs: PairSet) -> Tensor:
        """The L-network's logits of held-out pairs, ``[P, 6]``, on the CPU."""
        first, second = self._embed_pairs(networks.locomotion.encoder, maze, pairs)
        logits: Tensor = networks.locomotion.head(first, second)
        return logits.float().cpu()

    def _embed_pairs(
        self, encoder: Callable[[Tensor], Tensor], maze: HeldOut, pairs: PairSet
    ) -> tuple[Tensor, Tensor]:
        """Embeddings ``[P, D]`` of the anchors and of the others, each view once."""
        rows, place = torch.cat([pairs.first, pairs.second]).unique(return_inverse=True)
        embeddings = embed_views(
            encoder, maze.pixels[rows], device=self.device, autocast=self.autocast
        )
        first, second = embeddings[place.to(self.device)].chunk(2)
        return first, second
