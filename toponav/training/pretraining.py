"""The course of a pre-training: when to collect, and how fast to learn."""

import math
from contextlib import AbstractContextManager
from functools import partial
from pathlib import Path

from torchrl.data.replay_buffers import Storage

from toponav.builders import Networks
from toponav.config import PretrainConfig, TrainConfig
from toponav.training.pair_trainer import PairTrainer, make_pair_trainer, require_finite


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
        check=partial(require_finite, folder=folder),
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
