"""The course of a pre-training: when to collect, how fast to learn, how good it is."""

import math
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path

import torch
from sklearn.metrics import balanced_accuracy_score, roc_auc_score
from torch import Tensor
from torchrl.data.replay_buffers import Storage

from toponav.builders import Networks
from toponav.config import PretrainConfig, TrainConfig
from toponav.data import DrawRule, HeldOut, LPairs, PairSet, TCPairs
from toponav.training.episode_log import mean_of
from toponav.training.pair_trainer import PairTrainer, make_pair_trainer, require_finite

_VIEWS_AT_ONCE = 256


def make_pretrainer(
    config: PretrainConfig,
    networks: Networks,
    storage: Storage,
    *,
    autocast: AbstractContextManager[None],
    folder: Path,
) -> PairTrainer:
    """The trainer of a pre-training; ``folder`` is named if a loss is not finite."""
    return make_pair_trainer(
        networks,
        config.pairs,
        config.train,
        storage,
        seed=config.seed,
        lr=partial(learning_rate, config.train),
        max_grad_norm=config.train.max_grad_norm,
        autocast=autocast,
        check=partial(require_finite, folder=folder, setting="train.lr"),
    )


def learning_rate(config: TrainConfig, update: int) -> float:
    """The learning rate of an update: a linear rise, then constant or half a cosine."""
    if update < config.warmup:
        return config.lr * (update + 1) / config.warmup
    if config.schedule == "constant":
        return config.lr
    rest = max(config.updates - config.warmup, 1)
    return config.lr * 0.5 * (1 + math.cos(math.pi * (update - config.warmup) / rest))


def decisions_due(config: PretrainConfig, update: int) -> int:
    """Decisions that must have been collected before an update.

    It depends on counts alone, not on the clock: the same update meets the same frames
    on a fast machine, on a slow one and after a restart.
    """
    collect = config.collect
    done = min(1.0, update / (collect.share * config.train.updates))
    rest = collect.decisions - collect.ahead
    return collect.ahead + round(rest * done)


class Validation:
    """Measures networks on the same held-out pairs of each world every time.

    ``autocast`` is the precision to embed in; comparisons are made in float32.
    """

    def __init__(
        self,
        networks: Networks,
        config: PretrainConfig,
        held_out: Sequence[HeldOut],
        *,
        autocast: AbstractContextManager[None],
    ) -> None:
        pairs, validate = config.pairs, config.validate
        rules: dict[str, DrawRule] = {
            "tc": TCPairs(pairs.k, validate.m),
            "tc_paper": TCPairs(4, 5),  # k and M of the paper's figures
            "l": LPairs(pairs.locomotion_k),
        }
        self.networks = networks
        self.locomotion_k = pairs.locomotion_k
        self.held_out = held_out
        self.autocast = autocast
        self.pairs: list[dict[str, PairSet]] = [
            {
                name: one.draw(rule, validate.pairs, seed=config.seed + number)
                for name, rule in rules.items()
            }
            for number, one in enumerate(held_out)
        ]

    def __call__(self) -> dict[str, float]:
        """Measure in ``eval()`` mode; the networks keep the mode they are in.

        Returns:
            Means over the worlds by name; with several also each one's ``tc_accuracy``.
        """
        was_training = self.networks.tc.training
        self.networks.modules.eval()
        each = [self.measure(number) for number in range(len(self.held_out))]
        self.networks.modules.train(was_training)
        figures = {name: mean_of(each, name) for name in each[0]}
        if len(each) > 1:
            for held_out, one in zip(self.held_out, each, strict=True):
                figures[f"tc_accuracy_{held_out.name}"] = one["tc_accuracy"]
        return figures

    def measure(self, number: int) -> dict[str, float]:
        """Measurements in one world, which need no ground truth."""
        held_out, pairs = self.held_out[number], self.pairs[number]
        tc, paper, l_pairs = pairs["tc"], pairs["tc_paper"], pairs["l"]
        similarity, close = self.similarity(held_out, tc), tc.label > 0.5
        as_in_paper = self.similarity(held_out, paper)
        figures = {
            "tc_accuracy": _balanced_accuracy(similarity, tc.label),
            "tc_positives": float((similarity[close] > 0.5).float().mean()),
            "tc_negatives": float((similarity[~close] <= 0.5).float().mean()),
            "tc_auc": float(roc_auc_score(close.numpy(), similarity.numpy())),
            "tc_accuracy_k4_m5": _balanced_accuracy(as_in_paper, paper.label),
        }
        is_right = self.logits(held_out, l_pairs).argmax(-1) == l_pairs.action
        figures["l_accuracy"] = float(is_right.float().mean())
        for offset in range(1, self.locomotion_k + 1):
            share = is_right[l_pairs.distance == offset].float().mean()
            figures[f"l_accuracy_{offset}"] = float(share)
        return figures

    @torch.no_grad()
    def similarity(self, held_out: HeldOut, pairs: PairSet) -> Tensor:
        """The TC-network's probabilities of held-out pairs, ``[P]``, on the CPU."""
        tc = self.networks.tc
        first, second = self._embed_pairs(tc.encoder, held_out, pairs)
        return tc.comparator(first, second).float().sigmoid().cpu()

    @torch.no_grad()
    def logits(self, held_out: HeldOut, pairs: PairSet) -> Tensor:
        """The L-network's logits of held-out pairs, ``[P, A]``, on the CPU."""
        locomotion = self.networks.locomotion
        first, second = self._embed_pairs(locomotion.encoder, held_out, pairs)
        logits: Tensor = locomotion.head(first, second)
        return logits.float().cpu()

    @torch.no_grad()
    def embed(self, encoder: Callable[[Tensor], Tensor], pixels: Tensor) -> Tensor:
        """Embed many views in pieces: ``[N, H, W, 3]`` to float32 ``[N, D]``."""
        device = self.networks.device
        with self.autocast:
            pieces = pixels.split(_VIEWS_AT_ONCE)
            return torch.cat([encoder(some.to(device)).float() for some in pieces])

    def _embed_pairs(
        self, encoder: Callable[[Tensor], Tensor], held_out: HeldOut, pairs: PairSet
    ) -> tuple[Tensor, Tensor]:
        """Embeddings ``[P, D]`` of the anchors and of the others, each view once."""
        rows, place = torch.cat([pairs.first, pairs.second]).unique(return_inverse=True)
        embeddings = self.embed(encoder, held_out.pixels[rows])
        first, second = embeddings[place.to(embeddings.device)].chunk(2)
        return first, second


def _balanced_accuracy(similarity: Tensor, label: Tensor) -> float:
    near, positive = similarity > 0.5, label > 0.5
    return float(balanced_accuracy_score(positive.numpy(), near.numpy()))
